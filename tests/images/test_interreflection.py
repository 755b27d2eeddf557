# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that opaque surfaces send one another: closed rooms, whose radiance is a geometric series
of the walls' albedo, media in them, and what the planner makes of rooms that are open."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from api import (
    LIBRARY,
    Medium,
    _ffi,
    add_body,
    add_point,
    add_spot,
    render,
    rgb,
    set_orthographic,
    set_perspective,
)
from meshes import Mesh, box, icosphere

pytestmark = pytest.mark.skipif(not LIBRARY.is_file(), reason=f"{LIBRARY} is not built")

ALBEDO = np.array((0.8, 0.5, 0.2))
SURFACES = (
    _ffi.AMB_EFFECT_SURFACE_REFLECTION | _ffi.AMB_EFFECT_BACKGROUND | _ffi.AMB_EFFECT_CAUSTICS
)
ALL = SURFACES | _ffi.AMB_EFFECT_INTERREFLECTION
SCATTERING = (
    _ffi.AMB_EFFECT_SINGLE_SCATTERING
    | _ffi.AMB_EFFECT_DOUBLE_SCATTERING
    | _ffi.AMB_EFFECT_MULTIPLE_SCATTERING
    | _ffi.AMB_EFFECT_WORLD_LIGHT
)
ESTIMATORS = {"walks": _ffi.AMB_SCATTER_WALK, "photons": _ffi.AMB_SCATTER_PHOTONS}
NAME = "light between opaque surfaces"
IN_MEDIA = "light that surfaces have from others, in media"

Scene = Any  # the binding's handle


def add_walls(scene: Scene, mesh: Mesh, albedo: object, emission: object = 0.0) -> None:
    material = scene.add_material(
        "wall", surface=_ffi.AMB_SURFACE_DIFFUSE, albedo=rgb(albedo), emission=rgb(emission)
    )
    shape = scene.add_mesh("wall", mesh.positions, mesh.triangles)
    scene.add_object("wall", shape, np.eye(4).tolist(), [material])


def seen(build: Callable[[Scene], None], **params: object) -> np.ndarray:
    """Radiance by pixel, RGB."""
    settings = {"effects": ALL, "samples": 256, "light_samples": 2**14} | params
    return render(build, 8, "Combined", **settings).pixels[..., :3].astype(np.float64)


@pytest.mark.parametrize("has_glass", [False, True])
def test_glowing_walls_light_one_another(has_glass: bool) -> None:
    """Radiance is the same everywhere in a closed room that glows evenly, also through clear glass
    that the light passes on its way from wall to wall."""

    def build(scene: Scene) -> None:
        add_walls(scene, box((-2, -2, -2), (2, 2, 2)), ALBEDO, 0.3)
        if has_glass:
            add_body(scene, icosphere(3), Medium(1.5, 0, 0))
        set_perspective(scene, (0.3, 0.2, 1.9), (0, 0, -1), (0, 1, 0), 1.2)

    # What the glass bends comes by the map of caustics, from walls that are lamps for the glass.
    image = seen(build, camera_bounces=64, light_bounces=8, light_samples=2**18)
    expected = 0.3 / (1 - ALBEDO)
    # Where the walls reflect most a sample's standard deviation is 1.2 of the mean.
    assert image.mean(axis=(0, 1)) == pytest.approx(expected, rel=0.02)
    assert image.reshape(-1, 3) == pytest.approx(np.tile(expected, (64, 1)), rel=0.4)


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize(("ior", "sigma_s", "error"), [(1.0, 1.0, 0.03), (1.4, 2.0, 0.06)])
def test_a_white_medium_vanishes_in_a_glowing_room(
    estimator: str, ior: float, sigma_s: float, error: float
) -> None:
    """A furnace: what scatters all light that it meets changes nothing where radiance is the same
    everywhere, though most of that has been at several walls, and through the medium between."""

    def build(scene: Scene) -> None:
        add_walls(scene, box((-2, -2, -2), (2, 2, 2)), ALBEDO, 0.3)
        add_body(scene, icosphere(3), Medium(ior, sigma_s, 0))
        set_perspective(scene, (0.3, 0.2, 1.9), (-0.1, -0.1, -1), (0, 1, 0), 1.2)

    image = seen(
        build,
        effects=ALL | SCATTERING,
        camera_bounces=32,
        light_bounces=8,
        light_samples=2**18,
        samples=1024 if estimator == "walks" else 64,
        scatter_estimator=ESTIMATORS[estimator],
    )
    relative = image * (1 - ALBEDO) / 0.3
    ball = relative[2:6, 2:6].mean(axis=(0, 1))
    # With what surfaces emit alone the ball would have 0.3 of the red light.
    assert ball == pytest.approx(np.ones(3), abs=error)
    assert relative.mean(axis=(0, 1)) == pytest.approx(np.ones(3), abs=error)


def furnished(scene: Scene) -> None:
    """A lamp, a body that absorbs some of its light, walls of three albedos."""
    add_walls(scene, box((-2, -2, -2), (2, 2, 2)), ALBEDO)
    add_body(scene, icosphere(2), Medium(1.3, 1.0, 0.1))
    add_point(scene, (1.2, 1.5, 1.4), 3.0)
    set_perspective(scene, (0.3, 0.2, 1.9), (-0.1, -0.1, -1), (0, 1, 0), 1.2)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_the_number_of_threads_changes_no_bit(estimator: str) -> None:
    settings = {
        "effects": ALL | SCATTERING,
        "samples": 8,
        "light_samples": 2**13,
        "scatter_estimator": ESTIMATORS[estimator],
    }
    images = [seen(furnished, threads=threads, **settings) for threads in (1, 2, 5)]
    assert (images[0] == images[1]).all()
    assert (images[0] == images[2]).all()


def test_photons_and_walks_see_the_same_room() -> None:
    """What light does is found from the lamp's side and from the camera's, by code that has nothing
    in common."""
    settings = {
        "effects": ALL | SCATTERING | _ffi.AMB_EFFECT_TRANSMITTED_LIGHT,
        "camera_bounces": 16,
        "light_bounces": 8,
        "light_samples": 2**17,
        "samples": 512,
    }
    images = {
        name: seen(furnished, scatter_estimator=estimator, **settings)
        for name, estimator in ESTIMATORS.items()
    }
    walks, photons = (images[name][2:6, 2:6].mean(axis=(0, 1)) for name in ("walks", "photons"))
    # The standard deviation between runs is 1.4 % with these samples.
    assert photons == pytest.approx(walks, rel=0.04)


def test_a_lamp_in_a_white_ball() -> None:
    """An integrating sphere: the walls of radius R have the irradiance I / R^2 from a lamp in the
    middle, and everywhere the same of each other's light."""

    def build(scene: Scene) -> None:
        ball = icosphere(5)
        add_walls(scene, Mesh(3.0 * ball.positions, ball.triangles), ALBEDO)
        add_point(scene, (0, 0, 0), 9.0 * np.pi)
        set_perspective(scene, (0, 0, 1), (0, 0, -1), (0, 1, 0), 1.2)

    direct = seen(build, effects=SURFACES, samples=4).mean(axis=(0, 1))
    assert direct == pytest.approx(ALBEDO, rel=0.01)
    assert seen(build).mean(axis=(0, 1)) == pytest.approx(ALBEDO / (1 - ALBEDO), rel=0.02)


def add_rectangle(scene: Scene, name: str, corners: list[tuple[float, float, float]]) -> None:
    material = scene.add_material(name, surface=_ffi.AMB_SURFACE_DIFFUSE, albedo=rgb(0.5))
    triangles = np.array([(0, 1, 2), (0, 2, 3)], np.uint32)
    shape = scene.add_mesh(name, np.array(corners), triangles, None, _ffi.AMB_NORMALS_NONE, None)
    scene.add_object(name, shape, np.eye(4).tolist(), [material])


def test_a_wall_sees_a_caustic_without_white_dots() -> None:
    """A ball throws a small bright ring onto the floor; a ray from the wall meets it one time in
    two hundred. What the wall has of it is the integral over the floor as it is seen from above,
    and a few samples know it well."""

    def build(scene: Scene) -> None:
        add_spot(scene, (0, 0, 6), (0, 0, -1), 10.0, 0.04)
        ball = icosphere(4)
        ball = Mesh(ball.positions * 0.25 + np.array((0, 0, 0.6)), ball.triangles, ball.normals)
        add_body(scene, ball, Medium(1.5, 0, 0))
        add_rectangle(scene, "floor", [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
        add_rectangle(scene, "wall", [(-1, 1, 0), (1, 1, 0), (1, 1, 2), (-1, 1, 2)])

    def from_above(scene: Scene) -> None:
        build(scene)
        set_orthographic(scene, (0, 0, 0.01), (0, 0, -1), (0, 1, 0), 2.0)

    def at_the_wall(scene: Scene) -> None:
        build(scene)
        set_orthographic(scene, (0, 0.6, 1), (0, 1, 0), (0, 0, 1), 0.1)

    caustics = {"effects": _ffi.AMB_EFFECT_CAUSTICS, "light_samples": 2**16}
    floor = render(from_above, 512, "Surface", samples=16, **caustics).pixels.mean(axis=2)
    x = (np.arange(512) + 0.5) / 256 - 1
    square = x**2 + (1 + x[:, None]) ** 2 + 1  # rows from far to near: y = -x[:, None]
    other = ((1 + x[:, None]) * floor.astype(np.float64) / square**2).sum() / 256**2
    own = render(at_the_wall, 8, "Surface", samples=16, **caustics).pixels.astype(np.float64)
    both = {"effects": caustics["effects"] | _ffi.AMB_EFFECT_INTERREFLECTION}
    image = render(at_the_wall, 8, "Surface", samples=256, **caustics | both)
    seen_of_floor = image.pixels.astype(np.float64).mean(axis=2) - own.mean(axis=2)
    # Light that comes by way of the ball, or was at the wall before, is what is more.
    assert 0.99 < seen_of_floor.mean() / (0.5 / np.pi * other) < 1.1
    # By rays alone one sample has a standard deviation of nine times the mean.
    deviation = np.sqrt(256) * seen_of_floor.std() / seen_of_floor.mean()
    assert deviation < 2


def test_what_stands_beside_a_caustic_hides_it() -> None:
    """A curb of 5 cm around a caustic hides it from the foot of a wall a kilometre away: shadows
    are asked for on the whole way there, however long it is."""

    def build(scene: Scene) -> None:
        add_spot(scene, (0, 0, 6), (0, 0, -1), 10.0, 0.01)
        ball = icosphere(4)
        ball = Mesh(ball.positions * 0.25 + np.array((0, 0, 0.6)), ball.triangles, ball.normals)
        add_body(scene, ball, Medium(1.5, 0, 0))
        add_rectangle(scene, "floor", [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
        add_rectangle(scene, "wall", [(-1, 1e3, 0), (1, 1e3, 0), (1, 1e3, 2), (-1, 1e3, 2)])

    def with_curb(scene: Scene) -> None:
        build(scene)
        corners = [(-0.05, -0.05), (0.05, -0.05), (0.05, 0.05), (-0.05, 0.05)]
        for (x, y), (u, v) in zip(corners, corners[1:] + corners[:1], strict=True):
            add_rectangle(scene, "curb", [(x, y, 0), (u, v, 0), (u, v, 0.1), (x, y, 0.1)])

    def seen_at_the_wall(build: Callable[[Scene], None]) -> np.ndarray:
        def at_the_wall(scene: Scene) -> None:
            build(scene)
            set_orthographic(scene, (0, 999, 0.05), (0, 1, 0), (0, 0, 1), 0.06)

        effects = _ffi.AMB_EFFECT_CAUSTICS | _ffi.AMB_EFFECT_INTERREFLECTION
        settings = {"effects": effects, "light_samples": 2**14, "samples": 16}
        return render(at_the_wall, 8, "Surface", **settings).pixels

    assert seen_at_the_wall(build).mean() > 0
    assert seen_at_the_wall(with_curb).max() == 0


def corner(angle: float) -> Mesh:
    """Two squares with an edge in common; 180 degrees is a plane."""
    x, z = -np.cos(np.radians(angle)), np.sin(np.radians(angle))
    points = [(1, -1, 0), (1, 1, 0), (0, 1, 0), (0, -1, 0), (x, 1, z), (x, -1, z)]
    faces = [(0, 1, 2), (0, 2, 3), (3, 2, 4), (3, 4, 5)]
    return Mesh(np.array(points, dtype=np.float64), np.array(faces, dtype=np.uint32))


def plan_of(report: dict[str, Any], name: str = NAME) -> dict[str, Any]:
    return next(effect for effect in report["effects"] if effect["name"] == name)


@pytest.mark.parametrize(("angle", "simulated"), [(180.0, False), (90.0, True)])
def test_auto_follows_it_only_where_it_shows(angle: float, simulated: bool) -> None:
    def build(scene: Scene) -> None:
        add_walls(scene, corner(angle), 0.8)
        add_point(scene, (0.5, 0, 1), 1.0)
        set_perspective(scene, (2, 0, 2), (-1, 0, -1), (0, 1, 0), 0.7)

    settings = {"effects": ALL, "samples": 64, "effects_are_auto": 1}
    image = render(build, 8, "Combined", **settings)
    plan = plan_of(image.report)
    assert plan["simulated"] is simulated
    if simulated:
        # What was predicted is what the picture has.
        assert plan["share"]["low"] <= plan["measured"] * 1.05
        assert plan["measured"] * 0.95 <= plan["share"]["high"]
    bare = render(build, 8, "Combined", **{**settings, "effects": SURFACES})
    difference = image.pixels[..., 0].mean() - bare.pixels[..., 0].mean()
    assert difference > 0 if simulated else difference == 0
