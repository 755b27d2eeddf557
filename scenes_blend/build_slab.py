# SPDX-License-Identifier: GPL-3.0-or-later
"""A slab of the bumpy sphere's resin, 3 x 3 x 0.8, with flat faces."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import common

scene = common.start((512, 512), samples=16, adjoint_normals=False)
common.set_view(scene, "Standard", 8.0)
common.set_world((0, 0, 0))

x, y, z = 1.5, 1.5, 0.4
vertices = [
    (-x, -y, -z), (x, -y, -z), (x, y, -z), (-x, y, -z),
    (-x, -y, z), (x, -y, z), (x, y, z), (-x, y, z),
]  # fmt: skip
faces = [(3, 2, 1, 0), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
common.add_object("Slab", (vertices, faces), common.bumpy_resin(), smooth=False)

common.add_point_light("Light", common.y_up((-2.5, 4, 1.5)), intensity=100)
common.add_camera(common.y_up((0, 3, 4.2)), target=(0, 0, 0), horizontal_angle=46)
common.save("slab.blend")
