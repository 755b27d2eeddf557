# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's own monkey in the resin of the paper's buddha, lit from the side."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import common

scene = common.start((512, 512), samples=16, **common.PAPER_PATHS)
common.set_view(scene, "Standard", 4.2)
common.set_world((0, 0, 0))

common.bpy.ops.mesh.primitive_monkey_add()
monkey = common.bpy.context.object
monkey.data.materials.append(common.buddha_resin())
common.add_subdivision(monkey, 3)
common.add_remesh(monkey, voxel_size=0.02, smoothings=10)

common.add_point_light("Light", (-4.8, 0.3, 1.8), intensity=100)
common.add_camera((2.2, -5.6, 1.0), target=(0, 0, 0), horizontal_angle=28)
common.save("suzanne.blend")
