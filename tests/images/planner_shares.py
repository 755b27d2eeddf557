# SPDX-License-Identifier: GPL-3.0-or-later
"""Shares of effects by brute force: the picture with everything on, less the picture without the
effect, each from two seeds whose product has no noise in expectation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from api import _ffi, handles, library
from numpy.typing import NDArray
from planner_scenes import PlannerScene

Array = NDArray[np.float64]

EVERYTHING = (
    _ffi.AMB_EFFECT_SINGLE_SCATTERING
    | _ffi.AMB_EFFECT_DOUBLE_SCATTERING
    | _ffi.AMB_EFFECT_MULTIPLE_SCATTERING
    | _ffi.AMB_EFFECT_WORLD_LIGHT
    | _ffi.AMB_EFFECT_SURFACE_REFLECTION
    | _ffi.AMB_EFFECT_BACKGROUND
    | _ffi.AMB_EFFECT_TRANSMITTED_LIGHT
)
ORDERS = {
    f"{name} scattering": f"{name.capitalize()} Scattering"
    for name in ("single", "double", "multiple")
}
SWITCHES = {
    "surface reflection": _ffi.AMB_EFFECT_SURFACE_REFLECTION,
    "background through objects": _ffi.AMB_EFFECT_BACKGROUND,
    "light of the surroundings in media": _ffi.AMB_EFFECT_WORLD_LIGHT,
    "light through other objects": _ffi.AMB_EFFECT_TRANSMITTED_LIGHT,
}
COUNTS = {
    "light-side internal reflection": "light_bounces",
    "camera-side internal reflection": "camera_bounces",
}
MOST_BOUNCES = 16
BOUNCES = (0, 1, 2, 4)
SEEDS = (11, 12)


def render_passes(
    scene: PlannerScene, size: int, names: tuple[str, ...] = ("Combined",), **params: Any
) -> tuple[list[Array], dict[str, Any]]:
    """Passes as (size, size, 3), row 0 = bottom, and the report."""
    settings: dict[str, Any] = {
        "width": size,
        "height": size,
        "effects": EVERYTHING,
        "light_bounces": MOST_BOUNCES,
        "camera_bounces": MOST_BOUNCES,
    }
    with handles.Scene(library.load()) as built:
        scene.build(built)
        built.commit()
        with built.start(**(settings | params)) as job:
            job.wait()
            images = [job.read_pass(name)[..., :3].astype(np.float64) for name in names]
            return images, job.report()


def object_mask(scene: PlannerScene, size: int) -> NDArray[np.bool_]:
    """Pixels that show a translucent object; the floor hides none."""
    settings = {"samples": 16, "film_transparent": 1, "effects": 0}
    with handles.Scene(library.load()) as built:
        replace(scene, floor=False).build(built)
        built.commit()
        with built.start(width=size, height=size, **settings) as job:
            job.wait()
            return np.asarray(job.read_pass("Combined")[..., 3] > 0)


@dataclass(frozen=True)
class Truth:
    """Two pictures with everything on and all reflections, of seeds of their own: the product of
    a picture's differences to them has none of their noise in expectation."""

    mask: NDArray[np.bool_]
    halves: tuple[Array, Array]

    def error(self, image: Array) -> float:
        """rel_rmse over the pixels that show a translucent object."""
        return self.bounds(image, 0.0)[0]

    def bounds(self, image: Array, sigmas: float = 2.0) -> tuple[float, float]:
        """Between which it lies, so many standard errors of these pictures to either side."""
        a, b = (image[self.mask] - half[self.mask] for half in self.halves)
        radiance = float(np.mean([half[self.mask] for half in self.halves]))
        squares = np.mean(a * b, axis=-1)
        spread = sigmas * float(squares.std() / np.sqrt(max(len(squares), 1)))
        low, high = (max(float(squares.mean()) + sign * spread, 0.0) for sign in (-1, 1))
        return (np.sqrt(low) / radiance, np.sqrt(high) / radiance) if radiance > 0 else (0.0, 0.0)


def truth(scene: PlannerScene, size: int, **params: Any) -> Truth:
    mask = object_mask(scene, size)
    first, second = (render_passes(scene, size, seed=s, **params)[0][0] for s in SEEDS)
    return Truth(mask, (first, second))


def shares(scene: PlannerScene, size: int, **params: Any) -> dict[str, Any]:
    """By effect: its share, or the shares of the reflections beyond each of BOUNCES."""
    mask = object_mask(scene, size)
    if not mask.any():
        return {}
    names = ("Combined", *ORDERS.values())

    def pixels(names: tuple[str, ...] = ("Combined",), **changed: Any) -> list[list[Array]]:
        """By seed and pass, the object's pixels."""
        return [
            [im[mask] for im in render_passes(scene, size, names, seed=s, **(params | changed))[0]]
            for s in SEEDS
        ]

    full = pixels(names)
    radiance = float(np.mean([half[0] for half in full]))

    def share(a: Array, b: Array) -> float:
        if not radiance > 0:
            return 0.0
        return round(float(np.sqrt(max(np.mean(a * b), 0.0)) / radiance), 6)

    def without(**changed: Any) -> float:
        less = pixels(**changed)
        return share(full[0][0] - less[0][0], full[1][0] - less[1][0])

    found: dict[str, Any] = {
        effect: share(full[0][i + 1], full[1][i + 1]) for i, effect in enumerate(ORDERS)
    }
    for effect, bit in SWITCHES.items():
        found[effect] = without(effects=EVERYTHING & ~bit)
    for effect, name in COUNTS.items():
        found[effect] = [without(**{name: count}) for count in BOUNCES]
    return found
