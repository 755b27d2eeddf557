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
    add_body,
    add_point,
    add_spot,
    add_sun,
    handles,
    render,
    set_perspective,
)
from meshes import box, bumpy_sphere, icosphere
from numpy.typing import NDArray

RESIN = Medium(1.5, (0.1, 0.2, 0.4), (0.02, 0.05, 0.1))
HAZE = Medium(1.3, (0.3, 0.25, 0.2), (0.01, 0.02, 0.04), 0.7)
WAX = Medium(1.5, (4.5, 3.0, 2.0), (0.2, 0.3, 0.5))

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
            f"{100 * self.true:5.2f} % {self.ratio:5.2f} {a['samples_mean']:7.1f}"
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
