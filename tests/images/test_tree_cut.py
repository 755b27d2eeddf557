# SPDX-License-Identifier: GPL-3.0-or-later
"""TREE_CUT against random walks: double scattering is right where walls reflect nothing, and what
the method leaves out is missing where they do. tests/bench/bench_tree_cut.py measures it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from api import _ffi, add_point, handles, library
from order_scenes import Camera, reference_scene

CAMERA = Camera((0, 0, 5), (0, 0, -1), (0, 1, 0), (1.6, 1.6), is_pinhole=False)
PASSES = ["Double Scattering", "Multiple Scattering"]


def means(radius: float, ior: float, estimator: int, samples: int, **params: int) -> list[float]:
    """Means of both passes, over a sphere of this optical radius lit by a point lamp."""
    body = replace(reference_scene("sphere", radius), ior=ior, lamps=[], camera=CAMERA)
    effects = _ffi.AMB_EFFECT_DOUBLE_SCATTERING | _ffi.AMB_EFFECT_MULTIPLE_SCATTERING
    with handles.Scene(library.load()) as scene:
        body.build(scene)
        add_point(scene, (-1.6, 1.4, 2.8), 20.0)
        scene.commit()
        with scene.start(
            width=8,
            height=8,
            samples=samples,
            effects=effects,
            scatter_estimator=estimator,
            camera_bounces=8,
            light_samples=200_000,
            **params,
        ) as job:
            job.wait()
            assert job.report()["nonfinite"] == 0
            return [float(np.mean(job.read_pass(name))) for name in PASSES]


# Walks of 64 samples in 64 pixels leave 0.7 %, a cut is within 1 or 2 % of the sum of its leaves.
@pytest.mark.parametrize("radius", [0.3, 2.0])
def test_double_scattering_without_walls(radius: float) -> None:
    walk = means(radius, 1.0, _ffi.AMB_SCATTER_WALK, 64)
    cut = means(radius, 1.0, _ffi.AMB_SCATTER_TREE_CUT, 4)
    assert cut[0] == pytest.approx(walk[0], rel=0.03)
    # The table has no boundary: what has left the sphere comes back.
    assert 1.4 < cut[1] / walk[1] < 2.0


def test_light_between_walls_is_missing() -> None:
    walk = means(0.3, 1.5, _ffi.AMB_SCATTER_WALK, 64)
    cut = means(0.3, 1.5, _ffi.AMB_SCATTER_TREE_CUT, 4)
    assert 0.4 < cut[0] / walk[0] < 0.8
    assert cut[1] / walk[1] < 0.4


def test_orders_are_limited() -> None:
    cut = means(2.0, 1.0, _ffi.AMB_SCATTER_TREE_CUT, 1)
    two = means(2.0, 1.0, _ffi.AMB_SCATTER_TREE_CUT, 1, scatter_order_max=2)
    four = means(2.0, 1.0, _ffi.AMB_SCATTER_TREE_CUT, 1, scatter_order_max=4)
    # Both orders share one cut: another table leads to a slightly different one.
    assert two[0] == pytest.approx(cut[0], rel=0.01)
    assert two[1] == 0
    assert 0.3 < four[1] / cut[1] < 0.9
