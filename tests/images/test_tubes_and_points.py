# SPDX-License-Identifier: GPL-3.0-or-later
"""Tubes carry the first stretches of the light, points what is reflected more often and what has
passed another object: together they are what points alone are."""

from __future__ import annotations

from typing import Any

import metrics
import numpy as np
import pytest
from api import (
    POINTS_COVARIANCE,
    POINTS_FIXED,
    SINGLE,
    TUBES,
    BuildScene,
    Image,
    Medium,
    _ffi,
    add_body,
    add_point,
    handles,
    render,
    set_perspective,
)
from meshes import Mesh, box, bumpy_sphere, icosphere

RESIN = Medium(1.5, 0.21, (0.01, 0.1, 0.25), 0.5)
LAMP = (-4.5, 1.5, -1.6)


def scene_of(mesh: Mesh, *others: tuple[Mesh, Medium]) -> BuildScene:
    def build(scene: handles.Scene) -> None:
        add_body(scene, mesh, RESIN)
        for other, medium in others:
            add_body(scene, other, medium)
        add_point(scene, LAMP, 100.0)
        set_perspective(scene, (1, 2, 5), (-0.2, -0.4, -1), (0, 1, 0), np.radians(40))

    return build


def shots(build: BuildScene, **settings: Any) -> tuple[Image, Image]:
    """By tubes and points together, and by points alone."""
    params = {"light_samples": 2**19, "samples": 4} | settings
    both, points = (
        render(build, 24, estimator=estimator, **params) for estimator in (TUBES, POINTS_COVARIANCE)
    )
    assert both.report["light"]["tubes"] > 0
    assert both.report["light"]["volume_samples"] > 0
    assert points.report["light"]["tubes"] == 0
    return both, points


def flux(image: Image) -> np.ndarray:
    return np.array(image.report["light"]["flux_interacting"])


@pytest.mark.parametrize("samples", [1, 8], ids=["whole", "in parts"])
@pytest.mark.parametrize(
    ("mesh", "refinement"),
    [(icosphere(5), 0), (box((-1, -0.8, -0.9), (1, 1.1, 1)), 2), (bumpy_sphere(4), 0)],
    ids=["ball", "box", "bumpy"],
)
def test_every_reflection_counts_once(mesh: Mesh, refinement: int, samples: int) -> None:
    build = scene_of(mesh)
    both, points = shots(build, light_bounces=8, tube_refinement=refinement, samples=samples)
    assert metrics.mean_ratio(both.pixels, points.pixels) == pytest.approx(np.ones(3), abs=4e-3)
    assert flux(both) == pytest.approx(flux(points), rel=2e-3)
    # Whether walls trap the light decides where points take over.
    first = render(build, 24, estimator=TUBES, light_bounces=0, tube_refinement=refinement)
    is_bumpy = len(mesh.triangles) == 5120
    assert (both.report["light"]["tubes"] == first.report["light"]["tubes"]) == is_bumpy


def test_light_through_another_object_counts_once() -> None:
    """A ball of glass throws a caustic into a part of the resin, and shades it from tubes."""
    ball = icosphere(4)
    glass = Mesh(ball.positions * 0.5 + np.array([-2.2, 0.9, -0.3]), ball.triangles, ball.normals)
    build = scene_of(icosphere(5), (glass, Medium(1.5, 0, 0)))
    settings = {
        "effects": SINGLE | _ffi.AMB_EFFECT_TRANSMITTED_LIGHT,
        "light_samples": 2**20,
        "light_bounces": 3,
    }
    both, points = shots(build, **settings)
    assert metrics.mean_ratio(both.pixels, points.pixels) == pytest.approx(np.ones(3), abs=4e-3)
    assert flux(both) == pytest.approx(flux(points), rel=2e-3)
    straight = render(build, 24, estimator=TUBES, light_bounces=3, light_samples=2**20)
    assert flux(straight)[1] < 0.95 * flux(both)[1]


def test_a_first_reflection_is_left_to_points_where_walls_strew_it() -> None:
    """A bumpy wall makes five times as many tubes, which cross one another; a ball's stay side by
    side. By hand one reflection is the tubes' own, whatever the wall."""
    settings = {"samples": 1, "light_samples": 2**12, "accuracy": 0.02, "camera_bounces": 0}
    found = {}
    for name, mesh in (("bumpy", bumpy_sphere(4)), ("ball", icosphere(4))):
        build = scene_of(mesh)
        auto = render(build, 4, light_bounces=0, effects_are_auto=1, **settings).report
        hand = render(build, 4, light_bounces=1, **settings).report
        assert (auto["estimator"], hand["estimator"]) == ("TUBES", "TUBES")
        counts = {e["name"]: e["count"] for e in auto["effects"]}
        assert counts["light-side internal reflection"] > 0
        assert hand["light"]["volume_samples"] == 0
        found[name] = (auto["light"]["volume_samples"] > 0, auto["light"]["tube_bounces"] > 0)
    assert found == {"bumpy": (True, False), "ball": (False, True)}


LATER = _ffi.AMB_EFFECT_DOUBLE_SCATTERING | _ffi.AMB_EFFECT_MULTIPLE_SCATTERING


@pytest.mark.parametrize(
    ("estimator", "bounces", "effects"),
    [
        (TUBES, 1, SINGLE),
        (POINTS_FIXED, 8, SINGLE | _ffi.AMB_EFFECT_TRANSMITTED_LIGHT),
        (POINTS_COVARIANCE, 8, SINGLE | _ffi.AMB_EFFECT_TRANSMITTED_LIGHT),
        (TUBES, 8, SINGLE | _ffi.AMB_EFFECT_TRANSMITTED_LIGHT),
        (TUBES, 8, SINGLE | LATER | _ffi.AMB_EFFECT_TRANSMITTED_LIGHT),
    ],
    ids=["tubes", "fixed points", "points", "both", "walks"],
)
def test_the_share_of_what_light_did_before(estimator: int, bounces: int, effects: int) -> None:
    """What the picture lacks without reflections of the light, and without light through other
    objects, is what the report of the picture with them says."""
    ball = icosphere(4)
    glass = Mesh(ball.positions * 0.5 + np.array([-2.2, 0.9, -0.3]), ball.triangles, ball.normals)
    build = scene_of(icosphere(4), (glass, Medium(1.5, 0, 0)))

    def shot(**changed: Any) -> Image:
        settings = {
            "light_samples": 2**17,
            "samples": 8,
            "scatter_estimator": _ffi.AMB_SCATTER_WALK,
        }
        settings |= {"light_bounces": bounces, "effects": effects} | changed
        return render(build, 24, name="Combined", estimator=estimator, **settings)

    full = shot()
    has_both = estimator == TUBES and (effects & _ffi.AMB_EFFECT_TRANSMITTED_LIGHT) != 0
    assert (full.report["light"]["tubes"] > 0) == (estimator == TUBES)
    assert (full.report["light"]["volume_samples"] > 0) == (estimator != TUBES or has_both)
    less = {
        "light-side internal reflection": shot(light_bounces=0),
        "light through other objects": shot(effects=effects & ~_ffi.AMB_EFFECT_TRANSMITTED_LIGHT),
    }
    found = {effect["name"]: effect for effect in full.report["effects"]}
    mask = full.cover > 0
    whole = full.pixels[mask][:, :3].mean(axis=1, dtype=np.float64)
    for name, without in less.items():
        lacks = whole - without.pixels[mask][:, :3].mean(axis=1, dtype=np.float64)
        if name == "light through other objects" and effects == SINGLE:
            assert found[name]["measured"] is None and found[name]["cpu_s"] is None
            continue
        share = np.sqrt(np.mean(lacks**2)) / whole.mean()
        assert found[name]["measured"] == pytest.approx(share, rel=0.02)
        assert share > 0.02 and found[name]["cpu_s"] > 0
        assert {e["measured"] for e in without.report["effects"] if e["name"] == name} == {None}
    total = sum(effect["cpu_s"] or 0 for effect in found.values())
    assert total < sum(stage["cpu_s"] for stage in full.report["stages"])


def test_the_target_is_kept_by_both() -> None:
    """The stated error has the levels of tubes and those of points in it."""
    build = scene_of(bumpy_sphere(4))
    settings = {"light_bounces": 8, "light_samples": 2**18}
    found = render(build, 24, estimator=TUBES, accuracy=0.08, seed=3, **settings)
    budget = settings | {"light_samples": 2**21, "tube_refinement": 1}
    truth = render(build, 24, estimator=TUBES, samples=128, seed=4, **budget)
    stated = found.report["accuracy"]
    assert stated["reached"] and found.report["light"]["volume_samples"] > 0
    mask = truth.cover > 0
    true = metrics.rel_rmse(found.pixels, truth.pixels, mask)
    assert 0.4 * stated["stated"] < true < 1.5 * stated["stated"]
