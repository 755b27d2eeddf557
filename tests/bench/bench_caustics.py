#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Error of caustics on a floor against a finer map: kernels of several sizes, several budgets.

    python3 tests/bench/bench_caustics.py [SCENE ...]

Prints the root of the mean squared error over the mean irradiance of the floor, and CPU seconds,
for each kernel size and number of light samples. The reference has 16 times as many samples as the
largest budget and shares the camera rays.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "images"))
from api import Medium, add_body, add_sun  # noqa: E402
from api import _ffi as ffi  # noqa: E402
from api import render as render_image  # noqa: E402
from meshes import Mesh, box, bumpy_sphere  # noqa: E402
from test_caustics import ALBEDO, add_floor, look_down, raised  # noqa: E402

CLEAR = Medium(1.5, 0, 0)
SIZE, SAMPLES = 64, 64
BUDGETS = (2**18, 2**20)
KERNELS = (0.5, 1.0, 2.0, 4.0, 8.0)


def add_soft_sun(scene: Any) -> None:  # noqa: ANN401
    scene.add_light(
        ffi.AMB_LIGHT_SUN, "sun", color=[1.0] * 3, direction=[0.2, 0.0, -1.0], angle=0.1
    )


def build(scene: Any, kind: str) -> None:  # noqa: ANN401
    mesh: Mesh = raised(bumpy_sphere(5), 1.4)
    if kind == "box":
        mesh = box((-0.8, -0.8, 0.1), (0.8, 0.8, 1.2))
    if kind == "soft":
        add_soft_sun(scene)
    else:
        add_sun(scene, (0.2, 0.1, -1), 1.0)
    add_body(scene, mesh, CLEAR)
    add_floor(scene)
    look_down(scene, 3.0, 0.08)


def floor(kind: str, light_samples: int, kernel_size: float) -> tuple[np.ndarray, float]:
    """Irradiance, W/m^2, and CPU seconds of the stages."""
    image = render_image(
        lambda scene: build(scene, kind),
        SIZE,
        "Surface",
        effects=ffi.AMB_EFFECT_CAUSTICS,
        samples=SAMPLES,
        light_samples=light_samples,
        kernel_size=kernel_size,
    )
    cost = sum(stage["cpu_s"] for stage in image.report["stages"])
    return image.pixels[..., 0].astype(np.float64) * np.pi / ALBEDO, cost


def main() -> None:
    for kind in sys.argv[1:] or ("bumpy", "box", "soft"):
        print(f"\n| {kind}: samples | " + " | ".join(f"C_k {k:g}" for k in KERNELS) + " |")
        print("|---|" + "---|" * len(KERNELS))
        reference, _ = floor(kind, 16 * BUDGETS[-1], 1.0 if kind == "bumpy" else 8.0)
        for budget in BUDGETS:
            cells = []
            for kernel in KERNELS:
                image, cost = floor(kind, budget, kernel)
                error = np.sqrt(np.mean((image - reference) ** 2)) / reference.mean()
                cells.append(f"{error:.4f}, {cost:.1f} s")
            print(f"| {budget} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
