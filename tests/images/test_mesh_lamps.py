# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes that emit light: closed forms, and area lamps of the same size and radiance."""

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
    handles,
    library,
    render,
    rgb,
    set_perspective,
)
from meshes import Mesh, box, icosphere

pytestmark = pytest.mark.skipif(not LIBRARY.is_file(), reason=f"{LIBRARY} is not built")

Scene = Any  # the binding's handle
SCATTERING = (
    _ffi.AMB_EFFECT_SINGLE_SCATTERING
    | _ffi.AMB_EFFECT_DOUBLE_SCATTERING
    | _ffi.AMB_EFFECT_MULTIPLE_SCATTERING
)
SURFACES = (
    _ffi.AMB_EFFECT_SURFACE_REFLECTION | _ffi.AMB_EFFECT_BACKGROUND | _ffi.AMB_EFFECT_CAUSTICS
)
RADIANCE = np.array((8.0, 4.0, 2.0))


def square(half: float, height: float, parts: int = 1) -> Mesh:
    """Level, of so many by so many squares."""
    ticks = np.linspace(-half, half, parts + 1)
    x, y = np.meshgrid(ticks, ticks, indexing="ij")
    points = np.stack([x, y, np.full_like(x, height)], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(parts), np.arange(parts), indexing="ij")
    a = (i * (parts + 1) + j).ravel()
    b, c, d = a + parts + 1, a + parts + 2, a + 1
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return Mesh(points, faces.astype(np.uint32))


def disc(radius: float, height: float, count: int = 256) -> Mesh:
    """A fan with the area of the disc."""
    angles = 2 * np.pi * np.arange(count) / count
    radius *= np.sqrt(2 * np.pi / count / np.sin(2 * np.pi / count))
    rim = np.stack([radius * np.cos(angles), radius * np.sin(angles), 0 * angles + height], axis=1)
    faces = [(0, 1 + k, 1 + (k + 1) % count) for k in range(count)]
    return Mesh(np.vstack([[(0, 0, height)], rim]), np.array(faces, dtype=np.uint32))


def add_opaque(scene: Scene, mesh: Mesh, name: str, albedo: Any = 0.0, emission: Any = 0.0) -> None:
    material = scene.add_material(
        name, surface=_ffi.AMB_SURFACE_DIFFUSE, albedo=rgb(albedo), emission=rgb(emission)
    )
    shape = scene.add_mesh(name, mesh.positions, mesh.triangles)
    scene.add_object(name, shape, np.eye(4).tolist(), [material])


def add_floor(scene: Scene, height: float = 0.0) -> None:
    add_opaque(scene, square(8.0, height), "floor", albedo=0.5)


def look_down(scene: Scene, height: float = 0.5, fov: float = 0.02) -> None:
    set_perspective(scene, (0, 0, height), (0, 0, -1), (0, 1, 0), fov)


def rectangle_factor(half: float, height: float) -> float:
    """Form factor of a square from the point below its middle: four times that of a quarter below
    its corner."""
    a = half / height
    return float(4 * a / (np.pi * np.sqrt(1 + a * a)) * np.arctan(a / np.sqrt(1 + a * a)))


@pytest.mark.parametrize("parts", [1, 40])
@pytest.mark.parametrize("is_turned", [False, True])
def test_irradiance_below_a_square(parts: int, is_turned: bool) -> None:
    """From either side."""
    mesh = square(0.5, 1.0, parts)
    if is_turned:
        mesh = Mesh(mesh.positions, mesh.triangles[:, ::-1].copy())

    def build(scene: Scene) -> None:
        add_floor(scene)
        add_opaque(scene, mesh, "plane", emission=RADIANCE)
        look_down(scene)

    image = render(build, 8, "Surface", effects=0, samples=64)
    assert image.report["light"]["mesh_lamps"] == ["plane"]
    expected = 0.5 * RADIANCE * rectangle_factor(0.5, 1.0)
    assert image.pixels.mean(axis=(0, 1)) == pytest.approx(expected, rel=2e-3)


def test_irradiance_below_a_disc() -> None:
    def build(scene: Scene) -> None:
        add_floor(scene)
        add_opaque(scene, disc(1.0, 1.0), "disc", emission=RADIANCE)
        look_down(scene)

    image = render(build, 8, "Surface", effects=0, samples=1024)
    # A sample's standard deviation is 0.5 of the mean.
    assert image.pixels.mean(axis=(0, 1)) == pytest.approx(0.25 * RADIANCE, rel=6e-3)


def pair(others: Callable[[Scene], None], height: float) -> tuple[Any, Any]:
    """The same scene under an emissive square, and under an area lamp."""

    def under_mesh(scene: Scene) -> None:
        others(scene)
        add_opaque(scene, square(0.5, height), "plane", emission=RADIANCE)

    def under_lamp(scene: Scene) -> None:
        others(scene)
        scene.add_light(
            _ffi.AMB_LIGHT_AREA,
            "lamp",
            color=rgb(RADIANCE),
            position=(0, 0, height),
            direction=(0, 0, -1),
            tangent=(1, 0, 0),
            size=(1, 1),
        )

    return under_mesh, under_lamp


RESIN = Medium(1.5, (0.6, 0.9, 1.2), (0.1, 0.05, 0.02), 0.4)
ORDERS = ("Single Scattering", "Double Scattering", "Multiple Scattering")


def ball_of_resin(scene: Scene) -> None:
    add_body(scene, icosphere(4), RESIN)
    set_perspective(scene, (4, 0, 1), (-4, 0, -1), (0, 0, 1), 0.5)


def read_passes(build: Callable[[Scene], None], names: tuple[str, ...], **params: Any) -> Any:
    """Means of passes over the picture, (names, 3)."""
    settings = {"width": 16, "height": 16, "film_transparent": 1, "adjoint_normals": 0} | params
    with handles.Scene(library.load()) as scene:
        build(scene)
        scene.commit()
        with scene.start(**settings) as job:
            job.wait()
            return np.stack([job.read_pass(name).mean(axis=(0, 1)) for name in names])


@pytest.mark.parametrize(("scatterer", "noise"), [("WALK", 0.02), ("PHOTONS", 0.01)])
def test_a_mesh_scatters_as_an_area_lamp(scatterer: str, noise: float) -> None:
    settings = {
        "effects": SCATTERING,
        "samples": 128 if scatterer == "WALK" else 16,
        "light_samples": 2**15 if scatterer == "WALK" else 2**18,
        "light_bounces": 2,
        "camera_bounces": 2,
        "estimator": _ffi.AMB_ESTIMATOR_POINTS_COVARIANCE,
        "scatter_estimator": getattr(_ffi, f"AMB_SCATTER_{scatterer}"),
    }
    mesh, lamp = (read_passes(build, ORDERS, **settings) for build in pair(ball_of_resin, 3.0))
    assert mesh[0] == pytest.approx(lamp[0], rel=0.005)
    assert mesh[1:] == pytest.approx(lamp[1:], rel=noise)


def test_caustics_are_those_of_an_area_lamp() -> None:
    def others(scene: Scene) -> None:
        add_floor(scene, -1.2)
        add_body(scene, icosphere(4), Medium(1.5, 0, 0.1))
        set_perspective(scene, (5, 0, 3), (-5, 0, -4), (0, 0, 1), 0.8)

    settings = {
        "effects": _ffi.AMB_EFFECT_CAUSTICS,
        "samples": 32,
        "light_samples": 2**18,
        "light_bounces": 2,
    }
    mesh, lamp = (
        render(build, 24, "Surface", **settings).pixels.astype(np.float64)
        for build in pair(others, 3.0)
    )
    assert mesh.mean(axis=(0, 1)) == pytest.approx(lamp.mean(axis=(0, 1)), rel=0.01)
    error = np.sqrt(np.mean((mesh - lamp) ** 2)) / lamp.mean()
    assert error < 0.15


def test_a_room_that_glows_lights_a_medium_evenly() -> None:
    """In a closed box that glows a white medium shows the box's own radiance everywhere: what it
    scatters makes up for what it takes away."""

    def build(scene: Scene) -> None:
        add_opaque(scene, box((-2, -2, -2), (2, 2, 2)), "room", emission=0.5)
        add_body(scene, icosphere(3), Medium(1.0, 0.8, 0))
        set_perspective(scene, (0, 0, 1.9), (0, 0, -1), (0, 1, 0), 0.5)

    names = (*ORDERS, "Surface")
    settings = {
        "effects": SCATTERING | SURFACES,
        "samples": 256,
        "light_samples": 2**16,
        "estimator": _ffi.AMB_ESTIMATOR_POINTS_COVARIANCE,
        "scatter_estimator": _ffi.AMB_SCATTER_WALK,
    }
    orders = read_passes(build, names, **settings)
    assert orders.sum(axis=0) == pytest.approx(np.full(3, 0.5), rel=0.01)


def add_area(scene: Scene, height: float, half: float, down: float) -> None:
    scene.add_light(
        _ffi.AMB_LIGHT_AREA,
        "lamp",
        color=rgb(RADIANCE),
        position=(0, 0, height),
        direction=(0, 0, -down),
        tangent=(1, 0, 0),
        size=(2 * half, 2 * half),
    )


def scattered(build: Callable[[Scene], None], **params: Any) -> tuple[Any, dict[str, Any]]:
    settings = {
        "light_samples": 2**18,
        "samples": 16,
        "estimator": _ffi.AMB_ESTIMATOR_POINTS_COVARIANCE,
    } | params
    image = render(build, 16, **settings)
    return image.pixels.astype(np.float64).mean(axis=(0, 1)), image.report


def test_a_mesh_inside_of_a_medium() -> None:
    """As two area lamps back to back, there."""

    def mesh(scene: Scene) -> None:
        ball_of_resin(scene)
        add_opaque(scene, square(0.1, 0.3), "plane", emission=RADIANCE)

    def lamps(scene: Scene) -> None:
        ball_of_resin(scene)
        for down in (1, -1):
            add_area(scene, 0.3, 0.1, down)

    (one, report), (other, reference) = scattered(mesh), scattered(lamps)
    flux, expected = (np.array(r["light"]["flux_interacting"]) for r in (report, reference))
    assert flux == pytest.approx(expected, rel=0.005)
    # The mesh hides a little of what scatters behind it.
    assert np.all(one < other) and one == pytest.approx(other, rel=0.04)


def test_a_mesh_in_two_media() -> None:
    """A strip that begins in the ball and ends outside, in one piece and in two."""

    def strip(begin: float, end: float) -> Mesh:
        points = [(begin, -0.1, 0), (end, -0.1, 0), (end, 0.1, 0), (begin, 0.1, 0)]
        return Mesh(np.array(points), np.array([(0, 1, 2), (0, 2, 3)], dtype=np.uint32))

    def build(parts: list[Mesh]) -> Callable[[Scene], None]:
        def add(scene: Scene) -> None:
            ball_of_resin(scene)
            for part in parts:
                add_opaque(scene, part, "strip", emission=RADIANCE)

        return add

    _, whole = scattered(build([strip(0.5, 1.6)]))
    _, split = scattered(build([strip(0.5, 0.98), strip(1.02, 1.6)]))
    flux, expected = (np.array(r["light"]["flux_interacting"]) for r in (whole, split))
    # The gap has a part in 28 of the strip.
    assert np.all(flux > expected) and flux == pytest.approx(expected, rel=0.05)


def test_points_carry_its_light_beside_tubes() -> None:
    """Both kinds of light together are as bright as each alone."""

    def build(has_lamp: bool, has_mesh: bool) -> Callable[[Scene], None]:
        def add(scene: Scene) -> None:
            ball_of_resin(scene)
            if has_lamp:
                place = (0, 3, 0)
                scene.add_light(_ffi.AMB_LIGHT_POINT, "lamp", color=rgb(1), position=place)
            if has_mesh:
                add_opaque(scene, square(0.1, 3.0), "plane", emission=RADIANCE)

        return add

    tubes = {"estimator": _ffi.AMB_ESTIMATOR_TUBES}
    both, report = scattered(build(True, True), **tubes)
    assert report["light"]["tubes"] > 0 and report["light"]["volume_samples"] > 0
    lamp, _ = scattered(build(True, False), **tubes)
    mesh, _ = scattered(build(False, True))
    assert both == pytest.approx(lamp + mesh, rel=0.01)


@pytest.mark.parametrize(("radiance", "estimator"), [(0.3, "TUBES"), (300, "POINTS_COVARIANCE")])
def test_auto_goes_by_its_share_of_the_light(radiance: float, estimator: str) -> None:
    def build(scene: Scene) -> None:
        ball_of_resin(scene)
        scene.add_light(_ffi.AMB_LIGHT_POINT, "lamp", color=rgb(1), position=(0, 3, 0))
        add_opaque(scene, square(0.1, 3.0), "plane", emission=radiance)

    _, report = scattered(build, estimator=_ffi.AMB_ESTIMATOR_AUTO)
    assert report["light"]["mesh_lamps"] == ["plane"]
    assert report["estimator"] == estimator


def lamps_of(build: Callable[[Scene], None]) -> list[str]:
    names = render(build, 4, "Surface", effects=0).report["light"]["mesh_lamps"]
    return [str(name) for name in names]


def test_dim_meshes_are_left_to_chance() -> None:
    """However many triangles they have; so are those of no influence, and faces without area."""

    def build(scene: Scene) -> None:
        add_opaque(scene, square(8.0, 0.0, 200), "floor", albedo=0.5, emission=0.01)
        scene.add_light(_ffi.AMB_LIGHT_POINT, "lamp", color=rgb(10), position=(0, 0, 2))
        add_opaque(scene, icosphere(2), "ball", albedo=0.5)
        points = np.array([(0, 0, 3), (1, 0, 3), (2, 0, 3)], dtype=np.float64)
        faces = np.array([(0, 1, 2), (1, 1, 1)], dtype=np.uint32)
        add_opaque(scene, Mesh(points, faces), "line", emission=1e6)
        add_opaque(scene, square(1e-6, 4.0), "spark", emission=10)
        look_down(scene, 5)

    assert lamps_of(build) == []


def test_many_meshes_are_lamps() -> None:
    """More than have lights of their own: the light on the floor is that of all of them."""

    def build(mesh: Mesh) -> Callable[[Scene], None]:
        def add(scene: Scene) -> None:
            add_floor(scene)
            places = np.arange(-12, 13) / 12
            for k, x in enumerate(places):
                part = Mesh(mesh.positions + (x, 0, 0), mesh.triangles)
                add_opaque(scene, part, f"bulb {k}", emission=20)
            look_down(scene)

        return add

    image = render(build(square(0.02, 1.0)), 8, "Surface", effects=0, samples=256)
    assert len(image.report["light"]["mesh_lamps"]) == 25
    x = np.arange(-12, 13) / 12
    expected = 0.5 / np.pi * 20 * 0.04**2 * np.sum(1 / (1 + x * x) ** 2)
    assert image.pixels.mean() == pytest.approx(expected, rel=3e-3)


@pytest.mark.parametrize("radiance", [1e-38, 1e-20, 1e20, 1e30])
def test_radiance_of_any_size(radiance: float) -> None:
    """Up to what is taken, sums of many samples are numbers."""

    def build(scene: Scene) -> None:
        add_floor(scene)
        add_body(scene, icosphere(1), RESIN)
        add_opaque(scene, square(0.5, 3.0), "plane", emission=radiance)
        add_opaque(scene, square(0.5, 4.0), "other", emission=1)
        look_down(scene, 2, 0.5)

    settings = {"effects": SCATTERING | SURFACES, "light_samples": 2**10}
    render(build, 4, "Surface", samples=256, **settings)
