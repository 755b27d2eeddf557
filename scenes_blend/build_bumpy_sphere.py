# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's bumpy sphere: resin whose bumps focus a point light into caustics inside it."""

import sys
from math import sin
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import common


def bumps(d: common.Point) -> common.Point:
    """Moves a point of the unit sphere along its radius, to
    r(d) = 1 + 0.025 (sin 8x sin 8y + sin 8y sin 8z + sin 8z sin 8x)."""
    x, y, z = (sin(8 * c) for c in d)
    r = 1 + 0.025 * (x * y + y * z + z * x)
    return (r * d[0], r * d[1], r * d[2])


scene = common.start((512, 512), samples=16, adjoint_normals=False)
common.set_view(scene, "Standard", 5.0)
common.set_world((0, 0, 0))

vertices, triangles = common.icosphere(5)
shape = [common.y_up(bumps(v)) for v in vertices], triangles
common.add_object("Bumpy sphere", shape, common.bumpy_resin())

common.add_point_light("Light", common.y_up((-4.5, 1.5, -1.6)), intensity=100)
common.add_camera(common.y_up((0, 0, 5)), target=(0, 0, 0), horizontal_angle=30)
common.save("bumpy_sphere.blend")
