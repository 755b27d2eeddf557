# SPDX-License-Identifier: GPL-3.0-or-later
"""A ball of amber and a ring of glass on a table in the sun.

Neither casts a black shadow: the ball gathers the sun to a focus of its colour, the ring draws its
caustic around it, and the table sees the sky and the glow of the amber through both.
"""

import sys
from math import cos, pi, radians, sin
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import common
from mathutils import Matrix


def circle(t: float) -> common.Point:
    return (cos(2 * pi * t), sin(2 * pi * t), 0.0)


scene = common.start((640, 400), samples=64)
common.set_view(scene, "Filmic", 0.0)
common.set_world((0.12, 0.15, 0.2))

amber = common.translucent("Amber", (0.25, 0.2, 0.1), (0.05, 0.45, 1.8), g=0.5, ior=1.54)
glass = common.clear_glass("Glass", 1.5)
table = common.diffuse("Table", (0.62, 0.58, 0.52))

edge = 30.0
corners = [(-edge, -edge, 0), (edge, -edge, 0), (edge, edge, 0), (-edge, edge, 0)]
common.add_object("Table", (corners, [(0, 1, 2, 3)]), table, smooth=False)
ball = common.add_object("Amber ball", common.icosphere(5), amber)
ball.location = (-1.3, 0.0, 1.02)

ring = common.add_object("Glass ring", common.tube(circle, 0.28, around=24, along=96), glass)
common.add_subdivision(ring, 2)
ring.matrix_world = Matrix.Translation((1.35, -0.35, 0.3))

sun = common.bpy.data.lights.new("Sun", "SUN")
sun.energy = 4.0
sun.color = (1.0, 0.94, 0.85)
sun.angle = radians(0.53)
common.aim(common.link(common.bpy.data.objects.new("Sun", sun)), (-3.0, 3.6, 4.6), (0.0, 0.0, 0.0))
common.add_camera((0.5, -8.0, 6.0), target=(0.35, -0.45, 0.35), horizontal_angle=38)
common.save("caustics.blend")
