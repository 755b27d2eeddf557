# SPDX-License-Identifier: GPL-3.0-or-later
"""Error against cost of the point estimators on the bumpy case. Prints; never asserts.

    python3 tests/bench/bench_points.py [--quick] [--threads N]

Errors are along the same camera rays as the reference's, so that they show the estimator and not
the sampling of pixels; bumpy.py has the reference. Cost is in CPU seconds of the library's stages
and, because machines differ and are shared, in units of what tracing the camera rays alone takes
in the same run.
"""

from __future__ import annotations

import argparse
import statistics
import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "images"))

import metrics  # noqa: E402
from api import LIBRARY, POINTS, BuildScene  # noqa: E402
from bumpy import (  # noqa: E402
    SAMPLES,
    SIDE_LIT,
    SIZE,
    bumpy,
    measure,
    rays_alone,
    reference,
    stage_cpu,
)

TARGET = 0.04  # rel_rmse
BAR_COST = 130  # times the camera rays, to reach TARGET
BAR_SPEEDUP = 1.8  # two threads over one


# ---- Measurements -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Row:
    """One setting: errors, CPU seconds and bytes. Of tubes, light_samples is their number and
    kernel_size their refinement."""

    estimator: str
    light_samples: int
    kernel_size: float
    rel_rmse: float
    floored_rel: float
    light: float
    field: float
    camera: float
    total: float
    bytes: int


HEADER = (
    f"{'estimator':<18}{'samples':>9}{'C_k':>5}{'rel_rmse':>10}{'floored':>9}"
    f"{'light':>8}{'field':>8}{'camera':>9}{'total':>9}{'/rays':>7}{'MB':>7}"
)


def print_row(row: Row, rays: float) -> None:
    print(
        f"{row.estimator:<18}{row.light_samples:>9}{row.kernel_size:>5g}"
        f"{100 * row.rel_rmse:>9.2f}%{100 * row.floored_rel:>8.2f}%"
        f"{row.light:>8.3f}{row.field:>8.3f}{row.camera:>9.3f}{row.total:>9.3f}"
        f"{row.total / rays:>7.0f}{row.bytes / 1e6:>7.1f}",
        flush=True,
    )


def sweep(build: BuildScene, quick: bool, threads: int) -> None:
    truth, cover = reference(SIDE_LIT, threads)
    mask = cover > 0
    budgets = [2**k for k in ((14, 16, 18) if quick else (13, 15, 17, 19, 20, 21))]
    kernels = [4.0] if quick else [1.0, 2.0, 4.0, 8.0]
    rows: list[Row] = []
    rays_cpu: list[float] = []
    print(
        f"bumpy, {SIZE}^2, {SAMPLES} samples a pixel, {threads} thread(s); CPU seconds\n\n{HEADER}"
    )
    runs = [(e, n, k, 0) for e in POINTS for n in budgets for k in kernels]
    runs += [("TUBES", 1, 1.0, r) for r in range(3)]
    for estimator, light_samples, kernel, refinement in runs:
        # Alternating: whatever else runs on the machine slows both.
        rays_cpu.append(stage_cpu(rays_alone(build, threads), ["camera"]))
        image = measure(build, estimator, light_samples, kernel, threads, refinement)
        is_tubes = estimator == "TUBES"
        rows.append(
            Row(
                estimator,
                image.report["light"]["tubes"] if is_tubes else light_samples,
                refinement if is_tubes else kernel,
                metrics.rel_rmse(image.pixels, truth, mask),
                metrics.floored_rel(image.pixels, truth, mask),
                stage_cpu(image, ["light"]),
                stage_cpu(image, ["field"]),
                stage_cpu(image, ["camera"]),
                stage_cpu(image),
                image.report["memory"]["field_bytes"],
            )
        )
        print_row(rows[-1], statistics.median(rays_cpu))
    rays = statistics.median(rays_cpu)
    print(f"\ncamera rays alone: {rays:.3f} CPU-s, median of {len(rays_cpu)}")
    print(f"cheapest setting that reaches {100 * TARGET:.0f} % rel_rmse (bar: {BAR_COST} x rays):")
    print(HEADER)
    for estimator in [*POINTS, "TUBES"]:
        good = [r for r in rows if r.estimator == estimator and r.rel_rmse <= TARGET]
        if good:
            print_row(min(good, key=lambda r: r.total), rays)
        else:
            print(f"{estimator:<18} none in this sweep")


def speed_up(build: BuildScene, repeats: int = 3) -> None:
    """Wall seconds with one and two threads, alternating.

    CPU over wall seconds of the two threads says whether the machine had two cores to give: far
    below 2, the ratio says nothing about the library.
    """
    print(f"\nthreads (bar: {BAR_SPEEDUP} x with two), medians of {repeats}")
    print(f"{'estimator':<18}{'1: wall s':>10}{'2: wall s':>10}{'ratio':>8}{'cores got':>11}")
    for estimator in [*POINTS, "TUBES"]:
        wall: dict[int, list[float]] = {1: [], 2: []}
        cores: list[float] = []
        for _ in range(repeats):
            for threads, times in wall.items():
                image = measure(build, estimator, 2**17, 8.0, threads)
                times.append(sum(stage["wall_s"] for stage in image.report["stages"]))
            cores.append(stage_cpu(image) / wall[2][-1])
        one, two = (statistics.median(times) for times in wall.values())
        got = statistics.median(cores)
        print(f"{estimator:<18}{one:>10.3f}{two:>10.3f}{one / two:>8.2f}{got:>11.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one kernel size, three budgets")
    parser.add_argument("--threads", type=int, default=1, help="of the sweep (default 1)")
    parser.add_argument("--no-sweep", action="store_true", help="the speed-up alone")
    arguments = parser.parse_args()
    if not LIBRARY.is_file():
        sys.exit(f"{LIBRARY} is not built: cmake --workflow --preset release")
    build = bumpy()
    if not arguments.no_sweep:
        sweep(build, arguments.quick, arguments.threads)
    speed_up(build)


if __name__ == "__main__":
    main()
