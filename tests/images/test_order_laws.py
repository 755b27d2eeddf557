# SPDX-License-Identifier: GPL-3.0-or-later
"""What orders of scattering obey whatever the scene: closed forms, the white furnace, the balance
of flux, reciprocity."""

from __future__ import annotations

import numpy as np
import pytest
from api import TUBES, render
from meshes import Mesh, box, bumpy_sphere, icosphere, large_slab
from oracles import half_space, infinite_medium, slab_orders_of_world
from order_scenes import (
    DOUBLE,
    SCATTERED,
    SEEN,
    SINGLE,
    WALK,
    WORLD,
    Ball,
    Camera,
    OrderScene,
    Sun,
    balance,
    passes,
)

SIGMAS = 4.0


def mean_of(runs: list[float]) -> tuple[float, float]:
    """Mean and its standard error."""
    values = np.array(runs)
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values)))


def check(runs: list[float], expected: float, most: float, bias: float = 0.0) -> None:
    """Within the standard error of the runs, which is at most ``most`` of the value."""
    mean, error = mean_of(runs)
    assert error < most * expected
    assert abs(mean - expected) < SIGMAS * error + bias * expected


def tilted(mu: float, width: float = 0.5) -> Camera:
    """Down on the plane z = 0, at this cosine."""
    sin = float(np.sqrt(1 - mu * mu))
    return Camera((-10 * sin, 0, 10 * mu), (sin, 0, -mu), (0, 1, 0), (width, width), False)


# ---- Closed forms --------------------------------------------------------------------------------


def test_half_space() -> None:
    """Order 2 in closed form, all orders by Chandrasekhar's H; sun without extent."""
    mu, mu0, albedo = 0.7, 0.5, 0.9
    sun = Sun((float(np.sqrt(1 - mu0 * mu0)), 0.0, -mu0), 0.0, 1.0)
    # Its edges are out of sight: 15 free paths away, on all sides.
    mesh = large_slab(20, 15)
    scene = OrderScene(mesh, 1.0, albedo, 1 - albedo, 0.0, tilted(mu), [sun], regions=(1, 1))
    one, two, every = (float(x[0]) for x in half_space(mu, mu0, albedo))
    runs = [
        passes(scene, 16, seed=k, samples=16, estimator=TUBES, light_bounces=0)[0, 0]
        for k in range(8)
    ]
    assert np.mean(runs, axis=0)[0] == pytest.approx(one, rel=1e-3)
    check([float(run[1]) for run in runs], two, 0.01)
    check([float(run.sum()) for run in runs], every, 0.01)


def test_lamp_and_camera_in_an_infinite_medium() -> None:
    """Orders 1 and 2 of a point of one watt, past which the camera looks at a distance of half a
    free path. Beyond the sphere there is exp(-5) of the light, of which a hundredth
    comes back."""
    one, two = infinite_medium(offset=0.5, start=2.0, albedo=1.0)
    lamp = Ball((0, 0, 0), 0.0, 1 / (4 * np.pi))
    camera = Camera((-2, 0.5, 0), (1, 0, 0), (0, 0, 1), (0.002, 0.002), False)
    ball = icosphere(3)
    mesh = Mesh(5 * ball.positions, ball.triangles, ball.normals)
    scene = OrderScene(mesh, 1.0, 1.0, 0.0, 0.0, camera, [lamp], regions=(1, 1))
    runs = [
        passes(
            scene,
            16,
            seed=k,
            samples=64,
            light_bounces=0,
            camera_bounces=0,
            light_samples=2**17,
            kernel_size=1.0,
            effects=SINGLE | DOUBLE,
        )[0, 0]
        for k in range(8)
    ]
    check([float(run[0]) for run in runs], one, 0.01, bias=0.005)
    check([float(run[1]) for run in runs], two, 0.02, bias=0.005)


def test_orders_of_the_world() -> None:
    """A slab in a uniform world, order by order."""
    tau, mu, albedo = 2.0, 0.7, 0.8
    camera, mesh = tilted(mu), large_slab(tau, 40)
    scene = OrderScene(mesh, 1.0, albedo, 1 - albedo, 0.0, camera, world=1.0, regions=(1, 1))
    known = slab_orders_of_world(tau, albedo, mu, 40)
    runs = [
        passes(scene, 16, seed=k, samples=32, effects=SCATTERED | WORLD)[0, 0] for k in range(8)
    ]
    for k, expected in enumerate([known[1], known[2], sum(known[3:])]):
        check([float(run[k]) for run in runs], expected, 0.015)


# ---- White furnace -------------------------------------------------------------------------------


def furnace(scene: OrderScene, order_max: int = 0, samples: int = 16, runs: int = 6) -> np.ndarray:
    """Combined radiance, (runs, height, width), with all that is seen."""
    settings = {
        "name": "Combined",
        "effects": SCATTERED | WORLD | SEEN,
        "camera_bounces": 64,
        "film_transparent": 0,
        "scatter_estimator": WALK,
        "scatter_order_max": order_max,
        "samples": samples,
    }
    pixels = [render(scene.build, 16, seed=k, **settings).pixels[..., 1] for k in range(runs)]
    return np.array(pixels, dtype=np.float64)


FRONT = Camera((0, 0, 5), (0, 0, -1), (0, 1, 0), (0.5, 0.5))
WHOLE = Camera((0, 0, 4), (0, 0, -1), (0, 1, 0), (2.3, 2.3), False)


@pytest.mark.parametrize(
    ("mesh", "ior", "sigma_s", "g"),
    [
        (icosphere(4), 1.0, 2.0, 0.7),
        (icosphere(4), 1.5, 2.0, 0.0),
        (icosphere(4), 0.8, 0.5, 0.9),
        (icosphere(1), 1.5, 2.0, 0.0),  # normals far from the faces': directions behind these
        (icosphere(2), 2.4, 1.0, 0.5),
        (box((-1, -1, -1), (1, 0.5, 1)), 1.5, 5.0, 0.3),
        (bumpy_sphere(4), 1.0, 10.0, -0.5),
        (bumpy_sphere(2), 1.33, 1.0, 0.6),
        (bumpy_sphere(4), 1.33, 1.0, 0.6),
    ],
)
def test_white_furnace(mesh: Mesh, ior: float, sigma_s: float, g: float) -> None:
    """Nothing absorbs: every pixel equals the surround, on the object, at its rim and beside it.
    Walks know what they may find inside and outside, and have next to no noise here."""
    scene = OrderScene(mesh, ior, sigma_s, 0.0, g, WHOLE, world=1.0)
    pixels = furnace(scene)
    check([float(run.mean()) for run in pixels], 1.0, 0.001, 1e-4)
    # Single pixels have the long tails of few samples: blocks of 4 x 4.
    blocks = pixels.reshape(len(pixels), 4, 4, 4, 4).mean(axis=(2, 4))
    spread = np.sqrt(np.mean(blocks.var(axis=0, ddof=1)) / len(pixels))
    assert spread < 0.003
    assert np.all(np.abs(blocks.mean(axis=0) - 1) < 5 * spread + 1e-4)


def test_partial_sums_rise_to_the_surround() -> None:
    scene = OrderScene(icosphere(4), 1.5, 2.0, 0.0, 0.4, FRONT, world=1.0)
    sums = [float(furnace(scene, order).mean()) for order in (1, 2, 4, 8, 16, 0)]
    assert np.all(np.diff(sums) > -0.01)
    assert np.all(np.diff(sums[:4]) > 0.01)
    assert sums[0] < 0.9
    assert sums[-1] == pytest.approx(1, abs=0.001)


# ---- Flux ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ior", "albedo", "g"),
    [(1.0, 0.7, 0.5), (1.5, 0.7, 0.0), (1.5, 1.0, 0.3), (2.4, 0.7, 0.0), (0.75, 0.7, 0.0)],
)
def test_flux_in_is_absorbed_or_comes_out(ior: float, albedo: float, g: float) -> None:
    """What interacts with a medium comes out again or stays there. The three are measured by three
    different ways: light rays, walks from the camera to a lamp, walks to the world. With more
    samples they agree within 0.2 %: tests/bench/bench_orders.py."""
    found = balance(ior, albedo, g, runs=4)
    assert found.error < 6e-3
    assert (found.absorbed > 0.2) == (albedo < 1)
    assert found.out > 0.1
    assert abs(found.out + found.absorbed - 1) < SIGMAS * found.error + 1e-3


@pytest.mark.parametrize("ior", [1.5, 2.0])
def test_reflections_of_light_and_camera_are_reciprocal(ior: float) -> None:
    """A sphere under a sun, seen whole along another direction: to swap the two changes nothing,
    hence internal reflections of the light add what those of the camera do."""
    sun = Sun((0.6, 0.0, -0.8), 0.0, 1.0)
    camera = Camera((0, 0, 4), (0, 0, -1), (0, 1, 0), (2.1, 2.1), False)
    scene = OrderScene(icosphere(4), ior, 0.3, 0.1, 0.6, camera, [sun], regions=(1, 1))

    def total(light: int, camera: int) -> float:
        return float(
            np.mean(
                [
                    passes(
                        scene,
                        32,
                        seed=k,
                        samples=4,
                        effects=SINGLE,
                        light_bounces=light,
                        camera_bounces=camera,
                        light_samples=2**15,
                    )[0, 0, 0]
                    for k in range(4)
                ]
            )
        )

    none, light, camera_side = total(0, 0), total(6, 0), total(0, 6)
    assert light > 1.01 * none
    assert light == pytest.approx(camera_side, rel=5e-3)
