# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether renders under a target error state it honestly, and what the target saves. Prints; never
asserts.

    python3 tests/bench/bench_honesty.py [--size N] [--seeds N] [--quick | --caustics [SCENE ...]]

True errors are against references of the same scenes: tubes of refinement 2, the same many samples
for every pixel, kept under build/bench. The second table is the same error by a fixed number of
samples for every pixel, found by doubling it.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "images"))

import honesty  # noqa: E402
import metrics  # noqa: E402
from api import ESTIMATORS, LIBRARY, ROOT, TUBES, BuildScene, Image, render  # noqa: E402

TARGETS = {
    "TUBES": (0.05, 0.02, 0.01, 0.005),
    "POINTS_COVARIANCE": (0.05, 0.03, 0.02),
    "POINTS_FIXED": (0.08, 0.05),
}
# Of the scenes with caustics, estimators AUTO.
CAUSTIC_TARGETS = (0.12, 0.08, 0.05)
REFERENCE_SAMPLES = 2048


def reference(name: str, build: BuildScene, size: int, /, **settings: Any) -> NDArray[np.float64]:
    file = ROOT / "build/bench" / f"honesty_{name.replace(', ', '_').replace(' ', '_')}_{size}.npy"
    if not file.is_file():
        file.parent.mkdir(parents=True, exist_ok=True)
        np.save(file, honesty.reference(build, size, **({"samples": REFERENCE_SAMPLES} | settings)))
    return np.asarray(np.load(file))


def honest(size: int, seeds: int, quick: bool) -> None:
    print("| scene | estimator | target | runs | stated | true | ratio: mean, min, max | samples |")
    print("|---|---|---|---|---|---|---|---|")
    runs: list[honesty.Run] = []
    for name, build in honesty.scenes().items():
        truth = reference(name, build, size)
        for estimator, targets in TARGETS.items():
            for target in targets[:2] if quick else targets:
                pair = (estimator, ESTIMATORS[estimator])
                some = [
                    honesty.run(build, truth, name, pair, target, seed)
                    for seed in range(1, seeds + 1)
                ]
                runs += some
                ratios = [run.ratio for run in some]
                samples = np.mean([run.report["accuracy"]["samples_mean"] for run in some])
                print(
                    f"| {name} | {estimator} | {100 * target:g} % | {len(some)} | "
                    f"{100 * np.mean([run.stated for run in some]):.2f} % | "
                    f"{100 * np.mean([run.true for run in some]):.2f} % | "
                    f"{np.mean(ratios):.2f}, {min(ratios):.2f}, {max(ratios):.2f} | "
                    f"{samples:.1f} |",
                    flush=True,
                )
    below, above = honesty.share_within(runs)
    print(
        f"\n{len(runs)} runs: true <= 1.5 stated in {100 * below:.1f} %, "
        f"stated <= 1.5 true in {100 * above:.1f} %, "
        f"both in {100 * np.mean([1 / 1.5 <= run.ratio <= 1.5 for run in runs]):.1f} %"
    )


def caustics(size: int, seeds: int, names: list[str]) -> None:
    """Light through objects onto a floor: error over the pixels that the statement is about."""
    scenes = {k: v for k, v in honesty.caustic_scenes().items() if not names or k in names}
    budget = honesty.CAUSTICS | {"samples": 512, "light_samples": 2**24}
    print("\n| scene | target | runs | stated | true | ratio: mean, min, max | of it caustics |")
    print("|---|---|---|---|---|---|---|")
    runs: list[honesty.Run] = []
    for name, build in scenes.items():
        truth = reference(name, build, size, **budget)
        for target in CAUSTIC_TARGETS:
            some = [
                honesty.run(build, truth, name, ("TUBES", TUBES), target, seed, honesty.CAUSTICS)
                for seed in range(1, seeds + 1)
            ]
            runs += some
            ratios = [run.ratio for run in some]
            print(
                f"| {name} | {100 * target:g} % | {len(some)} | "
                f"{100 * np.mean([run.stated for run in some]):.2f} % | "
                f"{100 * np.mean([run.true for run in some]):.2f} % | "
                f"{np.mean(ratios):.2f}, {min(ratios):.2f}, {max(ratios):.2f} | "
                f"{100 * np.mean([run.report['accuracy']['caustics'] for run in some]):.2f} % |",
                flush=True,
            )
    below, above = honesty.share_within(runs)
    within = np.mean([run.true <= run.target for run in runs])
    print(
        f"\n{len(runs)} runs: true <= 1.5 stated in {100 * below:.1f} %, "
        f"stated <= 1.5 true in {100 * above:.1f} %, within the target in {100 * within:.1f} %"
    )


def cpu(image: Image) -> float:
    return float(sum(stage["cpu_s"] for stage in image.report["stages"]))


def saving(size: int, target: float) -> None:
    """CPU time to an error that is measured against the reference, not stated."""
    print("\n| scene | true error | CPU s | by a fixed number | its true error | CPU s |")
    print("|---|---|---|---|---|---|")
    for name, build in honesty.scenes().items():
        truth = reference(name, build, size)

        def error(image: Image, truth: NDArray[np.float64] = truth) -> float:
            return metrics.rel_rmse(image.pixels, truth, image.cover > 0)

        chosen = render(build, size, estimator=TUBES, accuracy=target, seed=1)
        samples = 4
        even = render(build, size, estimator=TUBES, samples=samples, seed=1)
        while error(even) > error(chosen) and samples < REFERENCE_SAMPLES // 2:
            samples *= 2
            even = render(build, size, estimator=TUBES, samples=samples, seed=1)
        print(
            f"| {name} | {100 * error(chosen):.2f} % | {cpu(chosen):.2f} | {samples} | "
            f"{100 * error(even):.2f} % | {cpu(even):.2f} |",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=96)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--quick", action="store_true", help="fewer targets")
    parser.add_argument("--caustics", nargs="*", metavar="SCENE", help="scenes with them alone")
    arguments = parser.parse_args()
    if not LIBRARY.is_file():
        sys.exit(f"{LIBRARY} is not built")
    if arguments.caustics is not None:
        caustics(arguments.size, arguments.seeds, arguments.caustics)
        return
    honest(arguments.size, arguments.seeds, arguments.quick)
    caustics(arguments.size, arguments.seeds, [])
    saving(2 * arguments.size, 0.01)


if __name__ == "__main__":
    main()
