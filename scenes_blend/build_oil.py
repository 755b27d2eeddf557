# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's oil in a flask, nested boundaries, lit from the side.

Glass and oil are two closed meshes, and the oil reaches a little into the wall, as artists model
it. The glass has the higher priority, so it fills what is common to both: the one boundary between
glass and oil is the inner side of the wall, wherever in the wall the oil ends. A gap instead is a
film of air, which reflects all of the light that is oblique enough (one of 0.01 takes 24 %).
"""

import sys
from math import cos, pi, sin
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import common

AROUND, ALONG = 128, 64
CENTER, RADIUS, NECK, HEIGHT = 2.2, 2.4, 0.62, 6.4  # of the flask's outside, upright on z = 0
WALL, OVERLAP = 0.1, 0.02
LEVEL = 3.3  # of the oil
EDGE = 0.05  # width of what the lip and the edge of the oil's surface are rounded by


def flask_radius(z: float, inset: float) -> float:
    """A sphere and its neck, run together smoothly, `inset` inside of the outer wall."""
    sphere = max((RADIUS - inset) ** 2 - (z - CENTER) ** 2, 0.0)
    neck = (NECK - inset) * min(max(z / CENTER, 0.0), 1.0)
    return (sphere**2 + neck**4) ** 0.25


def flask_wall(bottom: float, top: float, inset: float) -> list[tuple[float, float]]:
    """Profile of the wall from below to above, close where it is round."""
    middle, half = (bottom + top) / 2, (top - bottom) / 2
    heights = [middle - half * cos(pi * i / ALONG) for i in range(ALONG + 1)]
    return [(flask_radius(z, inset), z) for z in heights]


def rim(radius: float, z: float, width: float, turn: float) -> list[tuple[float, float]]:
    """An arc of profile about (radius, z), from outside by `turn` times pi inwards."""
    arc = [turn * pi * i / 6 for i in range(7)]
    return [(radius + width * cos(a), z + width * sin(a)) for a in arc]


def floor(wall: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """The flat bottom below a wall, from its middle on, narrower rings where it meets the wall."""
    radius, z = wall[0]
    return [(part * radius, z) for part in (0.0, 0.9, 0.98)]


outer = flask_wall(0.0, HEIGHT, 0.0)
inner = flask_wall(WALL, HEIGHT, WALL)
lip = rim(NECK - WALL / 2, HEIGHT, WALL / 2, 1.0)
inside = [*floor(inner), *inner[1:-1]]
glass_profile = [*floor(outer), *outer[1:-1], *lip, *reversed(inside)]

inset = WALL - OVERLAP
oil_wall = flask_wall(inset, LEVEL - EDGE, inset)
edge = rim(oil_wall[-1][0] - EDGE, LEVEL - EDGE, EDGE, 0.5)
surface = [(0.97 * edge[-1][0], LEVEL), (0.0, LEVEL)]
oil_profile = [*floor(oil_wall), *oil_wall[1:-1], *edge, *surface]

scene = common.start((480, 600), samples=16)
common.set_view(scene, "Filmic", 0.9)
common.set_world((0.12, 0.13, 0.15))

oil = common.paper_resin("Oil", (0.004, 0.454, 0.1), (9.709, 11.628, 2.74), g=0.9, ior=1.47)
glass = common.clear_glass("Glass", ior=1.5)
glass.amberlight.priority = 1
common.add_object("Sweep", common.sweep(), common.diffuse("Stone", (0.2, 0.17, 0.15)))
for name, profile, material in (("Glass", glass_profile, glass), ("Oil", oil_profile, oil)):
    common.add_lathed(name, profile, material, AROUND)

common.add_spot_light("Light", (-9.0, 2.6, 8.0), (0, 0, 2.4), intensity=12000, angle=26)
common.add_point_light("Fill", (7.0, -9.0, 10.0), intensity=200).data.color = (1.0, 0.9, 0.75)
common.add_camera((0.0, -15.0, 5.4), target=(0.0, 0.0, 2.9), horizontal_angle=24)
common.save("oil.blend")
