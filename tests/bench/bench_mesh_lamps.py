#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Noise of light that a mesh emits, found as that of a lamp and by chance.

    python3 tests/bench/bench_mesh_lamps.py [--by-chance LIBRARY] [SCENE ...]

A bright square over a floor, the same through a ball of glass, and over a ball of resin: light
that scatters once, and later orders too, from photons. LIBRARY is another build, of which meshes
are found by chance: then the ratio of its CPU time at equal error is printed, too. Errors are by
pixel, from the difference of two pictures with other seeds, over the mean.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "images"))
from api import SINGLE, Medium, add_body, set_perspective  # noqa: E402
from api import _ffi as ffi  # noqa: E402
from api import render as render_image  # noqa: E402
from meshes import icosphere  # noqa: E402
from test_mesh_lamps import RESIN, SCATTERING, add_floor, add_opaque, square  # noqa: E402

SIZE, SAMPLES = 32, 64
CLEAR = Medium(1.5, 0, 0.05)
SCENES = ("floor", "caustic", "once", "photons")


def build(scene: Any, kind: str, half: float) -> None:  # noqa: ANN401
    if kind in ("floor", "caustic"):
        add_floor(scene, -1.2)
    if kind != "floor":
        add_body(scene, icosphere(4), CLEAR if kind == "caustic" else RESIN)
    add_opaque(scene, square(half, 3.0), "plane", emission=1.0 / (4 * half * half))
    set_perspective(scene, (4, 0, 2.4), (-4, 0, -2.6), (0, 0, 1), 0.7)


def measure(kind: str, half: float) -> tuple[float, float, float]:
    """Mean, relative error of one picture and its CPU seconds."""
    # Without images of what shines, which are as bright either way.
    effects = ffi.AMB_EFFECT_CAUSTICS | ffi.AMB_EFFECT_INTERREFLECTION
    if kind in ("once", "photons"):
        effects = (SINGLE if kind == "once" else SCATTERING) | ffi.AMB_EFFECT_WORLD_LIGHT
    images, seconds = [], 0.0
    for seed in (1, 2):
        image = render_image(
            lambda scene: build(scene, kind, half),
            SIZE,
            "Combined",
            effects=effects,
            samples=SAMPLES,
            seed=seed,
            light_bounces=4,
            camera_bounces=4,
            light_samples=2**18,
            scatter_estimator=ffi.AMB_SCATTER_WALK if kind == "once" else ffi.AMB_SCATTER_PHOTONS,
            threads=1,
        )
        images.append(image.pixels[..., :3].astype(np.float64))
        seconds += sum(stage["cpu_s"] for stage in image.report["stages"]) / 2
    mean = float(np.mean(images))
    error = float(np.sqrt(np.mean((images[0] - images[1]) ** 2) / 2))
    return mean, error / mean, seconds


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--by-chance", type=Path)
    parser.add_argument("--raw", action="store_true", help="numbers alone")
    parser.add_argument("scenes", nargs="*", default=SCENES)
    arguments = parser.parse_args()
    if not arguments.raw:
        print("| scene | side | mean | error | CPU s | by chance: mean | error | ratio |")
        print("|---|---|---|---|---|---|---|---|")
    for kind in arguments.scenes:
        for half in (0.5, 0.1):
            ours = measure(kind, half)
            if arguments.raw:
                print(*ours)
                continue
            row = f"| {kind} | {2 * half:g} | {ours[0]:.4f} | {ours[1]:.3f} | {ours[2]:.2f} |"
            other = by_chance(arguments.by_chance, kind)[half] if arguments.by_chance else None
            if other is not None:
                ratio = (other[1] / ours[1]) ** 2 * other[2] / ours[2]
                row += f" {other[0]:.4f} | {other[1]:.3f} | {ratio:.0f} |"
            print(row, flush=True)


def by_chance(library: Path, kind: str) -> dict[float, tuple[float, float, float]]:
    """The same of another library, which a process can load but one of."""
    output = subprocess.run(
        [sys.executable, __file__, "--raw", kind],
        env=os.environ | {"AMBERLIGHT_LIBRARY": str(library)},
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    rows = [tuple(float(word) for word in line.split()) for line in output.splitlines()]
    return {0.5: rows[0], 0.1: rows[1]}  # type: ignore[dict-item]


if __name__ == "__main__":
    main()
