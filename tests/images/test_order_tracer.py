# SPDX-License-Identifier: GPL-3.0-or-later
"""The independent path tracer against closed forms, so that the library may be held against it."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import box, bumpy_sphere, icosphere, large_slab
from oracles import Slab, half_space, slab_orders_of_world, sun_disc
from order_scenes import (
    ORDERS,
    TRACER,
    Ball,
    Camera,
    OrderScene,
    Rectangle,
    Sun,
    trace,
)

pytestmark = pytest.mark.skipif(not TRACER.is_file(), reason="no order_tracer: build preset dev")

SIGMAS = 4.0
ONE, ALL = ORDERS.index("1"), ORDERS.index("1+")


def tilted(angle: float, width: float = 0.5) -> Camera:
    """Looks at the origin, down on the plane z = 0, at this angle from its normal."""
    sin, cos = float(np.sin(angle)), float(np.cos(angle))
    return Camera((-10 * sin, 0, 10 * cos), (sin, 0, -cos), (0, 1, 0), (width, width), False)


def sun_at(cosine: float, radius: float = 0.3) -> Sun:
    return Sun((float(np.sqrt(1 - cosine**2)), 0.0, -cosine), radius, 1.0)


def check(scene: OrderScene, paths: float, expected: dict[str, float], most: float) -> None:
    """Each order within its standard error, which is at most ``most`` of it."""
    found = trace(scene, paths)
    mean, error = found.mean.mean(axis=(0, 1)), np.hypot.reduce(found.error, axis=(0, 1))
    error /= scene.regions[0] * scene.regions[1]
    for order, value in expected.items():
        k = ORDERS.index(order)
        assert error[k] < most * value
        assert abs(mean[k] - value) < SIGMAS * error[k], order


def test_half_space() -> None:
    """Orders 1, 2 and all of them, under a sun of 0.3 rad."""
    mu, mu0, albedo = 0.7, 0.5, 0.9
    sun = sun_at(mu0)
    d, share = sun_disc(sun.direction, sun.radius)
    one, two, every = (float(np.sum(share * x)) for x in half_space(mu, -d[:, 2], albedo))
    camera = tilted(np.arccos(mu))
    scene = OrderScene(
        large_slab(20, 100), 1.0, albedo, 1 - albedo, 0.0, camera, [sun], regions=(1, 1)
    )
    check(scene, 5e5, {"1": one, "2": two, "1+": every}, 0.02)


def test_slab_with_all_reflections() -> None:
    """Single scattering between two walls; the formula's phase function takes no azimuth at
    g = 0."""
    slab, sun = Slab(), sun_at(np.cos(np.radians(30)))
    d, share = sun_disc(sun.direction, sun.radius)
    expected = sum(
        Slab(light_angle=float(np.arccos(-z)), irradiance=float(w)).radiance_all_reflections()
        for z, w in zip(d[:, 2], share, strict=True)
    )
    sigma_a = slab.sigma_t - slab.sigma_s
    scene = OrderScene(
        large_slab(slab.thickness, 200),
        slab.n,
        slab.sigma_s,
        sigma_a,
        0.0,
        tilted(slab.camera_angle),
        [sun],
        regions=(1, 1),
    )
    check(scene, 1e6, {"1": expected}, 0.02)


def test_orders_of_the_world() -> None:
    tau, mu, albedo = 2.0, 0.7, 0.8
    camera = tilted(np.arccos(mu))
    mesh = large_slab(tau, 200)
    scene = OrderScene(mesh, 1.0, albedo, 1 - albedo, 0.0, camera, world=1.0, regions=(1, 1))
    expected = slab_orders_of_world(tau, albedo, mu, 40)
    by_name = dict(zip("0123", expected, strict=False)) | {"4+": sum(expected[4:])}
    check(scene, 1e5, by_name, 0.02)


@pytest.mark.parametrize(
    "lamp",
    [Rectangle((2.0, 1.0, 2.0), (1.5, 2.0), 1.0), Ball((2.0, 1.0, 2.0), 0.8, 1.0)],
    ids=["rectangle", "ball"],
)
def test_lamps(lamp: Rectangle | Ball) -> None:
    """Single scattering in a sphere of index 1, by quadrature over the lamp and along one ray."""
    sigma, eye = 1.0, np.array([0.3, -0.2, 5.0])
    u, weight = np.polynomial.legendre.leggauss(24)
    height = float(np.sqrt(1 - eye[0] ** 2 - eye[1] ** 2))
    t = height * (1 + u)
    x = np.array([eye[0], eye[1], height]) - t[:, None] * np.array([0, 0, 1.0])
    place = np.array(lamp.position)
    if isinstance(lamp, Rectangle):
        across = lamp.tangent
        upward = np.cross(lamp.axis, across)
        a, b = (g.ravel() for g in np.meshgrid(u, u))
        y = place + a[:, None] * across * lamp.size[0] / 2 + b[:, None] * upward * lamp.size[1] / 2
        radiance = lamp.radiance * np.outer(weight, weight).ravel() * np.prod(lamp.size) / 4
        to = y - x[:, None]
        square = np.sum(to**2, axis=-1)
        w = to / np.sqrt(square)[..., None]
        share = radiance * -(w @ lamp.axis) / square
    else:
        # The ball is a cone of directions of constant radiance.
        to = place - x
        distance = np.linalg.norm(to, axis=1)
        rows = [
            sun_disc(v, float(np.arcsin(lamp.radius / r)))
            for v, r in zip(to, distance, strict=True)
        ]
        w = np.stack([d for d, _ in rows])
        solid = [
            s * np.pi * (lamp.radius / r) ** 2 for (_, s), r in zip(rows, distance, strict=True)
        ]
        share = np.stack(solid) * lamp.intensity / (np.pi * lamp.radius**2)
    along = np.sum(x[:, None] * w, axis=-1)
    inside = -along + np.sqrt(along**2 + 1 - np.sum(x * x, axis=1)[:, None])
    source = sigma / (4 * np.pi) * np.sum(share * np.exp(-sigma * inside), axis=1)
    expected = float(np.sum(height * weight * np.exp(-sigma * t) * source))
    camera = Camera((0.3, -0.2, 5.0), (0, 0, -1), (0, 1, 0), (0.02, 0.02), False)
    scene = OrderScene(icosphere(5), 1.0, sigma, 0.0, 0.0, camera, [lamp], regions=(1, 1))
    check(scene, 1e6, {"1": expected}, 0.02)


@pytest.mark.parametrize("mesh", [icosphere(3), box((-1, -1, -1), (1, 1, 1)), bumpy_sphere(3)])
def test_white_furnace(mesh) -> None:
    """A path that loses nothing brings back the surround, whatever the index: all that is missing
    is what was counted as lost."""
    camera = Camera((0, 0, 5), (0, 0, -1), (0, 1, 0), (0.5, 0.5))
    scene = OrderScene(mesh, 1.5, 2.0, 0.0, 0.7, camera, world=1.0, reenters=True)
    found = trace(scene, 2e4)
    mean = found.mean.mean(axis=(0, 1))
    missing = found.data["lost"] + found.data["wrong_way"] + found.data["cut"]
    assert mean[0] + mean[ALL] == pytest.approx(1 - missing, abs=1e-6)
    assert missing < 0.01
    assert mean[ONE] > 0.01
