# SPDX-License-Identifier: GPL-3.0-or-later
"""Error against cost of the point estimators on the bumpy case. Prints; never asserts.

    python3 tests/bench/bench_points.py [--quick] [--threads N]

Errors are along the same camera rays as the reference's, so that they show the estimator and not
the sampling of pixels. The reference is ref_bumpy.py at sixteen tubes a triangle (its own error
is about 0.1 %), minutes of work kept under build/bench. Cost is in CPU seconds of the library's
stages and, because machines differ and are shared, in units of what tracing the camera rays alone
takes in the same run.
"""

from __future__ import annotations

import argparse
import statistics
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "images"))

import metrics  # noqa: E402
from api import (  # noqa: E402
    ESTIMATORS,
    LIBRARY,
    POINTS,
    ROOT,
    BuildScene,
    Image,
    Medium,
    add_body,
    add_point,
    handles,
    render,
    set_perspective,
)
from meshes import bumpy_sphere  # noqa: E402
from ref_bumpy import LightTubes, Surface, bumpy_scene, trace  # noqa: E402

SIZE, SAMPLES, SEED, REFINEMENT = 256, 4, 0, 2
EYE, FOV = 5.0, np.radians(30.0)
TARGET = 0.04  # rel_rmse
BAR_COST = 130  # times the camera rays, to reach TARGET
BAR_SPEEDUP = 1.8  # two threads over one
CAMERA_STAGE = 2  # RNG_STAGE_CAMERA


# ---- Camera rays --------------------------------------------------------------------------------


def _mix(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """rng_mix of base/rng.h."""
    x = x ^ (x >> np.uint64(30))
    x = x * np.uint64(0xBF58476D1CE4E5B9)
    x = x ^ (x >> np.uint64(27))
    x = x * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


def _unit(bits: NDArray[np.uint64]) -> NDArray[np.float32]:
    return (bits >> np.uint64(40)).astype(np.float32) * np.float32(2.0**-24)


def camera_rays() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The library's own rays, (SIZE^2 SAMPLES, 3), and their pixels counted from the top left.

    A copy of camera_sample's jitter; main() warns when coverage shows that it went stale.
    """
    golden = np.uint64(0x9E3779B97F4A7C15)
    pixel = np.arange(SIZE * SIZE, dtype=np.uint64)
    with np.errstate(over="ignore"):
        stream = _mix(np.array([SEED << 32 | CAMERA_STAGE], dtype=np.uint64) + golden)
        key = _mix(stream ^ _mix(pixel + golden))
        shift = [_unit(_mix(key + np.uint64(k + 1) * golden)) for k in range(2)]
        index = np.arange(SAMPLES, dtype=np.uint64)
        steps = (0xC13FA9A902A6328F, 0x91E10DA5C79E7B1D)
        point = [_unit(index * np.uint64(step)) for step in steps]
    u, v = (p[None, :] + s[:, None] for p, s in zip(point, shift, strict=True))
    x = ((pixel % SIZE)[:, None] + u % 1) / SIZE * 2 - 1
    y = ((pixel // SIZE)[:, None] + v % 1) / SIZE * 2 - 1
    half = np.tan(FOV / 2)
    d = np.stack([x * half, y * half, -np.ones_like(x)], axis=-1).reshape(-1, 3)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    row, column = np.divmod(pixel.astype(np.int64), SIZE)
    return d, np.repeat((SIZE - 1 - row) * SIZE + column, SAMPLES)


def reference() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Image (SIZE, SIZE, 3) and coverage along the library's camera rays."""
    cache = ROOT / f"build/bench/bumpy_{SIZE}_{SAMPLES}_{SEED}_{REFINEMENT}.npy"
    if not cache.is_file():
        print("rendering the reference, some minutes ...", file=sys.stderr)
        scene = bumpy_scene(bumpy_sphere(5))
        direction, pixel = camera_rays()
        origin = np.tile([0.0, 0.0, EYE], (len(direction), 1))
        value, seen = trace(LightTubes(scene, Surface(scene.mesh), REFINEMENT), origin, direction)
        columns = np.column_stack([value, seen])
        sums = [np.bincount(pixel, column, minlength=SIZE * SIZE) for column in columns.T]
        cache.parent.mkdir(parents=True, exist_ok=True)
        np.save(cache, np.stack(sums, axis=1).reshape(SIZE, SIZE, 4) / SAMPLES)
    stored = np.load(cache)
    return stored[..., :3], stored[..., 3]


# ---- Measurements -------------------------------------------------------------------------------


def bumpy() -> BuildScene:
    scene = bumpy_scene(bumpy_sphere(5))
    medium = Medium(scene.n, scene.sigma_s, scene.sigma_t - scene.sigma_s, scene.g)

    def build(handle: handles.Scene) -> None:
        add_body(handle, scene.mesh, medium)
        add_point(handle, scene.light, scene.intensity)
        set_perspective(handle, (0, 0, EYE), (0, 0, -1), (0, 1, 0), FOV)

    return build


def stage_cpu(image: Image, names: Iterable[str] | None = None) -> float:
    """CPU seconds of the named stages, or of all."""
    stages = image.report["stages"]
    return sum(s["cpu_s"] for s in stages if names is None or s["name"] in names)


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


def measure(
    build: BuildScene,
    estimator: str,
    light_samples: int,
    kernel: float,
    threads: int,
    refinement: int = 0,
) -> Image:
    return render(
        build,
        SIZE,
        estimator=ESTIMATORS[estimator],
        light_samples=light_samples,
        kernel_size=kernel,
        tube_refinement=refinement,
        samples=SAMPLES,
        seed=SEED,
        threads=threads,
    )


def rays_alone(build: BuildScene, threads: int) -> Image:
    """The same camera rays to the boundary, refracted and on to the far side, without a gather."""
    return render(build, SIZE, effects=0, samples=SAMPLES, seed=SEED, threads=threads)


def sweep(build: BuildScene, quick: bool, threads: int) -> None:
    truth, cover = reference()
    mask = cover > 0
    traced = rays_alone(build, threads)
    if (
        np.abs(traced.cover - cover).max() > 0.5 / SAMPLES + 1e-6
        or np.mean(np.abs(traced.cover - cover) > 1e-6) > 1e-3
    ):
        print("warning: camera_rays() no longer copies the library's rays; errors below include")
        print("         the sampling of pixels")
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
    for estimator in ESTIMATORS:
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
    for estimator in ESTIMATORS:
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
