# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles and Amberlight on one .blend, in one Blender, on the CPU. Prints markdown; never asserts.

    python3 tests/bench/bench_cycles.py [--blend FILE] [--size 128] [--seconds 120]
                                        [--radii 0,0.1,0.5] [--threads 2]

Both render single scattering alone, with the same lamps, camera and pixel filter. For each radius
of the lamps, in units of the object's, errors of both are against our own converged image with
the same lamps, and the means of both are compared where Cycles converges. CPU seconds are the
whole process's during the render. Cycles gets `seconds` of CPU for each curve.

A lamp of some radius is seen through the object, and is no single scattering: render_blend.py
takes those paths out of Cycles' image, and ours are switched off.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests/images"))

import metrics  # noqa: E402
import pictures  # noqa: E402

Image = NDArray[np.float64]
BATCHES = 8  # independent renders behind Cycles' last row
REFERENCE_SAMPLES = 128  # a pixel
REFERENCE_POINTS = 2**22  # volume samples, where tubes cannot be used


@dataclass(frozen=True)
class Render:
    """(height, width, 4) and the CPU seconds that it took."""

    pixels: Image
    seconds: float


class Blender:
    """Renders lists of jobs, one Blender for each list."""

    def __init__(self, blend: Path, size: int, threads: int) -> None:
        self.blend, self.size, self.threads = blend, size, threads
        self.object_radius, self.version = 1.0, ""
        self.run([])

    def run(self, jobs: list[dict]) -> list[Render]:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            common = {"size": self.size, "threads": self.threads}
            for i, job in enumerate(jobs):
                jobs[i] = common | job | {"out": str(folder / f"{i}.npy")}
            (folder / "jobs.json").write_text(json.dumps(jobs))
            command = [str(ROOT / "amberlight"), "blender", "-b", "--factory-startup"]
            command += [str(self.blend), "--python-exit-code", "1"]
            command += ["--python", str(Path(__file__).with_name("render_blend.py")), "--"]
            command += [str(folder / "jobs.json"), str(folder / "done.json")]
            result = subprocess.run(command, capture_output=True, text=True)
            if result.returncode != 0:
                sys.exit(result.stdout + result.stderr)
            done = json.loads((folder / "done.json").read_text())
            self.object_radius, self.version = done["object_radius"], done["version"]
            files = [np.load(folder / f"{i}.npy").astype(np.float64) for i in range(len(jobs))]
        return [Render(p, s) for p, s in zip(files, done["cpu_s"], strict=True)]


def cycles(radius: float, samples: int, seed: int, blur: float) -> dict:
    return {
        "engine": "CYCLES",
        "radius": radius,
        "samples": samples,
        "seed": seed,
        "blur_glossy": blur,
    }


def amberlight(radius: float, samples: int, seed: int, **settings: object) -> dict:
    return {
        "engine": "AMBERLIGHT",
        "radius": radius,
        "samples": samples,
        "seed": seed,
        "settings": settings,
    }


# ---- One radius ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Row:
    name: str
    samples: int
    seconds: float
    image: Image


def curve_of_cycles(
    blender: Blender, radius: float, blur: float, budget: float
) -> tuple[list[Row], list[Image]]:
    """Renders of growing size, then BATCHES equal ones for what is left; their mean is the last."""
    name = f"Cycles, Filter Glossy {blur:g}"
    rows: list[Row] = []
    spent, samples = 0.0, 16
    while not rows or spent + 4 * rows[-1].seconds < budget / 3:
        (render,) = blender.run([cycles(radius, samples, len(rows), blur)])
        rows.append(Row(name, samples, render.seconds, render.pixels[..., :3]))
        spent += render.seconds
        samples *= 4
    pace = rows[-1].seconds / rows[-1].samples
    each = max(16, int((budget - spent) / pace / BATCHES))
    jobs = [cycles(radius, each, 100 + k, blur) for k in range(BATCHES)]
    batches = blender.run(jobs)
    images = [batch.pixels[..., :3] for batch in batches]
    seconds = sum(batch.seconds for batch in batches)
    rows.append(Row(name, each * BATCHES, seconds, np.mean(images, axis=0)))
    return rows, images


def rows_of_amberlight(blender: Blender, radius: float) -> list[Row]:
    rows = []
    if radius == 0:
        settings = [
            (s, r, {"estimator": "TUBES", "tube_refinement": r})
            for s, r in ((4, 0), (16, 0), (64, 1))
        ]
        rows += [(f"TUBES, refinement {r}", s, value) for s, r, value in settings]
    for samples, light in ((4, 2**17), (16, 2**19), (16, 2**21)):
        value = {"estimator": "POINTS_COVARIANCE", "light_samples": light}
        rows.append((f"POINTS_COVARIANCE, {light}", samples, value))
    renders = blender.run([amberlight(radius, s, 1, **value) for _, s, value in rows])
    return [
        Row(name, samples, render.seconds, render.pixels[..., :3])
        for (name, samples, _), render in zip(rows, renders, strict=True)
    ]


def reference(blender: Blender, radius: float) -> tuple[Image, NDArray[np.bool_]]:
    """Our converged image and the pixels to compare."""
    best = {"estimator": "POINTS_COVARIANCE", "light_samples": REFERENCE_POINTS, "kernel_size": 4.0}
    if radius == 0:
        best = {"estimator": "TUBES", "tube_refinement": 2}
    (ours,) = blender.run([amberlight(radius, REFERENCE_SAMPLES, 7, **best)])
    return ours.pixels[..., :3], ours.pixels[..., 3] > 0


def print_rows(rows: list[Row], truth: Image, mask: NDArray[np.bool_]) -> None:
    print("| | samples a pixel | CPU s | `rel_rmse` | `floored_rel` | mean / ours | pixels at 0 |")
    print("|---|---|---|---|---|---|---|")
    for row in rows:
        ratio = row.image[mask].mean() / truth[mask].mean()
        dark = np.mean(row.image[mask].max(axis=-1) == 0)
        print(
            f"| {row.name} | {row.samples} | {row.seconds:.2f} "
            f"| {100 * metrics.rel_rmse(row.image, truth, mask):.3g} % "
            f"| {100 * metrics.floored_rel(row.image, truth, mask):.3g} % "
            f"| {ratio:.4f} | {100 * dark:.1f} % |",
            flush=True,
        )


def print_mean(name: str, images: list[Image], truth: Image, mask: NDArray[np.bool_]) -> None:
    means = np.array([image[mask].mean() for image in images]) / truth[mask].mean()
    spread = means.std(ddof=1) / np.sqrt(len(means))
    print(f"{name}: mean over ours {means.mean():.4f}, standard error {spread:.4f}", flush=True)


def compare(blender: Blender, factor: float, budget: float) -> list[NDArray[np.uint8]]:
    """Prints the tables of one radius; returns its row of pictures: Cycles in about our time,
    Cycles at its budget, ours, ours converged."""
    radius = factor * blender.object_radius
    truth, mask = reference(blender, radius)
    print(f"\n### Lamp radius {factor:g} of the object's ({radius:.3g})\n")
    ours = rows_of_amberlight(blender, radius)
    blurs = (0.0, 1.0) if factor == 0 else (0.0,)
    curves = [curve_of_cycles(blender, radius, blur, budget) for blur in blurs]
    print_rows([row for rows, _ in curves for row in rows] + ours, truth, mask)
    print()
    for rows, images in curves:
        print_mean(rows[-1].name, images, truth, mask)
    rows, _ = curves[-1]
    shown = ours[1]
    near = min(rows, key=lambda row: abs(np.log(row.seconds / shown.seconds)))
    exposure = pictures.exposure_of(truth, mask)
    print(
        f"Picture: {near.name} in {near.seconds:.2f} s; in {rows[-1].seconds:.0f} s; {shown.name} "
        f"in {shown.seconds:.2f} s; ours converged."
    )
    return [
        pictures.display(np.where(mask[..., None], image, 0), exposure)
        for image in (near.image, rows[-1].image, shown.image, truth)
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--blend", type=Path, default=ROOT / "scenes_blend/bumpy_sphere.blend")
    parser.add_argument("--size", type=int, default=128, help="pixels, square (128)")
    parser.add_argument("--seconds", type=float, default=120, help="CPU of a Cycles curve (120)")
    parser.add_argument("--radii", default="0,0.1,0.5", help="of lamps, in the object's radius")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--png", type=Path, default=ROOT / "out/cycles.png")
    arguments = parser.parse_args()
    blender = Blender(arguments.blend.resolve(), arguments.size, arguments.threads)
    print(
        f"{arguments.blend.name}, Blender {blender.version}, {arguments.size}^2, "
        f"{arguments.threads} thread(s), up to {arguments.seconds:g} CPU s for a curve of Cycles"
    )
    factors = [float(word) for word in arguments.radii.split(",")]
    rows = [compare(blender, factor, arguments.seconds) for factor in factors]
    pictures.write_png(arguments.png, pictures.montage(rows))
    print(f"\nwrote {arguments.png}")


if __name__ == "__main__":
    main()
