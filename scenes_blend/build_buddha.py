# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's buddha, blue and the least transparent of its resins, lit from the side.

Its mesh is not in this repository:

    ./amberlight blender -b --factory-startup --python scenes_blend/build_buddha.py -- \
        BUDDHA.obj OUT.blend

BUDDHA.obj is a Stanford buddha with y up, about 2 units high. The usual one of 100 000 triangles
has 24 of them twice, which the reader drops; of its edges 23 then have one triangle, 31 have three
and 11 four. It is taken as it is: fewer than one probe ray in a thousand meets such a place, so
that AUTO still chooses tubes.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import common

mesh_path, out = common.paths_given("BUDDHA.obj OUT.blend")
scene = common.start((512, 512), samples=16, **common.PAPER_PATHS)
common.set_view(scene, "Standard", 5.0)
common.set_world((0, 0, 0))

shape = common.read_obj(mesh_path)
buddha = common.add_object("Buddha", shape, common.buddha_resin())
common.add_point_light("Light", (-4.5, 1.6, 1.5), intensity=100)
common.add_camera((0, -5.6, 0.4), target=(0, 0, 0), horizontal_angle=22)
common.save_as(out)
