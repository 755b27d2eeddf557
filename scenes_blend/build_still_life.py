# SPDX-License-Identifier: GPL-3.0-or-later
"""A still life: a drop of amber on a plinth and a knot of jade, lit from behind.

Forward scattering sends the light of the spot through both resins toward the camera.
"""

import sys
from math import cos, pi, sin
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import common
from mathutils import Matrix


def drop(d: common.Point) -> common.Point:
    """A hanging drop with shallow facets, from a point of the unit sphere; 1.9 high."""
    x, y, z = d
    waist = 1 - 0.42 * max(z, 0) ** 1.6
    a, b, c = sin(9 * x), sin(9 * y), sin(9 * z)
    ripple = 1 + 0.02 * (a * b + b * c + c * a)
    return (x * waist * ripple, y * waist * ripple, z * (1.12 if z > 0 else 0.78) * ripple)


def knot(t: float) -> common.Point:
    """Trefoil with its three lobes in the x-y plane."""
    a = 2 * pi * t
    return (
        (0.62 + 0.26 * cos(3 * a)) * cos(2 * a),
        (0.62 + 0.26 * cos(3 * a)) * sin(2 * a),
        0.26 * sin(3 * a),
    )


def disc(radius: float, bottom: float, top: float, bevel: float, around: int) -> common.Shape:
    """Closed cylinder about z with a bevelled upper edge."""
    rings = [(radius, bottom), (radius, top - bevel), (radius - bevel, top)]
    vertices = [
        (r * cos(2 * pi * i / around), r * sin(2 * pi * i / around), z)
        for r, z in rings
        for i in range(around)
    ]
    faces: list[tuple[int, ...]] = []
    for ring in range(len(rings) - 1):
        a, b = ring * around, (ring + 1) * around
        faces += [(a + i, a + (i + 1) % around, b + (i + 1) % around, b + i) for i in range(around)]
    last = (len(rings) - 1) * around
    faces += [tuple(range(last, last + around)), tuple(reversed(range(around)))]
    return vertices, faces


scene = common.start((640, 480), samples=16)
common.set_view(scene, "Filmic", 0.0)
common.set_world((0.07, 0.08, 0.1))

amber = common.translucent("Amber", (0.6, 0.5, 0.4), (0.04, 0.55, 2.6), g=0.6, ior=1.54)
jade = common.translucent("Jade", (3.2, 3.8, 3.3), (2.2, 0.15, 0.9), g=0.2, ior=1.6)
stone = common.diffuse("Stone", (0.2, 0.17, 0.15))
plaster = common.diffuse("Plaster", (0.5, 0.45, 0.4))

common.add_object("Sweep", common.sweep(), stone)
common.add_object("Plinth", disc(0.95, 0.0, 0.55, 0.04, 96), plaster, smooth=False).location = (
    -0.95, 0.2, 0.0,
)  # fmt: skip

vertices, triangles = common.icosphere(4)
resin = common.add_object("Amber drop", ([drop(v) for v in vertices], triangles), amber)
resin.location = (-0.95, 0.2, 0.55 + 0.80)
common.add_subdivision(resin, 1)

ring = common.add_object("Jade knot", common.tube(knot, 0.19, around=12, along=96), jade)
common.add_subdivision(ring, 2)
ring.matrix_world = (
    Matrix.Translation((1.15, -0.35, 0.98)) @ Matrix.Rotation(0.42 * pi, 4, "X")
    @ Matrix.Rotation(0.3, 4, "Z")
)  # fmt: skip

spot = common.bpy.data.lights.new("Back light", "SPOT")
spot.energy = 9000
spot.color = (1.0, 0.93, 0.82)
spot.spot_size = 1.1
spot.spot_blend = 1.0
spot.shadow_soft_size = 0
common.aim(
    common.link(common.bpy.data.objects.new("Back light", spot)), (-5.0, 2.6, 4.6), (0.0, 0.0, 0.8)
)

common.add_point_light("Fill", (5.0, -4.5, 6.0), intensity=70).data.color = (0.75, 0.87, 1.0)
common.add_camera((0.5, -9.0, 3.0), target=(0.1, 0.0, 1.05), horizontal_angle=33)
common.save("still_life.blend")
