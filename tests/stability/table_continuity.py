# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures must not jump: parameters swept through where something degenerates.

The error is the largest step between neighbouring values, over the larger of the steps beside it
and a thousandth of the mean: 1 where a curve is smooth, 2.4 where it begins like a square root,
a thousand times the relative height of a jump."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from hard import POINTS, Case
from meshes import box, icosphere
from oracles import Slab
from scenes import AREA, POINT, SUN, Body, Camera, Lamp, Setup, mean
from table_media import slab_setup

STEPS = 200
FLOOR = 1e-3
BOTH = ("POINTS_COVARIANCE", "TUBES")
CUBE = box((-1, -1, -1), (1, 1, 1))
BALL = icosphere(2)


def largest_step(method: str, setup_at: Callable[[float], Setup], low: float, high: float) -> float:
    values = np.array(
        [
            mean(setup_at(float(x)), method, light_samples=2**12).mean()
            for x in np.linspace(low, high, STEPS + 1)
        ]
    )
    steps = np.abs(np.diff(values))
    beside = np.maximum(steps[:-2], steps[2:])
    return float(np.max(steps[1:-1] / np.maximum(beside, FLOOR * values.mean())))


CUBE_VIEW = Setup(
    (Body(CUBE, 1.3),),
    (Lamp(POINT, color=20.0, position=(0.7, 0.4, 3.1)),),
    Camera((3, 2, 4), (-3, -2, -4), window=1.0),
    size=2,
)


def with_body(**fields: object) -> Setup:
    return replace(CUBE_VIEW, bodies=(replace(CUBE_VIEW.bodies[0], **fields),))


def with_lamp(lamp: Lamp) -> Setup:
    return replace(CUBE_VIEW, lamps=(lamp,))


def past_silhouette(y: float) -> Setup:
    lamp = Lamp(SUN, direction=(0.6, 0, 0.8))
    camera = Camera((5, y, 0), (-1, 0, 0), (0, 0, 1), window=1e-4)
    return Setup((Body(BALL, 1.3),), (lamp,), camera)


def area(size: float) -> Setup:
    color = 20.0 / max(size, 1e-6) ** 2
    at = (0.7, 0.4, 3.1)
    side = max(size, 1e-6)
    return with_lamp(
        Lamp(AREA, color=color, position=at, direction=(-0.7, -0.4, -3.1), size=(side, side))
    )


def critical(angle: float) -> Setup:
    return slab_setup(Slab(n=0.8, light_angle=angle), 0.4, 0.1)


def lamp_through_surface(z: float) -> Setup:
    camera = Camera((0.4, 0.2, 6), window=2e-3)
    return Setup((Body(CUBE, 1.0),), (Lamp(POINT, position=(0.1, 0.2, 1 + z)),), camera)


def along_light(tilt: float) -> Setup:
    return slab_setup(Slab(light_angle=0.0, camera_angle=abs(tilt), g=0.5), 0.4, 0.1)


def sweep(
    name: str,
    setup_at: Callable[[float], Setup],
    low: float,
    high: float,
    methods: tuple[str, ...] = BOTH,
    bound: float = 3.0,
    bound_points: float = 8.0,
) -> Case:
    return Case(
        name,
        f"{low:g} to {high:g} in {STEPS} steps; largest step to those beside it",
        bound,
        lambda m: largest_step(m, setup_at, low, high),
        methods,
        bound_points=bound_points,
    )


CASES = [
    sweep("ior through 1", lambda x: with_body(ior=x), 0.98, 1.02),
    sweep("g through 0", lambda x: with_body(g=x), -0.02, 0.02),
    sweep("g to 0.999", lambda x: with_body(g=x), 0.9, 0.999),
    sweep("absorption to 0", lambda x: with_body(sigma_a=x), 0.01, 0.0),
    sweep("light through the critical angle", critical, 0.90, 0.95, ("TUBES", "SPECULAR")),
    sweep(
        "lamp through the surface", lamp_through_surface, 0.02, -0.02, POINTS[1:], bound_points=20
    ),
    sweep("lamp down to the surface", lamp_through_surface, 0.02, 1e-4, ("SPECULAR",), bound=8),
    sweep("view past the silhouette", past_silhouette, 0.97, 1.01),
    sweep("view through the light's direction", along_light, -1e-3, 1e-3),
    sweep("area lamp to a point", area, 0.2, 0.0),
    sweep(
        "disc to a point",
        lambda r: with_lamp(Lamp(POINT, color=20.0, position=(0.7, 0.4, 3.1), radius=r)),
        0.1,
        0.0,
    ),
    sweep(
        "sun's angle to 0",
        lambda a: with_lamp(Lamp(SUN, direction=(-0.2, -0.1, -1), more={"angle": a})),
        0.1,
        0.0,
    ),
]
