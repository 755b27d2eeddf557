# SPDX-License-Identifier: GPL-3.0-or-later
"""Puts this folder on the import path: its modules are shared with tests/bench."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = str(Path(__file__).resolve().parent)
if HERE not in sys.path:
    sys.path.insert(0, HERE)
