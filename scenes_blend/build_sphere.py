# SPDX-License-Identifier: GPL-3.0-or-later
"""A unit sphere of the bumpy sphere's resin, lit by a point light from the side."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import common

scene = common.start((512, 512), samples=16, adjoint_normals=False)
common.set_view(scene, "Standard", 5.0)
common.set_world((0, 0, 0))

vertices, triangles = common.icosphere(5)
shape = [common.y_up(v) for v in vertices], triangles
common.add_object("Sphere", shape, common.bumpy_resin())

common.add_point_light("Light", common.y_up((-4.5, 1.5, -1.6)), intensity=100)
common.add_camera(common.y_up((0, 0, 5)), target=(0, 0, 0), horizontal_angle=30)
common.save("sphere.blend")
