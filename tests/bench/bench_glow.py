#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that scattered once on its way to a floor: from photons, and from gathers.

    python3 tests/bench/bench_glow.py [SCENE ...]

TREE_CUT, asked for by name, gathers along rays from the floor. Prints the means with the standard
errors of both, the root of the mean squared error of both by pixel over the mean, against a
reference of many gathers, their CPU seconds, and the camera samples on surfaces from which photons,
which cost the same for any picture, take less time for the same error.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "images"))
from api import Medium, add_body, rgb  # noqa: E402
from api import _ffi as ffi  # noqa: E402
from api import render as render_image  # noqa: E402
from meshes import box, icosphere  # noqa: E402
from test_caustics import add_floor, look_down, raised  # noqa: E402

SIZE = 16
EFFECTS = ffi.AMB_EFFECT_CAUSTICS | ffi.AMB_EFFECT_SINGLE_SCATTERING
LIGHT_SAMPLES = 2**20
SAMPLES, MANY = 16, 2048
# Optical radius and index of a ball, or of a box.
SCENES = {
    "thin": (0.3, 1.5),
    "middle": (2.0, 1.5),
    "box": (0.5, 1.0),
    "near": (0.5, 1.0),
    "thick": (10.0, 1.5),
}
# Of boxes above the floor.
HEIGHTS = {"box": 0.2, "near": 0.002}
SEEDS = 4  # of photons


def build(scene: Any, kind: str) -> None:  # noqa: ANN401
    sigma_t, ior = SCENES[kind]
    scene.add_light(
        ffi.AMB_LIGHT_POINT, "lamp", color=rgb(100.0), position=rgb((1.5, 0.5, 4)), radius=0.0
    )
    mesh = raised(icosphere(5), 1.2)
    if kind in HEIGHTS:
        mesh = box((-1, -0.7, HEIGHTS[kind]), (1, 0.7, HEIGHTS[kind] + 1.2))
    add_body(scene, mesh, Medium(ior, 0.9 * sigma_t, 0.1 * sigma_t))
    add_floor(scene)
    look_down(scene, 6.0, 0.1)


def floor(kind: str, estimator: int, samples: int, seed: int) -> tuple[np.ndarray, float, float]:
    """Radiance of the Single Scattering pass, and CPU seconds of light and camera."""
    image = render_image(
        lambda scene: build(scene, kind),
        SIZE,
        effects=EFFECTS,
        samples=samples,
        seed=seed,
        light_bounces=4,
        light_samples=LIGHT_SAMPLES,
        scatter_estimator=estimator,
    )
    stages = {stage["name"]: stage["cpu_s"] for stage in image.report["stages"]}
    return image.pixels.astype(np.float64).mean(axis=2), stages["light"], stages["camera"]


def main() -> None:
    print("scene    gathers: mean        error  CPU s   photons: mean      error  CPU s   pay from")
    for kind in sys.argv[1:] or SCENES:
        gather, walk = ffi.AMB_SCATTER_TREE_CUT, ffi.AMB_SCATTER_WALK
        references = [floor(kind, gather, MANY, seed)[0] for seed in (1, 2)]
        reference = (references[0] + references[1]) / 2
        spread = abs(references[0].mean() - references[1].mean()) / 2 / reference.mean()
        few, few_light, few_cpu = floor(kind, gather, SAMPLES, 3)
        runs = [floor(kind, walk, SAMPLES, seed) for seed in range(4, 4 + SEEDS)]
        photons, light, cpu = runs[0]
        means = np.array([image.mean() for image, _, _ in runs]) / reference.mean()
        # Caustics are in both.
        cpu += light - few_light
        errors = [
            np.sqrt(np.mean((image - reference) ** 2)) / reference.mean()
            for image in (few, photons)
        ]
        gain = (errors[0] / errors[1]) ** 2 * few_cpu / cpu
        print(
            f"{kind:8} {reference.mean():.5g} +- {spread:.2%}  {errors[0]:6.3f} {few_cpu:6.3f}"
            f"   {means.mean() - 1:+7.2%} +- {means.std(ddof=1) / np.sqrt(SEEDS):.2%}"
            f"  {errors[1]:6.3f} {cpu:6.3f}"
            f"   {SIZE**2 * SAMPLES / gain:8.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
