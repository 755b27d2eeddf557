# SPDX-License-Identifier: GPL-3.0-or-later
"""The passes, in one table."""

from __future__ import annotations

from typing import NamedTuple


class Pass(NamedTuple):
    """name: Blender's and the library's; channel_ids and kind: as Blender's register_pass."""

    name: str
    channels: int
    channel_ids: str
    kind: str
    is_builtin: bool  # Blender makes the pass itself where the view layer asks for it


# fmt: off
PASSES = (
    Pass("Combined",          4, "RGBA", "COLOR", True),
    Pass("Depth",             1, "Z",    "VALUE", True),
    Pass("Single Scattering", 3, "RGB",  "COLOR", False),
    Pass("Double Scattering", 3, "RGB",  "COLOR", False),
    Pass("Multiple Scattering", 3, "RGB", "COLOR", False),
    Pass("Surface",           3, "RGB",  "COLOR", False),
    Pass("Frequency",         1, "X",    "VALUE", False),
    Pass("Error",             1, "X",    "VALUE", False),
    Pass("Denoising Albedo",  3, "RGB",  "COLOR", False),
    Pass("Denoising Normal",  3, "XYZ",  "VECTOR", False),
)
# fmt: on
COMBINED = PASSES[0]
