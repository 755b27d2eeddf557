# SPDX-License-Identifier: GPL-3.0-or-later
"""What light tubes cost on the bumpy sphere, beside points played at their best. Prints markdown;
never asserts.

    python3 tests/bench/bench_tubes.py [growth] [views] [error] [--threads 2] [--log2-samples 24]
        [--first-log2 15] [--kernels 0.125 0.25 0.5 1 2 4]
    python3 tests/bench/bench_tubes.py scans --meshes DIR

Errors are along the same camera rays as the references', 256^2 pixels, 4 samples each; bumpy.py
has the references. Cost is in CPU seconds of all stages of the library's report, and in units of
what the camera rays alone take; every ratio is of two things measured in one run. POINTS_FIXED is
swept over its kernel and its number of samples, and what it costs to reach an error is read off
the best of these curves, between its points: the steps of the sweep do not speak against it.
Of SPECULAR the table says that it is not available where the library refuses it. Scans are the
Stanford bunny and buddha (DIR/bunny.obj, DIR/buddha.obj) in place of the bumpy sphere, with normals
smoothed over neighbouring faces, against tubes of refinement 1.
"""

from __future__ import annotations

import argparse
import statistics
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "images"))

import bumpy  # noqa: E402
import metrics  # noqa: E402
from api import LIBRARY, BuildScene, Image, errors  # noqa: E402
from meshes import Mesh, read_obj  # noqa: E402

LEVELS = (5, 6, 7, 8)  # 20k, 82k, 328k and 1.3M triangles
REPEATS = 3
KERNELS = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0)
HOPELESS = 1.5  # a kernel with that many times the error of the best is not tried with more samples
TARGETS = (0.04, 0.02)  # rel_rmse
VIEW_TARGET = 0.08  # floored_rel
RAYS_TARGET = 0.01  # rel_rmse
BARS = {0.04: (30, None), 0.02: (150, 200)}  # CPU time, bytes
FIRST_LOG2 = 15


@dataclass(frozen=True)
class Row:
    """One render: errors, bytes of the light's structure, CPU seconds."""

    estimator: str
    setting: str
    rel_rmse: float
    floored_rel: float
    mean: float  # over the reference's
    cpu: float
    bytes: int


@dataclass(frozen=True)
class Sweep:
    """Kernels and numbers of volume samples that points are tried with."""

    kernels: Sequence[float]
    first_log2: int
    last_log2: int


class View:
    """Renders one view and judges what it renders."""

    def __init__(self, view: bumpy.View, threads: int) -> None:
        self.name, self.threads = view.name, threads
        self.build: BuildScene = bumpy.bumpy(5, view)
        self.truth, cover = bumpy.reference(view, threads)
        self.mask = cover > 0
        traced = [bumpy.rays_alone(self.build, threads) for _ in range(REPEATS)]
        self.rays = statistics.median(bumpy.stage_cpu(image) for image in traced)

    def measure(
        self, estimator: str, setting: str, samples: int = 1, kernel: float = 1.0, level: int = 0
    ) -> Row:
        image = bumpy.measure(self.build, estimator, samples, kernel, self.threads, level)
        return Row(
            estimator,
            setting,
            metrics.rel_rmse(image.pixels, self.truth, self.mask),
            metrics.floored_rel(image.pixels, self.truth, self.mask),
            float(metrics.mean_ratio(image.pixels, self.truth, self.mask).mean()),
            bumpy.stage_cpu(image),
            image.report["memory"]["field_bytes"],
        )

    def tubes(self, refinements: int) -> list[Row]:
        return [self.measure("TUBES", f"refinement {r}", level=r) for r in range(-2, refinements)]

    def points(
        self, estimator: str, error: str, target: float, sweep: Sweep
    ) -> dict[float, list[Row]]:
        """For each kernel, budgets up to the first with which some kernel reaches the target:
        more samples cost more with any kernel."""
        curves: dict[float, list[Row]] = {kernel: [] for kernel in sweep.kernels}
        hopeful = set(sweep.kernels)
        for log2 in range(sweep.first_log2, sweep.last_log2 + 1):
            for kernel in sorted(hopeful):
                setting = f"2^{log2}, C_k {kernel:g}"
                curves[kernel].append(self.measure(estimator, setting, 2**log2, kernel))
            found = {kernel: getattr(curves[kernel][-1], error) for kernel in hopeful}
            best = min(found.values())
            if best <= target:
                break
            hopeful = {kernel for kernel in hopeful if found[kernel] <= HOPELESS * best}
        return curves

    def specular(self) -> Row | None:
        try:
            return self.measure("SPECULAR", "")
        except errors.AmbUnsupported:
            return None


# ---- Tables --------------------------------------------------------------------------------------


def print_rows(rows: Sequence[Row], rays: float) -> None:
    print("| estimator | setting | `rel_rmse` | `floored_rel` | mean | CPU s | / rays | MB |")
    print("|---|---|---|---|---|---|---|---|")
    for row in rows:
        print(
            f"| {row.estimator} | {row.setting} | {100 * row.rel_rmse:.2f} % "
            f"| {100 * row.floored_rel:.2f} % | {row.mean:.4f} | {row.cpu:.2f} "
            f"| {row.cpu / rays:.1f} | {row.bytes / 1e6:.1f} |",
            flush=True,
        )


def cheapest(rows: Sequence[Row], error: str, target: float) -> Row | None:
    good = [row for row in rows if getattr(row, error) <= target]
    return min(good, key=lambda row: row.cpu) if good else None


def at_error(rows: Sequence[Row], error: str, target: float) -> tuple[float, float] | None:
    """CPU seconds and bytes at which one curve, by growing cost, crosses the target: a power law
    between its last row above and its first row below."""
    for before, after in pairwise(rows):
        high, low = getattr(before, error), getattr(after, error)
        if high > target >= low:
            part = np.log(high / target) / np.log(high / low)
            cpu = before.cpu * (after.cpu / before.cpu) ** part
            size = before.bytes * (after.bytes / before.bytes) ** part
            return float(cpu), float(size)
    if rows and getattr(rows[0], error) <= target:
        return rows[0].cpu, float(rows[0].bytes)
    return None


def best_at(
    curves: dict[float, list[Row]], error: str, target: float
) -> tuple[float, float, float] | None:
    """CPU seconds and bytes of the best kernel at the target, and that kernel."""
    found = [(*at, kernel) for kernel, rows in curves.items()
             if (at := at_error(rows, error, target)) is not None]  # fmt: skip
    return min(found) if found else None


def print_ratio(
    name: str, curves: dict[float, list[Row]], tubes: Sequence[Row], error: str, target: float
) -> tuple[float, float] | None:
    best, mine = best_at(curves, error, target), cheapest(tubes, error, target)
    label = f"{100 * target:g} % `{error}`: "
    if mine is None:
        print(f"- {label}TUBES do not reach it")
        return None
    if best is None:
        last = max((row for rows in curves.values() for row in rows), key=lambda row: row.cpu)
        print(
            f"- {label}{name} does not reach it within {last.setting.split(',')[0]} samples: more "
            f"than {last.cpu / mine.cpu:.3g} times the CPU time of TUBES, {mine.setting}"
        )
        return None
    cpu, size, kernel = best
    print(
        f"- {label}{name}, C_k {kernel:g}: {cpu:.2f} CPU s, {size / 1e6:.1f} MB; TUBES, "
        f"{mine.setting}: {mine.cpu:.3f} CPU s, {mine.bytes / 1e6:.2f} MB: "
        f"**{cpu / mine.cpu:.3g} times the CPU time, {size / mine.bytes:.3g} times the bytes**"
    )
    return cpu / mine.cpu, size / mine.bytes


# ---- Growth with triangles -----------------------------------------------------------------------


def growth(threads: int) -> None:
    print(f"\n## Growth of TUBES with triangles, {threads} thread(s), medians of {REPEATS}\n")
    builds = {level: bumpy.bumpy(level) for level in LEVELS}
    cpu: dict[int, list[float]] = {level: [] for level in LEVELS}
    rays: dict[int, list[float]] = {level: [] for level in LEVELS}
    images: dict[int, Image] = {}
    for _ in range(REPEATS):
        for level, build in builds.items():
            rays[level].append(bumpy.stage_cpu(bumpy.rays_alone(build, threads)))
            images[level] = bumpy.measure(build, "TUBES", 1, 1.0, threads)
            cpu[level].append(bumpy.stage_cpu(images[level]))
    print("| triangles | tubes | MB | rays alone, CPU s | TUBES, CPU s | exponent to the next |")
    print("|---|---|---|---|---|---|")
    middle = {level: statistics.median(values) for level, values in cpu.items()}
    for level in LEVELS:
        following = middle.get(level + 1)
        exponent = (
            "" if following is None else f"{np.log(following / middle[level]) / np.log(4):.2f}"
        )
        report = images[level].report
        print(
            f"| {20 * 4**level} | {report['light']['tubes']} "
            f"| {report['memory']['field_bytes'] / 1e6:.1f} "
            f"| {statistics.median(rays[level]):.3f} | {middle[level]:.3f} | {exponent} |"
        )
    steps = LEVELS[-1] - LEVELS[0]
    whole = np.log(middle[LEVELS[-1]] / middle[LEVELS[0]]) / (steps * np.log(4))
    print(f"\nOver the whole range: N^{whole:.2f} (bar: below N^0.8, aim N^0.5).")


# ---- Scanned meshes ------------------------------------------------------------------------------


def smoothed(mesh: Mesh) -> Mesh:
    """As large as the bumpy sphere, in its place, with normals weighted by the faces' areas."""
    low, high = mesh.positions.min(axis=0), mesh.positions.max(axis=0)
    points = mesh.positions - (low + high) / 2
    points /= np.linalg.norm(points, axis=1).max()
    a, b, c = points[mesh.triangles].transpose(1, 0, 2)
    faces = np.cross(b - a, c - a)
    normals = np.zeros_like(points)
    for corner in mesh.triangles.T:
        np.add.at(normals, corner, faces)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return Mesh(points, mesh.triangles, normals / np.maximum(length, 1e-30))


def scans(threads: int, folder: Path) -> None:
    print("\n## Scanned meshes, side-lit, against refinement 1\n")
    print("| mesh | refinement | tubes | MB | `rel_rmse` | `floored_rel` | mean | / rays |")
    print("|---|---|---|---|---|---|---|---|")
    for name in ("bunny", "buddha"):
        mesh = smoothed(read_obj(folder / f"{name}.obj"))
        build = bumpy.lit_alike(mesh)
        fine = bumpy.measure(build, "TUBES", 1, 1.0, threads, 1)
        rays = [bumpy.stage_cpu(bumpy.rays_alone(build, threads)) for _ in range(REPEATS)]
        mask = fine.cover > 0
        for level in (0, -1, -2):
            image = bumpy.measure(build, "TUBES", 1, 1.0, threads, level)
            mean = float(metrics.mean_ratio(image.pixels, fine.pixels, mask).mean())
            print(
                f"| {name} | {level} | {image.report['light']['tubes']} "
                f"| {image.report['memory']['field_bytes'] / 1e6:.1f} "
                f"| {100 * metrics.rel_rmse(image.pixels, fine.pixels, mask):.2f} % "
                f"| {100 * metrics.floored_rel(image.pixels, fine.pixels, mask):.2f} % "
                f"| {mean:.4f} | {bumpy.stage_cpu(image) / statistics.median(rays):.1f} |",
                flush=True,
            )


# ---- Views along the light -----------------------------------------------------------------------


def views(threads: int, sweep: Sweep) -> None:
    for place in (bumpy.FRONT_LIT, bumpy.BACK_LIT):
        view = View(place, threads)
        angle = np.degrees(bumpy.ASIDE)
        print(f"\n## {view.name}, {angle:g} degrees off the light, {threads} thread(s)\n")
        tubes = view.tubes(2)
        fixed = view.points("POINTS_FIXED", "floored_rel", VIEW_TARGET, sweep)
        covariance = view.points("POINTS_COVARIANCE", "floored_rel", VIEW_TARGET, sweep)
        both = [row for curves in (fixed, covariance) for rows in curves.values() for row in rows]
        print_rows([*tubes, *both], view.rays)
        print(f"\nThe camera rays alone: {view.rays:.3f} CPU s (bar of TUBES over fixed: 10).\n")
        print_ratio("POINTS_FIXED", fixed, tubes, "floored_rel", VIEW_TARGET)
        print_ratio("POINTS_COVARIANCE", covariance, tubes, "floored_rel", VIEW_TARGET)


# ---- Equal error ---------------------------------------------------------------------------------


def equal_error(threads: int, sweep: Sweep) -> None:
    view = View(bumpy.SIDE_LIT, threads)
    print(f"\n## Side-lit, {threads} thread(s)\n")
    tubes = view.tubes(3)
    fixed = view.points("POINTS_FIXED", "rel_rmse", min(TARGETS), sweep)
    covariance = view.points("POINTS_COVARIANCE", "rel_rmse", min(TARGETS), sweep)
    specular = view.specular()
    both = [row for curves in (fixed, covariance) for rows in curves.values() for row in rows]
    print_rows([*tubes, *([specular] if specular else []), *both], view.rays)
    print(f"\nThe camera rays alone: {view.rays:.3f} CPU s.\n")
    for target in TARGETS:
        time_bar, bytes_bar = BARS[target]
        print_ratio("POINTS_FIXED", fixed, tubes, "rel_rmse", target)
        print(f"  (bar: {time_bar} times the time" + (f", {bytes_bar} times the bytes)" if bytes_bar
              else ")"))  # fmt: skip
        print_ratio("POINTS_COVARIANCE", covariance, tubes, "rel_rmse", target)
        compare_points(fixed, covariance, target)
    print_against_rays(tubes, view.rays)
    print_against_specular(tubes, specular)


def compare_points(
    fixed: dict[float, list[Row]], covariance: dict[float, list[Row]], target: float
) -> None:
    """The paper's claim: twice as fast and a fifth of the memory at equal error."""
    ours, theirs = (best_at(curves, "rel_rmse", target) for curves in (covariance, fixed))
    if ours is not None and theirs is not None:
        print(
            f"- {100 * target:g} %: POINTS_FIXED (C_k {theirs[2]:g}) over POINTS_COVARIANCE "
            f"(C_k {ours[2]:g}): {theirs[0] / ours[0]:.2f} times the CPU time, "
            f"{theirs[1] / ours[1]:.2f} times the bytes (in print: 2 and 5)"
        )


def print_against_rays(tubes: Sequence[Row], rays: float) -> None:
    mine = cheapest(tubes, "rel_rmse", RAYS_TARGET)
    between = at_error(tubes, "rel_rmse", RAYS_TARGET)
    if mine is None or between is None:
        print(f"- {100 * RAYS_TARGET:g} % `rel_rmse`: TUBES do not reach it")
        return
    print(
        f"- {100 * RAYS_TARGET:g} % `rel_rmse`: TUBES, {mine.setting} ({100 * mine.rel_rmse:.2f} "
        f"%), {mine.cpu / rays:.1f} times the camera rays alone; between refinements "
        f"{between[0] / rays:.1f} times (bar: 4)"
    )


def print_against_specular(tubes: Sequence[Row], specular: Row | None) -> None:
    if specular is None:
        print("- SPECULAR: not available in this library")
        return
    mine = cheapest(tubes, "rel_rmse", specular.rel_rmse)
    if mine is None:
        mine = min(tubes, key=lambda row: row.rel_rmse)
    print(
        f"- SPECULAR, {100 * specular.rel_rmse:.2f} %: {specular.cpu / mine.cpu:.0f} times the CPU "
        f"time of TUBES, {mine.setting}, {100 * mine.rel_rmse:.2f} % (bar: 20)"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parts = ("growth", "views", "error", "scans")
    parser.add_argument("parts", nargs="*", choices=[*parts, []], help="default: all but scans")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument(
        "--log2-samples", type=int, default=24, help="most volume samples of points (24: 1 GB)"
    )
    parser.add_argument("--first-log2", type=int, default=FIRST_LOG2, help="and fewest")
    parser.add_argument(
        "--kernels", type=float, nargs="+", default=KERNELS, help="C_k that points are tried with"
    )
    parser.add_argument("--meshes", type=Path, help="folder of bunny.obj and buddha.obj, for scans")
    arguments = parser.parse_args()
    if not LIBRARY.is_file():
        sys.exit(f"{LIBRARY} is not built: ./amberlight build")
    chosen = arguments.parts or parts[:3]
    if "scans" in chosen and arguments.meshes is None:
        parser.error("scans need --meshes")
    sweep = Sweep(arguments.kernels, arguments.first_log2, arguments.log2_samples)
    if "growth" in chosen:
        growth(arguments.threads)
    if "error" in chosen:
        equal_error(arguments.threads, sweep)
    if "views" in chosen:
        views(arguments.threads, sweep)
    if "scans" in chosen:
        scans(arguments.threads, arguments.meshes)


if __name__ == "__main__":
    main()
