# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes, references and runs that show whether a render's stated error is its true one.

A reference has another seed, tubes of refinement 2, and either very many samples for every pixel or
a target far below those that it judges.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import metrics
import numpy as np
from api import (
    TUBES,
    BuildScene,
    Medium,
    _ffi,
    add_body,
    add_point,
    add_spot,
    add_sun,
    handles,
    render,
    rgb,
    set_orthographic,
    set_perspective,
)
from meshes import Mesh, box, bumpy_sphere, icosphere
from numpy.typing import NDArray

RESIN = Medium(1.5, (0.1, 0.2, 0.4), (0.02, 0.05, 0.1))
HAZE = Medium(1.3, (0.3, 0.25, 0.2), (0.01, 0.02, 0.04), 0.7)
WAX = Medium(1.5, (4.5, 3.0, 2.0), (0.2, 0.3, 0.5))

GLOW = Medium(1.0, (3.0, 2.5, 2.0), (0.1, 0.1, 0.2))

Light = Callable[[handles.Scene], None]


def point(scene: handles.Scene) -> None:
    add_point(scene, (-5.0, 2.0, 1.0), (60.0, 50.0, 40.0))


def sun(scene: handles.Scene) -> None:
    add_sun(scene, (1.0, -0.5, -0.3), (3.0, 2.5, 2.0))


def spot(scene: handles.Scene) -> None:
    add_spot(scene, (-3.0, 3.0, 0.5), (1.0, -1.0, -0.1), (60.0, 50.0, 40.0), 0.2)


def lit(body: Any, medium: Medium, light: Light) -> BuildScene:
    """The body at the origin, seen from 5 m."""

    def build(scene: handles.Scene) -> None:
        add_body(scene, body, medium)
        light(scene)
        set_perspective(scene, (0, 0, 5), (0, 0, -1), (0, 1, 0), 0.5)

    return build


def scenes() -> dict[str, BuildScene]:
    bumpy, ball = bumpy_sphere(4), icosphere(4)
    slab = box((-1.0, -1.0, -0.4), (1.0, 1.0, 0.4))
    return {
        "bumpy, point": lit(bumpy, RESIN, point),
        "bumpy, sun, g 0.7": lit(bumpy, HAZE, sun),
        "slab, point": lit(slab, RESIN, point),
        "sphere, sun": lit(ball, RESIN, sun),
        "sphere, spot, g 0.7": lit(ball, HAZE, spot),
    }


def thick_scenes() -> dict[str, BuildScene]:
    """Where later orders are most of the light."""
    slab = box((-1.0, -1.0, -0.4), (1.0, 1.0, 0.4))
    return {"slab, wax": lit(slab, WAX, point), "sphere, wax": lit(icosphere(4), WAX, point)}


def over_floor(body: Any, medium: Medium, light: Light, is_seen: bool) -> BuildScene:
    """The body above a grey floor. The camera sees both, or from between them the floor alone."""

    def build(scene: handles.Scene) -> None:
        lifted = Mesh(body.positions + np.array((0, 0, 1.6)), body.triangles, body.normals)
        add_body(scene, lifted, medium)
        points = np.array([(-4, -4, 0), (4, -4, 0), (4, 4, 0), (-4, 4, 0)], dtype=np.float64)
        triangles = np.array([(0, 1, 2), (0, 2, 3)], np.uint32)
        grey = scene.add_material("floor", surface=_ffi.AMB_SURFACE_DIFFUSE, albedo=rgb(0.5))
        mesh = scene.add_mesh("floor", points, triangles, None, _ffi.AMB_NORMALS_NONE, None)
        scene.add_object("floor", mesh, np.eye(4).tolist(), [grey])
        light(scene)
        if is_seen:
            set_perspective(scene, (0, -7, 5), (0, 7, -4.5), (0, 0, 1), 0.5)
        else:
            set_orthographic(scene, (0, 0, 0.05), (0, 0, -1), (0, 1, 0), 3.0)

    return build


def bulb(scene: handles.Scene) -> None:
    scene.add_light(
        _ffi.AMB_LIGHT_POINT, "bulb", color=[60, 50, 40], position=[-1.0, 1.0, 4.0], radius=0.15
    )


def window(scene: handles.Scene) -> None:
    scene.add_light(
        _ffi.AMB_LIGHT_AREA,
        "window",
        color=[3.0, 3.0, 3.0],
        position=[0, 1.0, 4.0],
        direction=[0, -0.2, -1.0],
        tangent=[1, 0, 0],
        size=[0.5, 0.5],
    )


def beam(scene: handles.Scene) -> None:
    """On the body alone."""
    add_spot(scene, (0.5, 0.3, 6.0), (-0.5, -0.3, -4.4), (60.0, 50.0, 40.0), 0.2)


CAUSTICS: dict[str, Any] = {
    "effects": _ffi.AMB_EFFECT_CAUSTICS
    | _ffi.AMB_EFFECT_BACKGROUND
    | _ffi.AMB_EFFECT_SURFACE_REFLECTION
    | _ffi.AMB_EFFECT_SINGLE_SCATTERING,
    "name": "Combined",
    "light_bounces": 1,
    "camera_bounces": 1,
}
"""Settings of the scenes below."""


def caustic_scenes() -> dict[str, BuildScene]:
    """Where light through an object lands beside it."""
    bumpy, glass = bumpy_sphere(4), Medium(1.5, 0, 0)
    return {
        "floor, window": over_floor(bumpy, glass, window, False),
        "ball on floor, bulb": over_floor(icosphere(4), glass, bulb, True),
        "resin on floor, bulb": over_floor(bumpy, RESIN, bulb, True),
        # Nothing is bent, and next to nothing goes straight through: what lands has scattered.
        "glow on floor, beam": over_floor(icosphere(4), GLOW, beam, False),
    }


@dataclass(frozen=True)
class Run:
    """One render against a reference; errors relative."""

    scene: str
    estimator: str
    target: float
    seed: int
    stated: float
    true: float
    report: dict[str, Any]

    @property
    def ratio(self) -> float:
        return self.true / self.stated

    def __str__(self) -> str:
        a = self.report["accuracy"]
        return (
            f"{self.scene:20} {self.estimator:17} {100 * self.target:4.1f} % "
            f"{100 * self.stated:5.2f} % {100 * a['noise']:5.2f} % {100 * a['field']:5.2f} % "
            f"{100 * a['caustics']:5.2f} % {100 * self.true:5.2f} % {self.ratio:5.2f} "
            f"{a['samples_mean']:7.1f}"
        )


def reference(build: BuildScene, size: int, **budget: Any) -> NDArray[np.float64]:
    image = render(build, size, estimator=TUBES, tube_refinement=2, seed=4711, **budget)
    return image.pixels.astype(np.float64)


def run(
    build: BuildScene,
    truth: NDArray[np.float64],
    name: str,
    estimator: tuple[str, int],
    target: float,
    seed: int,
    settings: dict[str, Any] | None = None,
) -> Run:
    params = {"estimator": estimator[1], "accuracy": target, "seed": seed} | (settings or {})
    image = render(build, len(truth), **params)
    true = metrics.rel_rmse(image.pixels[..., :3], truth[..., :3], image.cover > 0)
    stated = image.report["accuracy"]["stated"]
    return Run(name, estimator[0], target, seed, stated, true, image.report)


def share_within(runs: Iterable[Run], factor: float = 1.5) -> tuple[float, float]:
    """Parts of the runs whose true error is at most `factor` times the stated one, and the other
    way round."""
    ratios = np.array([run.ratio for run in runs])
    return float(np.mean(ratios <= factor)), float(np.mean(ratios >= 1 / factor))
