# SPDX-License-Identifier: GPL-3.0-or-later
"""Later orders of scattering: energy is neither made nor lost, whatever the medium."""

from __future__ import annotations

import numpy as np
from api import _ffi, render
from hard import METHODS, ORDERS, Case
from meshes import Mesh, box, icosphere
from scenes import SUN, Body, Camera, Lamp, Setup, difference, mean

EVERYTHING = (
    _ffi.AMB_EFFECT_SINGLE_SCATTERING
    | _ffi.AMB_EFFECT_DOUBLE_SCATTERING
    | _ffi.AMB_EFFECT_MULTIPLE_SCATTERING
    | _ffi.AMB_EFFECT_SURFACE_REFLECTION
    | _ffi.AMB_EFFECT_BACKGROUND
    | _ffi.AMB_EFFECT_TRANSMITTED_LIGHT
    | _ffi.AMB_EFFECT_WORLD_LIGHT
)
BALL = icosphere(3)


def furnace(method: str, radius: float, g: float, ior: float, mesh: Mesh = BALL) -> float:
    """A ball of albedo 1 in a uniform world of radiance 1 cannot be seen."""
    sigma = (radius, 0.5 * radius, 2 * radius)
    camera = Camera((0.1, 0.2, 5), window=1.0 if mesh is BALL else 2.2)
    setup = Setup((Body(mesh, ior, sigma, 0.0, g),), (), camera, size=4)

    def build(scene: object) -> None:
        setup.build(scene)
        scene.set_world((1.0, 1.0, 1.0))

    settings = {
        "threads": 1,
        "light_samples": 2**17,
        "samples": 2048 if method == "WALK" else 256,
        "camera_bounces": 32,
        "film_transparent": 0,
    }
    image = render(
        build, setup.size, "Combined", **(settings | METHODS[method] | {"effects": EVERYTHING})
    )
    pixels = image.pixels[..., :3].astype(np.float64)
    return float(np.abs(pixels.mean(axis=(0, 1)) - 1).max())


def room(method: str, half: float, is_open: bool) -> float:
    """A white medium in a room that glows, or in front of it in a world as bright, cannot be seen,
    also where it ends just before the walls or goes on behind them."""
    walls = box((-2, -2, -2), (2, 2, 2))
    if is_open:
        is_front = np.all(walls.positions[walls.triangles][..., 2] > 1, axis=1)
        walls = Mesh(walls.positions, walls.triangles[~is_front])
    bodies = (
        Body(walls, is_opaque=True, emission=1.0),
        Body(box((-half,) * 3, (half,) * 3), 1.0, 0.4, 0.0),
    )
    at = (0.01, 0.02, 4.0 if is_open else 1.9)
    setup = Setup(bodies, (), Camera(at, window=0.3, is_perspective=True), size=4)

    def build(scene: object) -> None:
        setup.build(scene)
        scene.set_world((1.0, 1.0, 1.0))

    settings = {
        "threads": 1,
        "estimator": _ffi.AMB_ESTIMATOR_POINTS_COVARIANCE,
        "light_samples": 2**18,
        "samples": 512 if method == "WALK" else 64,
        "film_transparent": 0,
    }
    image = render(
        build, setup.size, "Combined", **(settings | METHODS[method] | {"effects": EVERYTHING})
    )
    return float(np.abs(image.pixels[..., :3].astype(np.float64).mean() - 1))


def basin(method: str) -> float:
    """A medium whose mesh is opaque but for the top, in a uniform world: photons as walks."""
    mesh = box((-1, -1, -1), (1, 1, 1))
    is_wall = np.any(mesh.positions[mesh.triangles][..., 2] < 0, axis=1)
    setup = Setup(
        (Body(mesh, 1.0, 1.0, 0.0, black=is_wall),),
        (),
        Camera((0.01, 0.02, 4), window=0.3, is_perspective=True),
        size=4,
    )

    def build(scene: object) -> None:
        setup.build(scene)
        scene.set_world((1.0, 1.0, 1.0))

    means = []
    for estimator, samples in (("WALK", 1024), (method, 64)):
        settings = {"threads": 1, "light_samples": 2**18, "samples": samples}
        settings |= METHODS[estimator] | {"effects": EVERYTHING}
        image = render(build, setup.size, "Combined", **settings)
        means.append(float(image.pixels[..., :3].astype(np.float64).mean()))
    return abs(means[1] / means[0] - 1)


def all_light(setup: Setup, method: str, **params: object) -> np.ndarray:
    """All orders together, RGB."""
    from scenes import picture

    return sum(
        picture(setup, method, f"{order} Scattering", effects=EVERYTHING, **params)
        for order in ("Single", "Double", "Multiple")
    )


def scaled(method: str, scale: float) -> float:
    """The picture of all orders in a world of another size."""
    setup = Setup(
        (Body(BALL, 1.3, 3.0, 0.3, 0.5),),
        (Lamp(SUN),),
        Camera((4, 1, 2), (-4, -1, -2), window=1.5),
        size=4,
    )
    a, b = (all_light(setup.placed(scale=s), method, samples=16) for s in (scale, 1.0))
    return difference(a, b)


def nothing(method: str) -> float:
    """Of a medium that only absorbs."""
    setup = Setup((Body(BALL, 1.3, 0.0, 3.0),), (Lamp(SUN),), Camera(window=1.5), size=2)
    return float(all_light(setup, method).max())


def thin(method: str) -> float:
    """Where next to nothing scatters, what scatters twice is nothing beside it."""
    setup = Setup((Body(BALL, 1.3, 1e-6, 0.0),), (Lamp(SUN),), Camera(window=1.5), size=2)
    first = mean(setup, method, effects=EVERYTHING)
    return float((all_light(setup, method).mean(axis=(0, 1)) / first).max() - 1)


FURNACE = "radiance 1 in a world of radiance 1; absolute"
CASES = [
    *(
        Case(
            f"furnace, radius {r:g}, g = {g:g}, ior {n:.8g}",
            FURNACE,
            2e-2,
            lambda m, r=r, g=g, n=n: furnace(m, r, g, n),
            ORDERS,
            bound_points=0.1,
        )
        for r, g, n in (
            (1e-6, 0.0, 1.5),
            (1.0, 0.0, 1.0),
            (1.0, 0.9, 1.5),
            (1.0, -0.9, 1.3),
            (10.0, 0.0, 1.0),
            (10.0, 0.0, 1.5),
            (10.0, 0.999, 1.3),
            (1.0, 0.0, 0.8),
            (1.0, 0.0, 1 + 2**-23),
            (1.0, 0.0, 2.4),
        )
    ),
    *(
        Case(
            f"furnace, smooth ball of {20 * 4**k} faces, ior 1.5",
            FURNACE,
            5e-3,
            lambda m, k=k: furnace(m, 1.0, 0.0, 1.5, icosphere(k)),
            ORDERS,
            bound_points=0.1,
        )
        for k in (0, 1)
    ),
    *(
        Case(
            f"medium of half width {half:g} in {'an open' if is_open else 'a'} room of 2",
            "radiance 1 where the walls have 1; absolute",
            5e-2,
            lambda m, half=half, is_open=is_open: room(m, half, is_open),
            ORDERS,
            bound_points=0.1,
        )
        for half in (1.9, 1.999, 2.5)
        for is_open in (False, True)
    ),
    Case("basin of opaque walls", "walks; relative", 5e-2, basin, ("PHOTONS",)),
    *(
        Case(
            f"all orders, world {s:g} times as large",
            "the same picture; rel_rmse",
            1e-2,
            lambda m, s=s: scaled(m, s),
            ORDERS,
        )
        for s in (1e-6, 1e6)
    ),
    Case("all orders, no scattering", "nothing; W m^-2 sr^-1", 0.0, nothing, ORDERS),
    Case("all orders, optical radius 1e-6", "single scattering; excess", 1e-4, thin, ORDERS),
]
