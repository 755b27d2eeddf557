# SPDX-License-Identifier: GPL-3.0-or-later
"""The project's own reference of the bumpy case, and both estimators against it.

references/bumpy_32.npy is the work of ref_bumpy.py, which shares nothing with the library. It is
itself compared with the exact sphere and, where the shared cases are present, with SmallUPBP.
"""

from __future__ import annotations

from pathlib import Path

import metrics
import numpy as np
import pytest
from api import (
    ESTIMATORS,
    LIBRARY,
    SPECULAR,
    TRIANGLES,
    Medium,
    add_body,
    add_point,
    handles,
    render,
    set_perspective,
)
from cases import case_folder
from meshes import bumpy_sphere, icosphere
from oracles import SphereLight, SphereMedium, refracting_sphere
from ref_bumpy import LightTubes, Surface, bumpy_scene, trace

REFERENCE = np.load(Path(__file__).parent / "references/bumpy_32.npy").astype(np.float64)
IMAGE, MASK = REFERENCE[..., :3], REFERENCE[..., 3] > 0


def test_tubes_against_the_quadrature_of_a_sphere() -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(-0.8, 0.8, (60, 2))
    xy = xy[np.hypot(*xy.T) < 0.75]
    direction = np.column_stack([xy, np.full(len(xy), -5.0)])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    origin = np.tile([0.0, 0.0, 5.0], (len(xy), 1))
    scene = bumpy_scene(icosphere(5))
    value, seen = trace(LightTubes(scene, Surface(scene.mesh), refinement=1), origin, direction)
    assert seen.all()
    distance = float(np.linalg.norm(scene.light))
    light = SphereLight(scene.light / distance, distance, scene.intensity)
    medium = SphereMedium(scene.n, scene.sigma_s[1], scene.sigma_t[1], scene.g)
    exact = np.array([refracting_sphere(origin[0], d, light, medium) for d in direction])
    assert value[:, 1] == pytest.approx(exact, rel=2e-3)
    assert value[:, 1].sum() == pytest.approx(exact.sum(), rel=1e-4)


def test_reference_against_upbp() -> None:
    first, second = (
        metrics.box_down(np.load(case_folder("bumpy") / f"ref_128_{run}.npy"), 4) for run in "AB"
    )
    both = (first + second) / 2
    assert metrics.mean_ratio(IMAGE, both, MASK) == pytest.approx(np.ones(3), abs=1e-3)
    # The noise of the two runs cancels; what is left is the sampling of the pixels.
    error = metrics.cross_mse(IMAGE, first, second, MASK) / both[MASK].mean() ** 2
    assert error < 5e-5


@pytest.mark.skipif(not LIBRARY.is_file(), reason=f"{LIBRARY} is not built")
@pytest.mark.parametrize("estimator", ESTIMATORS.values(), ids=ESTIMATORS.keys())
def test_estimators_against_the_reference(estimator: int) -> None:
    scene = bumpy_scene(bumpy_sphere(5))

    def build(handle: handles.Scene) -> None:
        add_body(
            handle,
            scene.mesh,
            Medium(scene.n, scene.sigma_s, scene.sigma_t - scene.sigma_s, scene.g),
        )
        add_point(handle, scene.light, scene.intensity)
        set_perspective(handle, (0, 0, 5), (0, 0, -1), (0, 1, 0), np.radians(30))

    errors = []
    settings = ((2**13, 16, 0), (2**20, 8, 2))
    # Exact connections have no setting.
    for light_samples, kernel_size, refinement in settings[estimator == SPECULAR :]:
        image = render(
            build,
            32,
            estimator=estimator,
            light_samples=light_samples,
            kernel_size=kernel_size,
            tube_refinement=refinement,
            samples=64,
        )
        # Pixels that a few samples of 784 touch may be missed by 64.
        assert np.all(REFERENCE[..., 3][image.cover == 0] < 0.05)
        errors.append(metrics.floored_rel(image.pixels, IMAGE, MASK))
    assert metrics.mean_ratio(image.pixels, IMAGE, MASK) == pytest.approx(np.ones(3), abs=3e-3)
    assert metrics.rel_rmse(image.pixels, IMAGE, MASK) < 0.06
    # What is left at the end is mostly the 64 camera samples of a pixel.
    assert errors[-1] < 0.045
    # The mesh's own triangles are enough, few samples of points are not.
    assert (errors[0] < 0.045) == (estimator in TRIANGLES.values())
