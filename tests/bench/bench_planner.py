#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Effects chosen by the planner against everything on.

    python3 tests/bench/bench_planner.py [--accuracy 0.05 | --samples 16] [--size 64] [SCENE ...]
    python3 tests/bench/bench_planner.py --finished [--accuracy 0.05] [--size 64] [SCENE ...]

Everything on: all effects and eight internal reflections on either side, estimators AUTO. At the
same target accuracy both renders state their error, with what was left out in it; at the same
number of samples both have the noise of the same paths, and what is left out is below the target's
1 %. The ratio is of their CPU seconds, all stages, planning included, the least of --repeat runs.

--finished: the error of AUTO's finished pictures against everything on, with sixteen reflections.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "images"))

from planner_scenes import SCENES, PlannerScene  # noqa: E402
from planner_shares import EVERYTHING, render_passes, truth  # noqa: E402

BOUNCES = 8


# Of the pictures with everything on; estimators AUTO.
TRUTH: dict[str, Any] = {"samples": 16, "light_samples": 2**18, "kernel_size": 2.0}


def measure(
    scene: PlannerScene, size: int, repeat: int, **params: Any
) -> tuple[float, dict[str, Any]]:
    reports = [render_passes(scene, size, **params)[1] for _ in range(repeat)]
    costs = [sum(stage["cpu_s"] for stage in report["stages"]) for report in reports]
    return min(costs), reports[-1]


def compare(scenes: list[PlannerScene], size: int, repeat: int, **common: Any) -> None:
    ratios = []
    print("| scene | everything, CPU s | AUTO, CPU s | ratio | planning | stated | left out |")
    print("|---|---|---|---|---|---|---|")
    for scene in scenes:
        every, full = measure(
            scene, size, repeat, **common, light_bounces=BOUNCES, camera_bounces=BOUNCES
        )
        auto, chosen = measure(scene, size, repeat, **common, effects_are_auto=1)
        ratios.append(every / auto)
        stated = [report["accuracy"]["stated"] for report in (full, chosen)]
        text = " ".join("-" if value is None else f"{value:.1%}" for value in stated)
        skipped = sum(not effect["simulated"] for effect in chosen["effects"])
        planning = chosen["plan"]["cpu_s"] / auto
        print(
            f"| {scene.name} | {every:.3f} | {auto:.3f} | {every / auto:.2f} | {planning:.0%} | "
            f"{text} | {chosen['plan']['omitted']:.2%}, {skipped} effects |",
            flush=True,
        )
    print(
        f"\nmedian {np.median(ratios):.2f}, best {max(ratios):.1f}, least {min(ratios):.2f} "
        f"(bars: 3, 50, 0.95), {len(ratios)} scenes"
    )


def finish(scenes: list[PlannerScene], size: int, target: float, **common: Any) -> None:
    """Scenes that show a translucent object."""
    ratios = []
    print("| scene | stated | left out, as planned | true | its bounds | true / target |")
    print("|---|---|---|---|---|---|")
    for scene in scenes:
        known = truth(scene, size, effects=EVERYTHING, **(common | TRUTH))
        if not known.mask.any():
            continue
        (image,), report = render_passes(
            scene, size, effects=EVERYTHING, effects_are_auto=1, accuracy=target, **common
        )
        true, (low, high) = known.error(image), known.bounds(image)
        ratios.append(true / target)
        print(
            f"| {scene.name} | {report['accuracy']['stated']:.2%} | "
            f"{report['plan']['omitted']:.2%} | {true:.2%} | {low:.1%} .. {high:.1%} | "
            f"{ratios[-1]:.2f} |",
            flush=True,
        )
    below = [sum(ratio <= most for ratio in ratios) for most in (1.0, 1.1, 1.5)]
    print(f"\nwithin 1, 1.1 and 1.5 times the target: {below} of {len(ratios)} scenes")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*")
    parser.add_argument("--finished", action="store_true")
    parser.add_argument("--accuracy", type=float, default=0.05)
    parser.add_argument("--samples", type=int, default=0)
    parser.add_argument("--light-samples", type=int, default=1_000_000)
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--repeat", type=int, default=1)
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    scenes = [s for s in SCENES if not options.scenes or s.name in options.scenes]
    common: dict[str, Any] = {
        "threads": options.threads,
        "light_samples": options.light_samples,
    }
    if options.finished:
        finish(scenes, options.size, options.accuracy, **common)
        return
    budget = (
        {"samples": options.samples, "accuracy": 0.0}
        if options.samples
        else {"accuracy": options.accuracy}
    )
    compare(scenes, options.size, options.repeat, effects=EVERYTHING, **common, **budget)


if __name__ == "__main__":
    main()
