#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Effects chosen by the planner against everything on.

    python3 tests/bench/bench_planner.py [--accuracy 0.05 | --samples 16] [--size 64] [SCENE ...]

Everything on: all effects and eight internal reflections on either side, estimators AUTO. At the
same target accuracy both renders state their error, with what was left out in it; at the same
number of samples both have the noise of the same paths, and what is left out is below the target's
1 %. The ratio is of their CPU seconds, all stages, planning included.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "images"))

from planner_scenes import SCENES, PlannerScene  # noqa: E402
from planner_shares import EVERYTHING, render_passes  # noqa: E402

BOUNCES = 8


def measure(scene: PlannerScene, size: int, **params: Any) -> tuple[float, dict[str, Any]]:
    _, report = render_passes(scene, size, **params)
    return sum(stage["cpu_s"] for stage in report["stages"]), report


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*")
    parser.add_argument("--accuracy", type=float, default=0.05)
    parser.add_argument("--samples", type=int, default=0)
    parser.add_argument("--light-samples", type=int, default=1_000_000)
    parser.add_argument("--size", type=int, default=64)
    options = parser.parse_args()
    common: dict[str, Any] = {"effects": EVERYTHING, "light_samples": options.light_samples}
    if options.samples:
        common |= {"samples": options.samples, "accuracy": 0.0}
    else:
        common |= {"accuracy": options.accuracy}
    ratios = []
    print("| scene | everything, CPU s | AUTO, CPU s | ratio | planning | stated | left out |")
    print("|---|---|---|---|---|---|---|")
    for scene in SCENES:
        if options.scenes and scene.name not in options.scenes:
            continue
        every, full = measure(
            scene, options.size, **common, light_bounces=BOUNCES, camera_bounces=BOUNCES
        )
        auto, chosen = measure(scene, options.size, **common, effects_are_auto=1)
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


if __name__ == "__main__":
    main()
