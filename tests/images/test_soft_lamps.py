# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps with an extent, rendered by tubes, against many lamps without one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from api import (
    ESTIMATORS,
    SINGLE,
    TUBES,
    Medium,
    _ffi,
    add_body,
    handles,
    render,
    rgb,
    set_perspective,
)
from meshes import bumpy_sphere, large_slab
from metrics import rel_rmse
from oracles import half_space, sun_disc
from order_scenes import Camera, OrderScene, Sun, passes

SIZE, LAMPS = 16, 100
POSITION = np.array([-4.5, 1.5, -1.6])
AXIS = -POSITION / np.linalg.norm(POSITION)
ACROSS = np.cross(AXIS, (0.0, 0.0, 1.0))
ACROSS /= np.linalg.norm(ACROSS)
UP = np.cross(ACROSS, AXIS)

AddLamps = Callable[[handles.Scene], None]


def scene(add_lamps: AddLamps) -> Callable[[handles.Scene], None]:
    mesh = bumpy_sphere(3)

    def build(handle: handles.Scene) -> None:
        add_body(handle, mesh, Medium(1.5, (0.2, 0.3, 0.4), (0.02, 0.01, 0.06), 0.6))
        add_lamps(handle)
        set_perspective(handle, (0, 0, 5), (0, 0, -1), (0, 1, 0), np.radians(30))

    return build


def disc(count: int) -> np.ndarray:
    """Points that cover the unit disc evenly, (count, 2)."""
    i = np.arange(count)
    radius, angle = np.sqrt((i + 0.5) / count), i * np.pi * (3 - np.sqrt(5))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def point_lamp(radius: float) -> tuple[AddLamps, AddLamps]:
    def soft(handle: handles.Scene) -> None:
        handle.add_light(
            _ffi.AMB_LIGHT_POINT, "l", color=rgb(1), position=POSITION.tolist(), radius=radius
        )

    def many(handle: handles.Scene) -> None:
        for u, v in disc(LAMPS):
            place = POSITION + radius * (u * ACROSS + v * UP)
            cosine = -place @ AXIS / np.linalg.norm(place)
            handle.add_light(
                _ffi.AMB_LIGHT_POINT, "l", color=rgb(cosine / LAMPS), position=place.tolist()
            )

    return soft, many


def sun(angle: float) -> tuple[AddLamps, AddLamps]:
    cap = 1 - np.cos(angle / 2)

    def soft(handle: handles.Scene) -> None:
        handle.add_light(
            _ffi.AMB_LIGHT_SUN, "l", color=rgb(1), direction=AXIS.tolist(), angle=angle
        )

    def many(handle: handles.Scene) -> None:
        for u, v in disc(LAMPS):
            cosine = 1 - cap * (u * u + v * v)
            sine, turn = np.sqrt(1 - cosine**2), np.arctan2(v, u)
            direction = AXIS * cosine + sine * (np.cos(turn) * ACROSS + np.sin(turn) * UP)
            # The sun's colour is on a plane across its axis.
            color = rgb(1 / (LAMPS * (1 - cap / 2)))
            handle.add_light(_ffi.AMB_LIGHT_SUN, "l", color=color, direction=direction.tolist())

    return soft, many


def area_lamp(width: float, height: float) -> tuple[AddLamps, AddLamps]:
    def add(handle: handles.Scene, place: np.ndarray, size: tuple[float, float]) -> None:
        handle.add_light(
            _ffi.AMB_LIGHT_AREA,
            "l",
            color=rgb(width * height / (size[0] * size[1])),
            position=place.tolist(),
            direction=AXIS.tolist(),
            tangent=ACROSS.tolist(),
            size=size,
        )

    def many(handle: handles.Scene) -> None:
        side = int(np.sqrt(LAMPS))
        for i in range(side * side):
            u, v = (i % side + 0.5) / side - 0.5, (i // side + 0.5) / side - 0.5
            place = POSITION + width * u * ACROSS + height * v * UP
            handle.add_light(
                _ffi.AMB_LIGHT_AREA,
                "l",
                color=rgb(1e4),
                position=place.tolist(),
                direction=AXIS.tolist(),
                tangent=ACROSS.tolist(),
                size=(1e-2 * width / side, 1e-2 * height / side),
            )

    return lambda handle: add(handle, POSITION, (width, height)), many


@pytest.mark.parametrize(
    ("lamps", "noise"),
    [
        (point_lamp(0.05), 0.02),
        (point_lamp(0.5), 0.02),
        (sun(0.05), 0.02),
        (sun(0.4), 0.02),
        (area_lamp(0.6, 0.3), 0.02),
        (area_lamp(1.0, 2.0), 0.02),
    ],
    ids=["point", "wide point", "sun", "wide sun", "area", "wide area"],
)
def test_soft_lamp_is_the_mean_of_many(lamps: tuple[AddLamps, AddLamps], noise: float) -> None:
    """The same picture as a hundred lamps spread over it, at a fraction of their work."""
    options = {"estimator": ESTIMATORS["TUBES"], "samples": 4}
    soft, many = (render(scene(add), SIZE, **options) for add in lamps)
    mask = soft.cover > 0
    assert soft.pixels[mask].mean() == pytest.approx(many.pixels[mask].mean(), rel=3e-3)
    assert rel_rmse(soft.pixels, many.pixels, mask) < noise
    assert soft.report["light"]["tubes"] < 0.6 * many.report["light"]["tubes"]


@pytest.mark.parametrize(
    ("half_width", "radius", "most"), [(5, 0.0375, 1e-3), (100, 0.0375, 1e-3), (100, 0.3, 8e-3)]
)
def test_triangles_larger_than_free_paths(half_width: float, radius: float, most: float) -> None:
    """A half-space of a few triangles under a sun, seen where their corners meet: each tube covers
    a part of what light is averaged over, together the whole."""
    mu, mu0, albedo = 0.7, 0.5, 0.9
    lamp = Sun((float(np.sqrt(1 - mu0 * mu0)), 0.0, -mu0), radius, 1.0)
    d, share = sun_disc(lamp.direction, radius)
    one = float(np.sum(share * half_space(mu, -d[:, 2], albedo)[0]))
    sin = float(np.sqrt(1 - mu * mu))
    camera = Camera((-10 * sin, 0, 10 * mu), (sin, 0, -mu), (0, 1, 0), (0.5, 0.5), False)
    body = OrderScene(
        large_slab(20, half_width), 1.0, albedo, 1 - albedo, 0.0, camera, [lamp], regions=(1, 1)
    )
    found = passes(body, 16, estimator=TUBES, light_bounces=0, effects=SINGLE)[0, 0, 0]
    assert found == pytest.approx(one, rel=most)
