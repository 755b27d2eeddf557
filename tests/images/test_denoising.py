# SPDX-License-Identifier: GPL-3.0-or-later
"""The passes for denoisers: what is known of a scene without its light."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from api import Medium, add_body, add_sun, handles, render, rgb, set_orthographic
from api import _ffi as ffi
from meshes import box, icosphere
from numpy.typing import NDArray
from order_scenes import SCATTERED, SEEN
from test_light_paths import VIEW, scene_of
from test_nested import set_world, slab

BALL = icosphere(4)
DOWN = (set_orthographic, ((0, 0, 9), (0, 0, -1), (0, 1, 0), 0.2))
FLOOR = box((-9, -9, -1), (9, 9, 0))


def add_floor(scene: handles.Scene, albedo: list[float]) -> None:
    material = scene.add_material("floor", surface=ffi.AMB_SURFACE_DIFFUSE, albedo=albedo)
    shape = scene.add_mesh("floor", FLOOR.positions, FLOOR.triangles, None, ffi.AMB_NORMALS_NONE)
    scene.add_object("floor", shape, np.eye(4).tolist(), [material])


def seen(name: str, *parts: tuple[Any, Any], size: int = 8, **params: Any) -> NDArray[np.float64]:
    settings = {"film_transparent": 0, "effects": SCATTERED | SEEN, "samples": 16} | params
    pixels = render(scene_of(*parts), size, f"Denoising {name}", **settings).pixels
    return pixels.astype(np.float64)


def test_an_opaque_surface_has_its_albedo_and_normal_in_any_light() -> None:
    colour = [0.7, 0.2, 0.05]
    scene = ((add_floor, (colour,)), DOWN, (add_sun, ((0.6, 0, -0.8), 50.0)))
    assert seen("Albedo", *scene) == pytest.approx(np.broadcast_to(colour, (8, 8, 3)), rel=1e-6)
    assert seen("Normal", *scene) == pytest.approx(np.broadcast_to([0, 0, 1], (8, 8, 3)), abs=1e-6)


@pytest.mark.parametrize("ior", [1.0, 1.5, 2.4])
def test_clear_glass_hides_nothing(ior: float) -> None:
    """All branches together see the even world, and its floor the index of what is around it."""
    world = (set_world, (0.4,))
    ball = (add_body, (BALL, Medium(ior, 0, 0)))
    albedo = seen("Albedo", world, ball, VIEW, size=24, camera_bounces=64)
    assert albedo.mean() == pytest.approx(0.4, rel=2e-3)
    pond = (slab(-0.5, 1.0, Medium(ior, 0, 0)), (add_floor, (rgb(0.4),)))
    assert seen("Albedo", world, *pond, DOWN, camera_bounces=64).mean() == pytest.approx(
        0.4, rel=2e-3
    )


def test_media_show_what_they_scatter() -> None:
    """Optical depth 2 of albedo 0.75 before a floor; from inside the same medium, too."""
    fog = Medium(1.0, 0.75, 0.25)
    gone = 1 - np.exp(-2.0)
    expected = 0.75 * gone + 0.3 * (1 - gone)
    parts = (slab(-0.5, 2.0, fog), (add_floor, (rgb(0.3),)))
    assert seen("Albedo", *parts, DOWN) == pytest.approx(expected, rel=1e-5)
    resin = Medium(1.5, 0.75, 0.25)
    inside = (set_orthographic, ((0, 0, 2), (0, 0, -1), (0, 1, 0), 0.2))
    parts = (slab(-0.5, 3.0, resin), (add_floor, (rgb(0.3),)))
    assert seen("Albedo", *parts, inside) == pytest.approx(expected, rel=1e-3)


def test_what_shines_is_at_most_white() -> None:
    assert seen("Albedo", (set_world, (7.0,)), VIEW) == pytest.approx(1.0)
    assert np.all(seen("Normal", (set_world, (7.0,)), VIEW) == 0.0)


def test_normals_are_those_that_are_shown() -> None:
    """Of a smooth ball, towards the eye: the radius where the ray meets it."""
    ball = (add_body, (BALL, Medium(1.5, 0, 0)))
    eye = (set_orthographic, ((0, 0, 9), (0, 0, -1), (0, 1, 0), 1.0))
    normal = seen("Normal", ball, eye, size=32, samples=1)
    z = normal[..., 2]
    middle = (np.arange(32) + 0.5) / 32 - 0.5
    x, y = np.meshgrid(middle, -middle)
    assert np.all(z > 0.6)
    assert normal[..., 0] == pytest.approx(x, abs=0.03)
    assert normal[..., 1] == pytest.approx(y, abs=0.03)
