# SPDX-License-Identifier: GPL-3.0-or-later
"""The metrics of docs/accuracy.md: those of the add-on's cost report, for the tests."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2] / "addon"))

from amberlight.cost.metrics import (  # noqa: E402, F401 - for the tests
    box_down,
    cross_floored_rel,
    cross_mse,
    errors,
    floored_rel,
    mean_ratio,
    mse,
    peak,
    rel_rmse,
)
