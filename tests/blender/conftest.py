# SPDX-License-Identifier: GPL-3.0-or-later
"""What both sides share: the tests in `inside` run in Blender only."""

import importlib.util

if importlib.util.find_spec("bpy") is None:
    collect_ignore = ["inside"]
