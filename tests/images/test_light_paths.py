# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes where light or camera take a way that is easily forgotten: through another object, from
inside one, past a small one, through a slot that no face uses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from api import (
    POINTS_COVARIANCE,
    SINGLE,
    Medium,
    add_body,
    add_point,
    add_sun,
    rgb,
    set_orthographic,
    set_perspective,
)
from api import _ffi as ffi
from api import radiance as mean_radiance
from api import render as render_image
from meshes import Mesh, box, icosphere

THROUGH = SINGLE | ffi.AMB_EFFECT_TRANSMITTED_LIGHT
RESIN = Medium(1.5, 0.3, 0.1, 0.5)
BALL = icosphere(4)
VIEW = (set_perspective, ((0, 0, 6), (0, 0, -1), (0, 1, 0), 0.4))
LAMP = (add_point, ((-4, 3, 2), 100.0))


def moved(mesh: Mesh, scale: float, shift: tuple[float, float, float]) -> Mesh:
    """The mesh at another size and place; normals stay."""
    return Mesh(mesh.positions * scale + np.array(shift), mesh.triangles, mesh.normals)


def scene_of(*parts: tuple[Callable[..., None], tuple[Any, ...]]) -> Callable[[Any], None]:
    """A builder from (function, arguments after the scene) pairs."""

    def build(scene: Any) -> None:  # noqa: ANN401 - the binding's handle
        for function, arguments in parts:
            function(scene, *arguments)

    return build


def mean(*parts: tuple[Callable[..., None], tuple[Any, ...]], **params: object) -> float:
    settings = {
        "estimator": POINTS_COVARIANCE,
        "light_samples": 2**18,
        "samples": 4,
        "effects": THROUGH,
    } | params
    return float(mean_radiance(scene_of(*parts), 32, **settings).mean())


@pytest.mark.parametrize(("ior", "expected"), [(1.0, 1.0), (1.5, 0.96**2)])
def test_light_passes_a_pane(ior: float, expected: float) -> None:
    """A clear plate square to the sun takes two reflections of 4 % from the light."""
    sun = (add_sun, ((0, -1, 0), 5.0))
    pane = (add_body, (box((-3, 2.0, -3), (3, 2.2, 3)), Medium(ior, 0, 0)))
    ball = (add_body, (BALL, RESIN))
    bare = mean(sun, ball, VIEW)
    assert mean(sun, pane, ball, VIEW) == pytest.approx(bare * expected, rel=0.01)
    # Switched off, the pane's shadow is black.
    assert mean(sun, pane, ball, VIEW, effects=SINGLE) == 0.0


def test_light_leaves_a_bulb() -> None:
    """A bulb of index 1 around the lamp changes nothing."""
    ball = (add_body, (BALL, RESIN))
    bulb = (add_body, (moved(BALL, 0.5, (-4, 3, 2)), Medium(1.0, 0, 0)))
    bare = mean(LAMP, ball, VIEW)
    assert mean(LAMP, ball, bulb, VIEW, light_samples=2**22) == pytest.approx(bare, rel=0.02)


def test_a_bead_beside_a_statue_gets_light() -> None:
    bead = (add_body, (moved(BALL, 0.01, (0, 0, 0)), Medium(1.5, 30.0, 10.0, 0.5)))
    statue = (add_body, (moved(BALL, 5.0, (30, 0, 0)), RESIN))
    near = (set_perspective, ((0, 0, 0.06), (0, 0, -1), (0, 1, 0), 0.4))
    lamp = (add_point, ((-0.4, 3, 2), 100.0))
    alone = mean(lamp, bead, near)
    assert mean(lamp, statue, bead, near) == pytest.approx(alone, rel=0.02)


def test_an_orthographic_camera_may_stand_inside() -> None:
    """Rays begin at the near plane, here behind the camera and outside the ball."""

    def inside(scene: Any) -> None:  # noqa: ANN401
        set_orthographic(scene, (0, 0, 0), (0, 0, -1), (0, 1, 0), 1.0)

    def behind(scene: Any) -> None:  # noqa: ANN401
        scene.set_camera(
            ffi.AMB_CAMERA_ORTHOGRAPHIC,
            np.eye(4).tolist(),
            window=(-0.5, 0.5, -0.5, 0.5),
            clip_start=-10.0,
            clip_end=10.0,
        )

    outside = (set_orthographic, ((0, 0, 5), (0, 0, -1), (0, 1, 0), 1.0))
    ball = (add_body, (BALL, RESIN))
    expected = mean(LAMP, ball, outside)
    assert mean(LAMP, ball, (behind, ())) == pytest.approx(expected, rel=1e-4)
    # From the middle of the ball half of it is seen, without the boundary's losses.
    assert 0.0 < mean(LAMP, ball, (inside, ()))


@pytest.mark.parametrize("ior", [1.0, 1.5])
def test_a_camera_in_the_medium_sees_it(ior: float) -> None:
    """Just inside the ball no boundary lies between: radiance is n^2 times that outside, and
    has not lost the reflection at normal incidence."""
    ball = (add_body, (BALL, Medium(ior, 0.3, 0.1, 0.5)))
    from_inside = (set_orthographic, ((0, 0, 0.998), (0, 0, -1), (0, 1, 0), 0.05))
    from_outside = (set_orthographic, ((0, 0, 5), (0, 0, -1), (0, 1, 0), 0.05))
    reflected = ((ior - 1) / (ior + 1)) ** 2
    assert mean(LAMP, ball, from_inside) == pytest.approx(
        mean(LAMP, ball, from_outside) * ior**2 / (1 - reflected), rel=0.01
    )


def test_an_unused_slot_does_not_fill_an_object() -> None:
    """Slot 0 is clear glass that no face uses."""

    def two_slots(scene: Any) -> None:  # noqa: ANN401
        glass = scene.add_material("glass", surface=ffi.AMB_SURFACE_DIELECTRIC, ior=1.2)
        resin = scene.add_material(
            "resin",
            surface=ffi.AMB_SURFACE_DIELECTRIC,
            ior=RESIN.ior,
            sigma_a=rgb(RESIN.sigma_a),
            lobes=[(rgb(RESIN.sigma_s), RESIN.g)],
        )
        slots = np.ones(len(BALL.triangles), np.uint32)
        shape = scene.add_mesh(
            "ball", BALL.positions, BALL.triangles, BALL.normals, ffi.AMB_NORMALS_VERTEX, slots
        )
        scene.add_object("ball", shape, np.eye(4).tolist(), [glass, resin])

    assert mean(LAMP, (two_slots, ()), VIEW) == mean(LAMP, (add_body, (BALL, RESIN)), VIEW)


def test_a_mesh_turned_inside_out_is_named() -> None:
    turned = Mesh(BALL.positions, BALL.triangles[:, ::-1].copy(), BALL.normals)
    image = render_image(scene_of(LAMP, (add_body, (turned, RESIN)), VIEW), 8, light_samples=4096)
    assert [w["text"] for w in image.report["warnings"]] == [
        "body: its faces point inward; they were taken the other way round"
    ]


@pytest.mark.parametrize(("level", "is_named"), [(2, True), (6, False)])
def test_a_hole_is_named_where_it_shows(level: int, is_named: bool) -> None:
    """A ball without its hindmost face, of 320 or of 81 920, which a few rays in a million find: as
    many as slip through closed meshes by rounding."""
    ball = icosphere(level)
    hindmost = np.argmin(ball.positions[ball.triangles][..., 2].mean(axis=1))
    ball = Mesh(ball.positions, np.delete(ball.triangles, hindmost, axis=0), ball.normals)
    scene = scene_of((add_body, (ball, Medium(1.0, 0, 0.1))), VIEW)
    image = render_image(scene, 64, samples=64, effects=ffi.AMB_EFFECT_BACKGROUND)
    assert any("hole" in found["text"] for found in image.report["warnings"]) == is_named


@pytest.mark.parametrize(("has_pane", "estimator"), [(False, "TUBES"), (True, "POINTS_COVARIANCE")])
def test_auto_follows_through_only_where_it_matters(has_pane: bool, estimator: str) -> None:
    """A ball alone gets no light through another object; behind a pane it gets no other."""
    sun = (add_sun, ((0, -1, 0), 5.0))
    pane = (add_body, (box((-3, 2.0, -3), (3, 2.2, 3)), Medium(1.5, 0, 0)))
    parts = [sun, (add_body, (BALL, RESIN)), VIEW] + ([pane] if has_pane else [])
    report = render_image(scene_of(*parts), 8, effects=THROUGH, light_samples=2**14).report
    assert report["estimator"] == estimator
    effect = next(e for e in report["effects"] if e["name"] == "light through other objects")
    assert effect["simulated"] == has_pane


def test_auto_leaves_a_mesh_that_crosses_itself_to_points() -> None:
    """Two balls in one mesh that overlap: their inner faces do not end the light."""
    other = moved(BALL, 1.0, (0.7, 0.0, 0.0))
    twin = Mesh(
        np.concatenate([BALL.positions, other.positions]),
        np.concatenate([BALL.triangles, other.triangles + np.uint32(len(BALL.positions))]),
        np.concatenate([BALL.normals, other.normals]),
    )
    report = render_image(
        scene_of(LAMP, (add_body, (twin, RESIN)), VIEW), 8, effects=THROUGH, light_samples=2**14
    ).report
    assert report["estimator"] == "POINTS_COVARIANCE"
    assert report["estimator_reason"] == "a mesh is open or crosses itself"
