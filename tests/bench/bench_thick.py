# SPDX-License-Identifier: GPL-3.0-or-later
"""Later orders of scattering in thick media: walks against photons. Prints; never asserts.

    python3 tests/bench/bench_thick.py [--jade | --means | --normals | --tracer] [--threads N]

First a table over optical radius and albedo of a sphere, index 1.5, lit by a point: the error of
double and multiple scattering together, what it cost, and from both what 3 % would cost in an
image of 256 x 256, in units of what its camera rays alone take. Errors of walks fall with
n^(-1/2), of photons with n^(-1/3): cells get smaller as photons get more. Then jade, optical
radius 20, as sphere and as bumpy sphere, against photons sixteen times as many and along other
camera rays, kept under build/bench. --means is the bias of photons: means of small pictures to
those of walks; --normals is the same of coarse meshes with smooth normals, all reflections, light
corrected for these, and of a candle by regions; --tracer is the same to the stored orders of the
independent path tracer.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "images"))

from api import (  # noqa: E402
    ROOT,
    BuildScene,
    Medium,
    _ffi,
    add_body,
    add_point,
    handles,
    library,
    set_perspective,
)
from meshes import Mesh, bumpy_sphere, icosphere  # noqa: E402
from order_scenes import passes, reference_scene, stored_orders, whole  # noqa: E402
from test_thick import candle_regions  # noqa: E402

LATER = _ffi.AMB_EFFECT_DOUBLE_SCATTERING | _ffi.AMB_EFFECT_MULTIPLE_SCATTERING
WALK, PHOTONS = _ffi.AMB_SCATTER_WALK, _ffi.AMB_SCATTER_PHOTONS
SIZE, SAMPLES, TARGET, BAR = 256, 4, 0.03, 60
TABLE_SIZE = 24  # small: the error of one sample is what counts
JADE_PHOTONS = 2**18
REFERENCE_RUNS = 16


MEANS = [  # shape, optical radius, albedo, g, pairs of walks, photons
    ("sphere", 0.3, 0.9, 0.0, 4, 2**17),
    ("bumpy", 1, 0.9, 0.0, 4, 2**17),
    ("bumpy", 5, 0.9, 0.0, 4, 2**17),
    ("sphere", 5, 0.9, 0.6, 4, 2**17),
    ("sphere", 5, 0.9, 0.7, 4, 2**17),
    ("sphere", 5, 0.9, 0.8, 8, 2**17),
    ("sphere", 5, 0.9, 0.85, 4, 2**17),
    ("sphere", 5, 0.9, 0.9, 4, 2**17),
    ("sphere", 20, 0.9, 0.0, 4, 2**17),
    ("sphere", 20, 0.99, 0.0, 4, 2**17),
    ("sphere", 20, 0.99, 0.7, 8, 2**17),
    ("sphere", 100, 0.9, 0.0, 4, 2**17),
    ("sphere", 100, 0.99, 0.0, 8, 2**16),
    ("sphere", 200, 0.9, 0.0, 4, 2**17),
]
# Smooth normals on 20, 80, 320 and 1280 faces.
COARSE = [(f"{20 * 4**level} faces", 5.0, 0.99, 0.0, 4, 2**17) for level in range(4)]
MEANS_SIZE, MEANS_WALKS, MEANS_PHOTON_RUNS = 16, 64, 4
TRACED = [("sphere", 10.0), ("slab", 10.0), ("bumpy", 2.0), ("bumpy", 10.0)]
TRACED_SIZE, TRACED_RUNS, TRACED_SAMPLES = 16, 12, 16
MESHES = {"sphere": lambda: icosphere(4), "bumpy": lambda: bumpy_sphere(4)} | {
    row[0]: partial(icosphere, level) for level, row in enumerate(COARSE)
}


@dataclass(frozen=True)
class Run:
    """Double plus multiple scattering, (height, width, 3); CPU seconds by stage."""

    radiance: NDArray[np.float64]
    cover: NDArray[np.float64]
    cpu: dict[str, float]
    orders: tuple[float, float]  # means of double and multiple scattering


def scene_of(mesh: Mesh, optical_radius: float, albedo: float, g: float = 0.0) -> BuildScene:
    """A body of radius 1, lit from the upper right."""
    medium = Medium(1.5, optical_radius * albedo, optical_radius * (1 - albedo), g)

    def build(scene: handles.Scene) -> None:
        add_body(scene, mesh, medium)
        add_point(scene, (4, 2, 3), 100.0)
        set_perspective(scene, (0, 0, 5), (0, 0, -1), (0, 1, 0), np.radians(30))

    return build


def render(build: BuildScene, size: int, **params: int) -> Run:
    settings = {
        "effects": LATER,
        "light_bounces": 0,
        "camera_bounces": 0,
        "adjoint_normals": 0,
        "film_transparent": 1,
        "width": size,
        "height": size,
        "samples": SAMPLES,
    } | params
    with handles.Scene(library.load()) as scene:
        build(scene)
        scene.commit()
        with scene.start(**settings) as job:
            job.wait()
            names = ("Double Scattering", "Multiple Scattering")
            passes = [job.read_pass(name)[::-1].astype(np.float64) for name in names]
            cover = job.read_pass("Combined")[::-1, :, 3].astype(np.float64)
            cpu = {stage["name"]: stage["cpu_s"] for stage in job.report()["stages"]}
    return Run(passes[0] + passes[1], cover, cpu, (passes[0].mean(), passes[1].mean()))


def noise(a: Run, b: Run) -> float:
    """rel_rmse of one of two runs that differ by their seed alone."""
    mask = a.cover > 0
    difference = (a.radiance - b.radiance)[mask]
    mean = (a.radiance + b.radiance)[mask].mean() / 2
    return float(np.sqrt((difference**2).mean() / 2) / mean)


def camera_rays(threads: int) -> float:
    """CPU seconds of the camera rays alone: the unit of cost."""
    build = scene_of(icosphere(5), 20, 0.99)
    runs = [render(build, SIZE, effects=0, threads=threads) for _ in range(5)]
    return float(np.median([run.cpu["camera"] for run in runs]))


def compare(optical_radius: float, albedo: float, unit: float, threads: int) -> None:
    build = scene_of(icosphere(5), optical_radius, albedo)
    samples = 16 if optical_radius < 50 else 4
    pixels = (SIZE / TABLE_SIZE) ** 2
    walks = [
        render(build, TABLE_SIZE, scatter_estimator=WALK, samples=samples, seed=s, threads=threads)
        for s in (0, 1)
    ]
    walk_error = noise(*walks)
    walk_cost = pixels * walks[0].cpu["camera"] * (walk_error / TARGET) ** 2
    photons = 2**15 if optical_radius < 50 else 2**13
    runs = [
        render(
            build,
            TABLE_SIZE,
            scatter_estimator=PHOTONS,
            light_samples=4 * photons,
            seed=s,
            threads=threads,
        )
        for s in (0, 1)
    ]
    error = noise(*runs)
    # What the cells themselves take, whatever the number of photons.
    none = render(build, TABLE_SIZE, scatter_estimator=PHOTONS, light_samples=4, threads=threads)
    traced = max(runs[0].cpu["field"] - none.cpu["field"], 0.0)
    cost = none.cpu["field"] + traced * (error / TARGET) ** 3 + pixels * runs[0].cpu["camera"]
    print(
        f"{optical_radius:>8g}{albedo:>9g}{100 * walk_error:>8.1f}%{walk_cost / unit:>10.0f}"
        f"{100 * error:>8.1f}%{cost / unit:>10.0f}{walk_cost / cost:>9.1f}",
        flush=True,
    )


def compare_means(
    row: tuple[str, float, float, float, int, int], threads: int, **common: int
) -> None:
    shape, optical_radius, albedo, g, pairs, photons = row
    build = scene_of(MESHES[shape](), optical_radius, albedo, g)

    def means(count: int, **params: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        runs = np.array(
            [
                render(build, MEANS_SIZE, seed=seed, threads=threads, **(common | params)).orders
                for seed in range(count)
            ]
        )
        return runs.mean(axis=0), runs.std(axis=0, ddof=1) / np.sqrt(count)

    walk, walk_error = means(2 * pairs, scatter_estimator=WALK, samples=MEANS_WALKS)
    ours, our_error = means(MEANS_PHOTON_RUNS, scatter_estimator=PHOTONS, light_samples=4 * photons)
    cells = [
        f"{ours[k] / walk[k] - 1:+.1%} ({np.hypot(walk_error[k], our_error[k]) / walk[k]:.1%})"
        for k in (0, 1)
    ]
    print(
        f"| {shape} {optical_radius:g} | {albedo:g} | {g:g} | {photons} | {cells[0]} "
        f"| {walk[0] / walk.sum():.2f} | {cells[1]} |",
        flush=True,
    )


def compare_tracer(shape: str, optical_radius: float, threads: int) -> None:
    """Orders 2, and 3 and up, in brackets the standard error of both."""
    scene = reference_scene(shape, optical_radius)
    mean, error = whole(stored_orders(shape, optical_radius))
    known = np.array([mean[2], mean[3] + mean[4]])
    known_error = np.array([error[2], np.hypot(error[3], error[4])])
    runs = np.array(
        [
            passes(
                scene,
                TRACED_SIZE,
                seed=seed,
                samples=TRACED_SAMPLES,
                light_samples=2**19,
                kernel_size=1.0,
                scatter_estimator=PHOTONS,
                threads=threads,
            ).mean(axis=(0, 1))[1:]
            for seed in range(TRACED_RUNS)
        ]
    )
    ours, spread = runs.mean(axis=0), runs.std(axis=0, ddof=1) / np.sqrt(TRACED_RUNS)
    cells = [
        f"{ours[k] / known[k] - 1:+.2%} ({np.hypot(spread[k], known_error[k]) / known[k]:.2%})"
        for k in (0, 1)
    ]
    print(f"| {shape} {optical_radius:g} | {scene.g:g} | {cells[0]} | {cells[1]} |", flush=True)


def jade(name: str, mesh: Mesh, unit: float, threads: int) -> None:
    build = scene_of(mesh, 20, 0.99)
    cache = ROOT / f"build/bench/thick_{name}_{SIZE}.npy"
    if not cache.is_file():
        print("rendering the reference ...", file=sys.stderr)
        truth = render(
            build,
            SIZE,
            scatter_estimator=PHOTONS,
            light_samples=4 * REFERENCE_RUNS * JADE_PHOTONS,
            samples=4 * SAMPLES,
            seed=99,
            threads=threads,
        )
        cache.parent.mkdir(parents=True, exist_ok=True)
        np.save(cache, truth.radiance)
    reference = np.load(cache)
    run = render(
        build,
        SIZE,
        scatter_estimator=PHOTONS,
        light_samples=4 * JADE_PHOTONS,
        threads=threads,
    )
    mask = run.cover == 1
    difference = (run.radiance - reference)[mask]
    error = np.sqrt((difference**2).mean()) / reference[mask].mean()
    ratio = run.radiance[mask].mean() / reference[mask].mean()
    cost = run.cpu["field"] + run.cpu["camera"]
    print(
        f"jade, {name}: rel_rmse {100 * error:.2f} % (bar {100 * TARGET:.0f} %), mean {ratio:.4f}, "
        f"cost / camera rays {cost / unit:.0f} (bar {BAR}): photons {run.cpu['field'] / unit:.0f}, "
        f"camera {run.cpu['camera'] / unit:.0f}",
        flush=True,
    )


def compare_candle(threads: int, seeds: int = 4) -> None:
    """Regions of a candle whose normals are far from those of its faces."""

    def regions(estimator: int, **budget: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        runs = [
            candle_regions(estimator, seed=seed, threads=threads, **budget)
            for seed in range(1, seeds + 1)
        ]
        return np.mean(runs, axis=0), np.std(runs, axis=0, ddof=1) / np.sqrt(seeds)

    walks, walk_error = regions(WALK, samples=512)
    photons, photon_error = regions(PHOTONS, samples=64, light_samples=2**20)
    print("\n| candle | photons to walks, all orders |\n|---|---|")
    for k, name in enumerate(("top", "side", "foot")):
        error = np.hypot(walk_error[k] / walks[k], photon_error[k] / photons[k])
        print(f"| {name} | {photons[k] / walks[k] - 1:+.1%} ({error:.1%}) |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jade", action="store_true", help="jade alone, without the table")
    parser.add_argument("--means", action="store_true", help="bias against walks alone")
    parser.add_argument("--normals", action="store_true", help="smooth normals on coarse meshes")
    parser.add_argument("--tracer", action="store_true", help="bias against the tracer alone")
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    if arguments.means or arguments.normals:
        print("| body, optical radius | albedo | g | photons | order 2 | its share | order 3+ |")
        print("|---|---|---|---|---|---|---|")
        smooth = {"adjoint_normals": 1, "light_bounces": 16, "camera_bounces": 16}
        for row in MEANS if arguments.means else COARSE:
            compare_means(row, arguments.threads, **({} if arguments.means else smooth))
        if arguments.normals:
            compare_candle(arguments.threads)
        return
    if arguments.tracer:
        print("| body, optical radius | g | order 2 | order 3+ |")
        print("|---|---|---|---|")
        for shape, optical_radius in TRACED:
            compare_tracer(shape, optical_radius, arguments.threads)
        return
    unit = camera_rays(arguments.threads)
    print(f"camera rays alone, {SIZE} x {SIZE} x {SAMPLES}: {unit:.3f} CPU s", flush=True)
    if not arguments.jade:
        print(
            f"{'radius':>8}{'albedo':>9}{'walk':>9}{'to 3 %':>10}{'photons':>9}{'to 3 %':>10}"
            f"{'gain':>9}"
        )
        for optical_radius in (0.1, 0.5, 1, 2, 5, 20, 100):
            for albedo in (0.5, 0.9, 0.99, 0.9999):
                compare(optical_radius, albedo, unit, arguments.threads)
    jade("sphere", icosphere(5), unit, arguments.threads)
    jade("bumpy", bumpy_sphere(5), unit, arguments.threads)


if __name__ == "__main__":
    main()
