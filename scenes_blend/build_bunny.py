# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's bunny: low opacity, lit from the side. Its mesh is not in this repository:

    ./amberlight blender -b --factory-startup --python scenes_blend/build_bunny.py -- \
        BUNNY.obj OUT.blend

BUNNY.obj is a Stanford bunny with y up, about 2 units wide and without the holes of the scan.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import common

mesh_path, out = common.paths_given("BUNNY.obj OUT.blend")
scene = common.start((512, 512), samples=16, **common.PAPER_PATHS)
common.set_view(scene, "Standard", 8.0)
common.set_world((0, 0, 0))

common.add_object("Bunny", common.read_obj(mesh_path), common.bunny_resin())
common.add_point_light("Light", (-4.5, 1.6, 1.5), intensity=100)
common.add_camera((0, -5.6, 0.4), target=(0, 0, 0), horizontal_angle=25)
common.save_as(out)
