# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects that overlap, lie in one another and touch, and worlds that are images.

Slabs of several media against what Fresnel and Beer say; an overlap against the same geometry
without one; one bright spot of an image against the sun that it is.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from api import (
    POINTS_COVARIANCE,
    SINGLE,
    TUBES,
    Medium,
    add_sun,
    errors,
    handles,
    look,
    render,
    rgb,
    set_orthographic,
    set_perspective,
)
from api import _ffi as ffi
from meshes import Mesh, box, icosphere
from order_scenes import SCATTERED, SEEN, WORLD
from test_light_paths import moved, scene_of

THROUGH = SINGLE | ffi.AMB_EFFECT_TRANSMITTED_LIGHT
BACKGROUND = ffi.AMB_EFFECT_BACKGROUND
BALL = icosphere(4)
DOWN = (set_orthographic, ((0.1, 0.07, 9), (0, 0, -1), (0, 1, 0), 0.2))
WIDE = 20.0  # of slabs: nothing comes from their sides


def add_dielectric(scene: handles.Scene, mesh: Mesh, medium: Medium, priority: int = 0) -> None:
    material = scene.add_material(
        "dielectric",
        surface=ffi.AMB_SURFACE_DIELECTRIC,
        ior=medium.ior,
        sigma_a=rgb(medium.sigma_a),
        lobes=[(rgb(medium.sigma_s), medium.g)],
        priority=priority,
    )
    domain = ffi.AMB_NORMALS_NONE if mesh.normals is None else ffi.AMB_NORMALS_VERTEX
    shape = scene.add_mesh("dielectric", mesh.positions, mesh.triangles, mesh.normals, domain)
    scene.add_object("dielectric", shape, np.eye(4).tolist(), [material])


def set_world(scene: handles.Scene, radiance: float) -> None:
    scene.set_world(rgb(radiance))


def slab(bottom: float, top: float, medium: Medium, priority: int = 0) -> tuple[Any, Any]:
    return add_dielectric, (box((-WIDE, -WIDE, bottom), (WIDE, WIDE, top)), medium, priority)


def seen(*parts: tuple[Any, Any], name: str = "Surface", size: int = 8, **params: Any) -> float:
    settings = {"film_transparent": 0, "estimator": POINTS_COVARIANCE} | params
    image = render(scene_of(*parts), size, name, **settings)
    return float(image.pixels.astype(np.float64).mean())


def through(*indices: float) -> float:
    """Transmission of boundaries between these indices at normal incidence, first passes."""
    pairs = zip(indices[:-1], indices[1:], strict=True)
    return float(np.prod([1 - ((a - b) / (a + b)) ** 2 for a, b in pairs]))


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (1, 2, 0)])
@pytest.mark.parametrize("priorities", [(2, 1, 0), (0, 1, 2), (1, 2, 0), (0, 2, 0)])
def test_slabs_of_three_media(order: tuple[int, ...], priorities: tuple[int, ...]) -> None:
    """Three slabs, each reaching far into the next: what is between is of the higher priority.
    The world is seen through them."""
    media = [Medium(1.3, 0, 0.5), Medium(1.6, 0, 0.2), Medium(1.1, 0, 0.9)]
    spans = [(0.0, 1.0), (0.6, 2.0), (1.5, 3.0)]
    objects = [slab(*spans[i], media[i], priorities[i]) for i in order]
    value = seen((set_world, (1.0,)), DOWN, *objects, effects=BACKGROUND)
    # The ends that are there: of two that overlap that of the higher one; equal ones take turns,
    # and a path downwards has entered the lower one last.
    first = 0.6 if priorities[1] >= priorities[0] and priorities[1] > priorities[0] else 1.0
    second = 1.5 if priorities[2] > priorities[1] else 2.0
    absorbed = 0.5 * first + 0.2 * (second - first) + 0.9 * (3.0 - second)
    expected = through(1, 1.1, 1.6, 1.3, 1) * np.exp(-absorbed)
    assert value == pytest.approx(expected, rel=2e-5)


@pytest.mark.parametrize("turned", [False, True])
def test_slabs_that_touch(turned: bool) -> None:
    """The same faces twice: neither the order of objects nor that of hits matters, from straight
    above and aslant. Rays aslant also agree with slabs that overlap."""
    lower, upper = (0.0, 1.0, Medium(1.5, 0, 0.3)), (1.0, 2.0, Medium(1.2, 0, 0.7))
    pair = [slab(*lower), slab(*upper)]
    touching = [(set_world, (1.0,)), *(pair[::-1] if turned else pair)]
    expected = through(1, 1.2, 1.5, 1) * np.exp(-1.0)
    assert seen(DOWN, *touching, effects=BACKGROUND) == pytest.approx(expected, rel=2e-5)
    aslant = (set_perspective, ((0.3, 0.2, 5), (0.3, 0.1, -1), (0, 1, 0), 1.0))
    overlap = [(set_world, (1.0,)), slab(0.0, 1.0, lower[2], 1), slab(0.3, 2.0, upper[2])]
    assert seen(aslant, *touching, effects=BACKGROUND, size=32) == pytest.approx(
        seen(aslant, *overlap, effects=BACKGROUND, size=32), rel=1e-5
    )


def test_tubes_refuse_what_touches() -> None:
    """They refract at the mesh's own triangles, as if only vacuum were beside them."""
    pair = slab(0, 1, Medium(1.5, 0.3, 0.1)), slab(1, 2, Medium(1.2, 0.3, 0.1))
    with pytest.raises(errors.AmbUnsupported, match="inside one another or touch"):
        seen(SUN, DOWN, *pair, name="Single Scattering", effects=SINGLE, estimator=TUBES)


SUN = (add_sun, ((0.2, -0.1, -1), 5.0))
ABOVE = (set_perspective, ((0.3, 0.2, 6), (0, 0, -1), (0, 1, 0), 0.3))


def test_two_of_one_medium_are_one_object() -> None:
    """Two halves of one medium that overlap or touch, and one object: the world behind is the same
    to rounding; what scatters to what kernels of points lose at the cut."""
    medium = Medium(1.4, 0.3, 0.1, 0.4)
    world = (set_world, (1.0,))
    settings = {"name": "Single Scattering", "light_samples": 2**18, "effects": THROUGH, "size": 16}
    behind = seen(world, ABOVE, slab(0, 2, medium), effects=BACKGROUND, size=16)
    whole = seen(SUN, ABOVE, slab(0, 2, medium), **settings)
    for bottom, top, priority in ((0.8, 1.2, 0), (0.8, 1.2, 1), (1.0, 1.0, 0)):
        parts = slab(0, top, medium, priority), slab(bottom, 2, medium)
        found = seen(world, ABOVE, *parts, effects=BACKGROUND, size=16)
        assert found == pytest.approx(behind, rel=1e-6)
        assert seen(SUN, ABOVE, *parts, **settings) == pytest.approx(whole, rel=4e-3)


def test_liquid_in_glass() -> None:
    """A liquid that reaches into the wall, whose priority is higher, is the liquid that ends at
    the wall: both lit and seen through the glass."""
    glass, liquid = Medium(1.5, 0, 0.05), Medium(1.33, 0.4, 0.1, 0.6)
    settings = {"name": "Single Scattering", "light_samples": 2**18, "effects": THROUGH, "size": 16}
    lid = slab(1.0, 1.3, glass, 1)
    floor = slab(-0.3, 0.0, glass, 1)
    exact = seen(SUN, ABOVE, floor, lid, slab(0.0, 1.0, liquid), **settings)
    overlap = seen(SUN, ABOVE, floor, lid, slab(-0.2, 1.2, liquid), **settings)
    assert overlap == pytest.approx(exact, rel=2e-3)
    # What it is not: the liquid's ends where its mesh has them.
    wrong = seen(SUN, ABOVE, slab(-0.3, 0, glass), slab(1, 1.3, glass), slab(-0.2, 1.2, liquid),
                 **settings)  # fmt: skip
    assert abs(wrong / exact - 1) > 0.01
    # Each beam is in the object whose medium holds, and nothing is irregular about it.
    image = render(
        scene_of(SUN, ABOVE, floor, lid, slab(-0.2, 1.2, liquid)), 8,
        effects=THROUGH, light_samples=2**12,
    )  # fmt: skip
    assert image.report["warnings"] == []
    assert image.report["estimator_reason"] == "translucent objects are inside one another or touch"


def test_a_bubble_in_resin_is_a_hole() -> None:
    """A ball of nothing takes its light and its boundary out of the resin, whichever is higher in
    the list: with index 1 all around, the resin less the chord."""
    resin = Medium(1.0, 0.3, 0.1)
    block = slab(-1, 1, resin)
    bubble = (add_dielectric, (moved(BALL, 0.5, (0.1, 0.07, 0)), Medium(1.0, 0, 0), 1))
    world = (set_world, (1.0,))
    for parts in ([block, bubble], [bubble, block]):
        value = seen(world, DOWN, *parts, effects=BACKGROUND, size=16)
        # The mean chord in the little window around the axis, 1 - 2 (0.2^2 / 6).
        assert value == pytest.approx(np.exp(-0.4 * (2 - 0.9867)), rel=1e-3)
    # A bubble of lower priority is not there.
    filled = (add_dielectric, (moved(BALL, 0.5, (0.1, 0.07, 0)), Medium(1.0, 0, 0), -1))
    value = seen(world, DOWN, block, filled, effects=BACKGROUND)
    assert value == pytest.approx(np.exp(-0.8), rel=1e-5)


@pytest.mark.parametrize("highest", [0, 1, 2])
def test_media_that_reach_into_one_another_vanish(highest: int) -> None:
    """Ice that floats in a liquid in a glass, all of them white, in an even world. Walks begin
    where a segment does, before they come to what lies in the medium of the higher priority."""
    parts = [
        (add_dielectric, (moved(BALL, 0.5, (0.0, 0.0, 0.2)), Medium(1.31, 1.0, 0, 0.3), 2)),
        (add_dielectric, (box((-0.7, -0.7, -0.9), (0.7, 0.7, 0.3)), Medium(1.36, 0.4, 0), 0)),
        (add_dielectric, (box((-0.8, -0.8, -1), (0.8, 0.8, -0.8)), Medium(1.5, 0.2, 0), 1)),
    ]
    down = (set_orthographic, ((0.3, 0.2, 9), (-0.02, 0.01, -1), (0, 1, 0), 1.2))
    for estimator in (ffi.AMB_SCATTER_WALK, ffi.AMB_SCATTER_PHOTONS):
        image = render(
            scene_of((set_world, (1.0,)), down, *parts[highest:], *parts[:highest]),
            8,
            "Combined",
            effects=SCATTERED | WORLD | SEEN,
            film_transparent=0,
            scatter_estimator=estimator,
            camera_bounces=32,
            light_samples=2**16,
            samples=256,
        )
        assert image.report["warnings"] == []
        is_walk = estimator == ffi.AMB_SCATTER_WALK
        value = float(image.pixels.astype(np.float64).mean())
        assert value == pytest.approx(1, abs=1e-3 if is_walk else 2e-2)


def test_a_camera_in_the_inner_medium() -> None:
    """Inside three objects at once the medium of the highest priority is around the camera."""
    inner, outer = Medium(1.0, 0, 0.7), Medium(1.0, 0, 0.2)
    from_middle = (set_orthographic, ((0.1, 0.07, 0), (0, 0, -1), (0, 1, 0), 0.2))
    world = (set_world, (1.0,))
    for swap in (False, True):
        objects = [slab(-1, 1, inner, 1), slab(-2, 2, outer, 0), slab(-0.5, 0.5, outer, -1)]
        parts = objects[::-1] if swap else objects
        value = seen(world, from_middle, *parts, effects=BACKGROUND)
        # Rays begin a millimetre away.
        assert value == pytest.approx(np.exp(-0.7 * 0.999 - 0.2), rel=1e-5)


def test_a_glass_stands_on_a_table() -> None:
    """Faces that coincide with an opaque one: the table is seen through the glass, and nowhere
    what is below it."""

    def table(scene: Any) -> None:  # noqa: ANN401
        glow = scene.add_material(
            "table", surface=ffi.AMB_SURFACE_DIFFUSE, albedo=rgb(0), emission=rgb(0.5)
        )
        plane = box((-9, -9, -1), (9, 9, 0))
        shape = scene.add_mesh("table", plane.positions, plane.triangles)
        scene.add_object("table", shape, np.eye(4).tolist(), [glow])

    aslant = (set_perspective, ((0.3, 0.2, 5), (0.1, 0.1, -1), (0, 1, 0), 0.2))
    glass = (add_dielectric, (box((-3, -3, 0), (3, 3, 1)), Medium(1.0, 0, 0)))
    for parts in ([(table, ()), glass], [glass, (table, ())]):
        image = render(
            scene_of((set_world, (7.0,)), aslant, *parts), 32, "Surface",
            film_transparent=0, effects=BACKGROUND, samples=4,
        )  # fmt: skip
        np.testing.assert_allclose(image.pixels, 0.5, rtol=1e-6)


def test_branches_behind_many_panes_stand_for_those_left_out() -> None:
    """Under a target late branches of a noisy picture are followed by chance: the light is that of
    all of them, and the noise is stated."""
    panes = [slab(0.2 * i, 0.2 * i + 0.1, Medium(1.8, 0, 0)) for i in range(6)]
    lamps = np.zeros((32, 64, 3), np.float32)
    lamps[::4, ::4] = 16.0
    scene = scene_of((world_image, (lamps,)), ABOVE, *panes)
    settings = {"camera_bounces": 128, "effects": BACKGROUND | ffi.AMB_EFFECT_SURFACE_REFLECTION}
    settings |= {"estimator": POINTS_COVARIANCE, "film_transparent": 0}
    truth = render(scene, 16, "Surface", samples=128, **settings)
    image = render(scene, 16, "Surface", accuracy=0.05, seed=1, **settings)
    noise = [float(picture.report["accuracy"]["noise"]) for picture in (truth, image)]
    ratio = image.pixels.astype(np.float64) / truth.pixels.astype(np.float64).mean()
    assert ratio.mean() == pytest.approx(1.0, abs=4 * np.hypot(*noise) / 16)
    difference = (image.pixels - truth.pixels).astype(np.float64) / truth.pixels.mean()
    assert np.sqrt(np.mean(difference**2)) == pytest.approx(np.hypot(*noise), rel=0.3)


# ---- Worlds ------------------------------------------------------------------------------------


def world_image(scene: Any, pixels: Any, to_world: Any = None) -> None:  # noqa: ANN401
    scene.set_world_image(pixels, np.eye(3).tolist() if to_world is None else to_world)


def test_an_even_image_is_a_constant() -> None:
    ball = (add_dielectric, (BALL, Medium(1.5, 0.2, 0.1)))
    effects = BACKGROUND | ffi.AMB_EFFECT_SURFACE_REFLECTION
    even = (world_image, (np.full((4, 8, 3), 0.7, np.float32),))
    view = (set_perspective, ((0, 0, 6), (0, 0, -1), (0, 1, 0), 0.4))
    assert seen(even, view, ball, effects=effects, size=16) == pytest.approx(
        seen((set_world, (0.7,)), view, ball, effects=effects, size=16), rel=1e-6
    )


@pytest.mark.parametrize("has_sun", [False, True])
def test_an_image_lights_a_table(has_sun: bool) -> None:
    """Irradiance of a face under an image is an integral over the upper half of it."""
    height, width = 32, 64
    rows = (np.arange(height) + 0.5) / height * np.pi  # from below
    columns = np.pi - 2 * np.pi * (np.arange(width) + 0.5) / width
    pixels = np.empty((height, width, 3), np.float32)
    pixels[:] = (1.6 - np.cos(rows)[:, None] + 0.5 * np.cos(columns)[None])[..., None]
    if has_sun:
        pixels[24, 10] += 4000.0

    def table(scene: Any) -> None:  # noqa: ANN401
        white = scene.add_material("table", surface=ffi.AMB_SURFACE_DIFFUSE, albedo=rgb(1))
        plane = box((-9, -9, -1), (9, 9, 0))
        shape = scene.add_mesh("table", plane.positions, plane.triangles)
        scene.add_object("table", shape, np.eye(4).tolist(), [white])

    # The integral on a grid ten times as fine, interpolated as the image is.
    fine = 20
    y = (np.arange(height * fine) + 0.5) / fine
    x = (np.arange(width * fine) + 0.5) / fine
    fy, fx = np.clip(y - 0.5, 0, height - 1), x - 0.5
    y0, x0 = np.floor(fy).astype(int), np.floor(fx).astype(int)
    ty, tx = (fy - y0)[:, None], (fx - x0)[None]
    grey = pixels[..., 0].astype(np.float64)
    y1, x1 = np.minimum(y0 + 1, height - 1), (x0 + 1) % width
    x0 %= width
    value = (1 - ty) * ((1 - tx) * grey[y0][:, x0] + tx * grey[y0][:, x1]) + ty * (
        (1 - tx) * grey[y1][:, x0] + tx * grey[y1][:, x1]
    )
    theta = np.pi * y / height
    weight = np.maximum(-np.cos(theta), 0) * np.sin(theta)
    cell = np.pi / (height * fine) * 2 * np.pi / (width * fine)
    expected = (value * weight[:, None]).sum() * cell / np.pi
    parts = [(world_image, (pixels,)), (table, ()), DOWN]
    found = seen(*parts, effects=BACKGROUND, samples=64, size=16)
    assert found == pytest.approx(expected, rel=3e-3)
    report = render(scene_of(*parts), 1, "Surface", effects=BACKGROUND).report
    assert report["light"]["world_suns"] == (1 if has_sun else 0)


@pytest.mark.parametrize("estimator", ["TUBES", "POINTS_COVARIANCE"])
def test_a_bright_spot_of_an_image_is_a_sun(estimator: str) -> None:
    """One bright pixel in the dark lights a ball of resin as a sun of its flux and size does."""
    height, width = 64, 128
    pixels = np.zeros((height, width, 3), np.float32)
    row, column, value = 48, 20, 800.0
    pixels[row, column] = value
    theta = np.pi * (row + 0.5) / height
    phi = np.pi - 2 * np.pi * (column + 0.5) / width
    from_sun = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), -np.cos(theta)])
    h = np.pi / height
    flux = value * np.sin(theta) * 2 * (1 - np.cos(h)) / h * h
    # A tent of interpolation on either side: variances h^2/6, one of them nearer to the pole.
    angle = 2 * np.sqrt(2 * (h**2 + (h * np.sin(theta)) ** 2) / 6)

    def sun(scene: Any) -> None:  # noqa: ANN401
        scene.add_light(
            ffi.AMB_LIGHT_SUN, "sun", color=rgb(flux), direction=rgb(-from_sun), angle=angle
        )

    ball = (add_dielectric, (BALL, Medium(1.5, 0.3, 0.1, 0.5)))
    view = (set_perspective, ((0, 0, 6), (0, 0, -1), (0, 1, 0), 0.4))
    settings = {
        "name": "Single Scattering",
        "estimator": getattr(ffi, f"AMB_ESTIMATOR_{estimator}"),
        "light_samples": 2**18,
        "samples": 4,
        "effects": SINGLE,
        "size": 32,
    }
    found = seen((world_image, (pixels,)), ball, view, **settings)
    assert found == pytest.approx(seen((sun, ()), ball, view, **settings), rel=2e-3)
    assert found > 0


def test_a_sun_in_an_image_is_seen() -> None:
    """The lamp takes its light out of the image, but not out of the picture."""
    pixels = np.full((64, 128, 3), 0.1, np.float32)
    pixels[32, 64] = 1e5

    def view(scene: Any) -> None:  # noqa: ANN401
        scene.set_camera(
            ffi.AMB_CAMERA_PERSPECTIVE, look((0, 0, 0), (1, 0, 0), (0, 0, 1)).tolist(),
            window=(-0.05, 0.05, -0.05, 0.05),
        )  # fmt: skip

    image = render(
        scene_of((world_image, (pixels,)), (view, ())), 8, "Combined", film_transparent=0
    )
    assert image.report["light"]["world_suns"] == 1
    assert image.pixels[..., 0].max() > 4e4
