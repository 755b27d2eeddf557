# SPDX-License-Identifier: GPL-3.0-or-later
"""Later orders of scattering by photons: a white furnace, and means against random walks, which
share nothing with them but the light field of the last scattering."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from api import (
    BuildScene,
    Medium,
    _ffi,
    add_body,
    add_point,
    handles,
    library,
    rgb,
    set_perspective,
)
from meshes import Mesh, box, icosphere, lathe
from numpy.typing import NDArray
from order_scenes import ORDERS, passes, reference_scene, stored_orders, whole

SINGLE = _ffi.AMB_EFFECT_SINGLE_SCATTERING
DOUBLE = _ffi.AMB_EFFECT_DOUBLE_SCATTERING
MULTIPLE = _ffi.AMB_EFFECT_MULTIPLE_SCATTERING
WORLD = _ffi.AMB_EFFECT_WORLD_LIGHT
WALK, PHOTONS = _ffi.AMB_SCATTER_WALK, _ffi.AMB_SCATTER_PHOTONS
PASSES = ("Single Scattering", "Double Scattering", "Multiple Scattering")
BALL = icosphere(4)


def shoot(
    build: BuildScene, size: int, **params: Any
) -> tuple[NDArray[np.float64], dict[str, Any]]:
    """Passes of the orders and Combined, (4, height, width, 3), and the report."""
    settings = {
        "light_bounces": 0,
        "camera_bounces": 0,
        "adjoint_normals": 0,
        "width": size,
        "height": size,
        "effects": DOUBLE | MULTIPLE,
        "light_samples": 2**17,
    } | params
    with handles.Scene(library.load()) as scene:
        build(scene)
        scene.commit()
        with scene.start(**settings) as job:
            job.wait()
            passes = [job.read_pass(name)[..., :3] for name in (*PASSES, "Combined")]
            return np.array(passes, dtype=np.float64), job.report()


def means(build: Any, size: int, **params: Any) -> NDArray[np.float64]:  # noqa: ANN401
    """Of each order's green."""
    return shoot(build, size, **params)[0][:3, :, :, 1].mean(axis=(1, 2))


def walk_means(
    build: Any,  # noqa: ANN401
    size: int,
    **params: Any,  # noqa: ANN401
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The same of two independent renders by walks, and the standard error of their mean."""
    a, b = (
        shoot(build, size, scatter_estimator=WALK, seed=seed, **params)[0][:3, :, :, 1]
        for seed in (1, 2)
    )
    error = np.sqrt(((a - b) ** 2).sum(axis=(1, 2))) / (2 * size * size)
    return (a + b).mean(axis=(1, 2)) / 2, error


CANDLE = lathe([(0, -0.78), (0.5, -0.78), (0.5, 0.75), (0.45, 0.8), (0.3, 0.7), (0, 0.65)])


def candle_regions(estimator: int, **params: int) -> NDArray[np.float64]:
    """Mean radiance of the top, the side and the foot of a smooth candle of six points, whose
    normals turn by up to 45 degrees along the side."""

    def build(scene: handles.Scene) -> None:
        add_body(scene, CANDLE, Medium(1.4, 3.0, 0.03))
        add_point(scene, (0, -0.3, 1.3), 10.0)
        set_perspective(scene, (0, -5, 0), (0, 1, 0), (0, 0, 1), 0.36)

    smooth = {"adjoint_normals": 1, "light_bounces": 16, "camera_bounces": 16}
    settings = smooth | {"effects": SINGLE | DOUBLE | MULTIPLE, "scatter_estimator": estimator}
    rows = shoot(build, 16, **settings | params)[0][3].mean(axis=(1, 2))
    return np.array([rows[11:].mean(), rows[5:11].mean(), rows[:5].mean()])


def test_normals_far_from_their_faces() -> None:
    """By photons as by walks."""
    walks = np.mean([candle_regions(WALK, samples=128, seed=seed) for seed in (1, 2)], axis=0)
    budget = {"samples": 32, "light_samples": 2**20}
    photons = np.mean([candle_regions(PHOTONS, seed=seed, **budget) for seed in (1, 2)], axis=0)
    assert photons == pytest.approx(walks, rel=0.03)


def test_white_furnace() -> None:
    """Nothing absorbs: every pixel shows the world."""

    def build(scene: handles.Scene) -> None:
        add_body(scene, BALL, Medium(1.5, 8.0, 0.0, 0.3))
        scene.set_world([1.0, 1.0, 1.0])
        set_perspective(scene, (0, 0, 5), (0, 0, -1), (0, 1, 0), 0.3)

    everything = (
        SINGLE
        | DOUBLE
        | MULTIPLE
        | WORLD
        | _ffi.AMB_EFFECT_SURFACE_REFLECTION
        | _ffi.AMB_EFFECT_BACKGROUND
    )
    passes, report = shoot(
        build, 12, effects=everything, scatter_estimator=PHOTONS, camera_bounces=4, samples=16
    )
    assert report["scatter"]["estimator"] == "PHOTONS"
    combined = passes[3, :, :, 1]
    assert combined.mean() == pytest.approx(1.0, abs=0.01)
    assert np.sqrt(((combined - 1) ** 2).mean()) < 0.06
    scattered = passes[:3].sum(axis=0)[..., 1].mean()
    assert 0.8 < scattered < 1.0


def lamp(
    optical_radius: float,
    albedo: float,
    g: float,
    mesh: Mesh = BALL,
    place: tuple[float, float, float] = (4, 2, 3),
) -> Any:  # noqa: ANN401
    def build(scene: handles.Scene) -> None:
        sigma = optical_radius
        add_body(scene, mesh, Medium(1.5, sigma * albedo, sigma * (1 - albedo), g))
        add_point(scene, place, 100.0)
        set_perspective(scene, (0, 0, 5), (0, 0, -1), (0, 1, 0), 0.35)

    return build


@pytest.mark.parametrize(
    ("build", "samples"),
    [
        pytest.param(lamp(2.0, 0.9, 0.0), 32, id="thin"),
        pytest.param(lamp(6.0, 0.8, 0.5), 24, id="forward"),
        pytest.param(lamp(3.0, 0.9, 0.8, place=(4, 2, -3)), 32, id="sharp"),
        pytest.param(lamp(5.0, 0.9, 0.0, box((-0.6, -0.5, -0.7), (0.6, 0.7, 0.5))), 24, id="box"),
    ],
)
def test_means_against_walks(build: Any, samples: int) -> None:  # noqa: ANN401
    walk, error = walk_means(build, 16, samples=samples)
    photons = means(build, 16, scatter_estimator=PHOTONS, samples=4)
    for k in (1, 2):
        assert photons[k] == pytest.approx(walk[k], abs=3.5 * error[k] + 0.015 * walk[k]), k
        assert error[k] < 0.03 * walk[k]


def test_flat_walls_against_the_tracer() -> None:
    """A slab, whose layers lines measure all alike, against the independent path tracer."""
    known, known_error = whole(stored_orders("slab", 10.0))
    settings = {"scatter_estimator": PHOTONS, "effects": DOUBLE | MULTIPLE, "samples": 4}
    scene = reference_scene("slab", 10.0)
    runs = np.array(
        [passes(scene, 24, light_samples=2**18, seed=seed, **settings) for seed in range(3)]
    ).mean(axis=(1, 2))
    photons, error = runs.mean(axis=0), runs.std(axis=0, ddof=1) / np.sqrt(len(runs))
    for k, names in ((1, ["2"]), (2, ["3", "4+"])):
        columns = [ORDERS.index(name) for name in names]
        mean = known[columns].sum()
        both = np.hypot(error[k], np.linalg.norm(known_error[columns]))
        assert both < 0.02 * mean
        assert photons[k] == pytest.approx(mean, abs=3.5 * both + 0.015 * mean), names


@pytest.mark.parametrize("g", [0.0, 0.85])
def test_surroundings_against_walks(g: float) -> None:
    """Light of the world and of a lit floor, of all orders; the peak of a sharp lobe looks at them
    straight through the medium."""

    def build(scene: handles.Scene) -> None:
        add_body(scene, BALL, Medium(1.4, 4.0, 0.4, g))
        floor = scene.add_material("floor", surface=_ffi.AMB_SURFACE_DIFFUSE, albedo=rgb(0.7))
        plate = box((-4, -4, -1.6), (4, 4, -1.3))
        shape = scene.add_mesh("floor", plate.positions, plate.triangles)
        scene.add_object("floor", shape, np.eye(4).tolist(), [floor])
        add_point(scene, (3, 0, 4), 40.0)
        scene.set_world([0.3, 0.3, 0.3])
        set_perspective(scene, (0, -5, 0), (0, 1, 0), (0, 0, 1), 0.3)

    effects = SINGLE | DOUBLE | MULTIPLE | WORLD
    walk, error = walk_means(build, 12, samples=96 if g == 0.0 else 480, effects=effects)
    runs = np.array(
        [
            means(build, 12, scatter_estimator=PHOTONS, samples=4, effects=effects, seed=seed)
            for seed in range(4)
        ]
    )
    photons, own = runs.mean(axis=0), runs.std(axis=0, ddof=1) / np.sqrt(len(runs))
    for k in range(3):
        both = np.hypot(error[k], own[k])
        assert photons[k] == pytest.approx(walk[k], abs=3.5 * both + 0.015 * walk[k]), k
        assert both < 0.04 * walk[k]


def test_auto_takes_photons_for_the_picture() -> None:
    """One for two camera samples: no less than a fourth of the volume samples, and no more than
    sixteen times that."""

    def build(scene: handles.Scene) -> None:
        add_body(scene, BALL, Medium(1.5, 2.0, 2.0))
        add_point(scene, (4, 2, 3), 100.0)
        set_perspective(scene, (0, 0, 5), (0, 0, -1), (0, 1, 0), np.radians(30))

    def photons(size: int, samples: int, **params: Any) -> int:  # noqa: ANN401
        report = shoot(build, size, samples=samples, light_samples=4000, **params)[1]
        assert report["scatter"]["estimator"] == "PHOTONS"
        return report["scatter"]["photons"]

    assert photons(8, 4) == 1000
    assert photons(32, 8) == 4096
    assert photons(64, 16) == 16000
    assert photons(64, 16, scatter_estimator=PHOTONS) == 1000


def test_clean_pictures_get_photons_to_match() -> None:
    """With effects AUTO a few photons tell what blotches all of them would leave: more where
    samples leave little noise beside these, three times as many at most."""

    def build(scene: handles.Scene) -> None:
        add_body(scene, BALL, Medium(1.5, 2.0, 2.0))
        add_point(scene, (4, 2, 3), 100.0)
        set_perspective(scene, (0, 0, 5), (0, 0, -1), (0, 1, 0), np.radians(30))

    def photons(**params: Any) -> int:  # noqa: ANN401
        report = shoot(build, 16, samples=64, light_samples=2**14, **params)[1]
        assert report["scatter"]["estimator"] == "PHOTONS"
        return report["scatter"]["photons"]

    planned = photons()
    assert planned == 8192
    assert planned < photons(effects_are_auto=1) <= 3 * planned
    assert photons(effects_are_auto=1, coarse_first=1) == planned


def test_straight_light_of_dense_media_is_finite() -> None:
    """What scatters straight on is e^tau times what does not scatter: at these depths e^tau is
    beyond all numbers, and what does not scatter is none."""

    def build(scene: handles.Scene) -> None:
        add_body(scene, BALL, Medium(1.3, 995.0, 5.0, 0.9))
        add_point(scene, (4, 2, 3), 100.0)
        scene.set_world((1.0, 1.0, 1.0))
        set_perspective(scene, (0, 0, 5), (0, 0, -1), (0, 1, 0), np.radians(20))

    settings = {"samples": 4, "light_samples": 2**12, "camera_bounces": 4}
    image, report = shoot(
        build, 8, scatter_estimator=PHOTONS, effects=SINGLE | DOUBLE | MULTIPLE | WORLD, **settings
    )
    assert report["nonfinite"] == 0
    assert np.isfinite(image).all() and image[2].mean() > 0.1
