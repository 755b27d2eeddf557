#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Effects chosen by the planner against everything on.

    python3 tests/bench/bench_planner.py [--accuracy 0.05 | --samples 16] [--size 64] [--tuned]
        [--seeds 1] [SCENE ...]
    python3 tests/bench/bench_planner.py --finished [--accuracy 0.05] [--size 64] [SCENE ...]
    python3 tests/bench/bench_planner.py --bounds [--seeds 8] [SCENE ...]

Everything on: all effects and eight internal reflections on either side, estimators AUTO; with
--tuned also the cheapest of that, of volume samples by name, of photons by name and of both, which
is what a user finds who tries. At the same target accuracy all renders state their error, with what
was left out in it; at the same number of samples both have the noise of the same paths, and what is
left out is below the target's 1 %. The ratio is of their CPU seconds, all stages, planning
included, the least of --repeat runs, and of five where they are short, summed over seeds.

--finished: the error of AUTO's finished pictures against everything on, with sixteen reflections.

--bounds: how often the predicted shares' bounds hold the shares by brute force
(references/planner_shares.json), over seeds.

With --keep FOLDER what a run has measured, and the pictures of truth, stay there: a run that was
stopped goes on, a second one prints what is there. What AUTO cost belongs to one library, by its
bytes; pictures of truth do not.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections import defaultdict
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "images"))

from api import LIBRARY, POINTS_COVARIANCE, _ffi, handles, library  # noqa: E402
from planner_scenes import SCENES, PlannerScene  # noqa: E402
from planner_shares import COUNTS, EVERYTHING, Truth, render_passes, truth  # noqa: E402

BOUNCES = 8
# Renders of fewer CPU seconds are repeated: what else the machine does is a tenth of them.
SHORT, SHORT_REPEAT = 0.5, 5


# What is chosen by hand beside AUTO's estimators.
BY_HAND: list[dict[str, Any]] = [
    {"estimator": POINTS_COVARIANCE},
    {"scatter_estimator": _ffi.AMB_SCATTER_PHOTONS},
    {"estimator": POINTS_COVARIANCE, "scatter_estimator": _ffi.AMB_SCATTER_PHOTONS},
]
# Of the pictures with everything on; estimators AUTO.
TRUTH: dict[str, Any] = {"samples": 64, "light_samples": 2**18, "kernel_size": 2.0}


Row = dict[str, Any]


class Keep:
    """What is known already, in a folder; None: nothing is kept."""

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)

    def _file(self, what: Any, ending: str) -> Path:
        assert self.folder is not None
        key = hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()[:16]
        return self.folder / f"{key}{ending}"

    def row(self, what: Any, make: Callable[[], Row]) -> Row:
        """Of this library: rows are measured anew by another one."""
        if self.folder is None:
            return make()
        file = self._file([what, hashlib.sha256(LIBRARY.read_bytes()).hexdigest()], ".json")
        if not file.exists():
            file.write_text(json.dumps(make()))
        row: Row = json.loads(file.read_text())
        return row

    def truth(self, scene: PlannerScene, size: int, **params: Any) -> Truth:
        if self.folder is None:
            return truth(scene, size, **params)
        file = self._file([scene.name, size, params], ".npz")
        if not file.exists():
            known = truth(scene, size, **params)
            np.savez(file, mask=known.mask, first=known.halves[0], second=known.halves[1])
        with np.load(file) as data:
            return Truth(data["mask"], (data["first"], data["second"]))


def measure(
    scene: PlannerScene, size: int, repeat: int, **params: Any
) -> tuple[float, dict[str, Any]]:
    costs: list[float] = []
    while len(costs) < (repeat if min(costs, default=0.0) > SHORT else max(repeat, SHORT_REPEAT)):
        report = render_passes(scene, size, **params)[1]
        costs.append(sum(stage["cpu_s"] for stage in report["stages"]))
    return min(costs), report


def measure_seeds(
    scene: PlannerScene, size: int, repeat: int, seeds: int, **params: Any
) -> tuple[float, dict[str, Any]]:
    """The sum of the costs, and the first seed's report."""
    found = [measure(scene, size, repeat, seed=seed, **params) for seed in range(seeds)]
    return sum(cost for cost, _ in found), found[0][1]


def compare_one(
    scene: PlannerScene, size: int, repeat: int, seeds: int, is_tuned: bool, common: dict[str, Any]
) -> Row:
    cost = partial(measure_seeds, scene, size, repeat, seeds, **common)
    everything = {"light_bounces": BOUNCES, "camera_bounces": BOUNCES}
    every, full = cost(**everything)
    by_hand = BY_HAND if is_tuned else []
    tuned = min([every, *(cost(**everything, **by)[0] for by in by_hand)])
    auto, chosen = cost(effects_are_auto=1)
    return {
        "every": every,
        "tuned": tuned,
        "auto": auto,
        "planning": seeds * chosen["plan"]["cpu_s"] / auto,
        "stated": [report["accuracy"]["stated"] for report in (full, chosen)],
        "samples": [report["accuracy"]["samples_mean"] for report in (full, chosen)],
        "estimators": f"{chosen['estimator']} {chosen['scatter']['estimator']}",
        "omitted": chosen["plan"]["omitted"],
        "skipped": sum(not effect["simulated"] for effect in chosen["effects"]),
    }


def compare(
    scenes: list[PlannerScene],
    size: int,
    repeat: int,
    seeds: int,
    is_tuned: bool,
    keep: Keep,
    **common: Any,
) -> None:
    ratios = []
    tuned = []
    print(
        "| scene | everything, CPU s | tuned | AUTO, CPU s | ratio | to tuned | planning | stated "
        "| samples | left out |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for scene in scenes:
        row = keep.row(
            ["compare", scene.name, size, repeat, seeds, is_tuned, common],
            partial(compare_one, scene, size, repeat, seeds, is_tuned, common),
        )
        ratios.append(row["every"] / row["auto"])
        tuned.append(row["tuned"] / row["auto"])
        stated = " ".join("-" if value is None else f"{value:.1%}" for value in row["stated"])
        samples = " ".join(f"{value:.0f}" for value in row["samples"])
        print(
            f"| {scene.name} | {row['every']:.3f} | {row['tuned']:.3f} | {row['auto']:.3f} | "
            f"{ratios[-1]:.2f} | {tuned[-1]:.2f} | {row['planning']:.0%} | {stated} | {samples} | "
            f"{row['omitted']:.2%}, {row['skipped']} effects; {row['estimators']} |",
            flush=True,
        )
    found_by = {"AUTO's estimators": ratios} | ({"the better ones": tuned} if is_tuned else {})
    for what, found in found_by.items():
        print(
            f"\neverything on by {what}: median {np.median(found):.2f}, best {max(found):.1f}, "
            f"least {min(found):.2f} (bars: 3, 50, 0.95), {len(found)} scenes"
        )


def finish(scenes: list[PlannerScene], size: int, target: float, keep: Keep, **common: Any) -> None:
    """Scenes that show a translucent object."""
    ratios = []
    print("| scene | stated | left out, as planned | true | its bounds | true / target |")
    print("|---|---|---|---|---|---|")
    for scene in scenes:
        known = keep.truth(scene, size, effects=EVERYTHING, **(common | TRUTH))
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


SHARES_SIZE = 24  # of the pictures that planner_shares.json is from
SHARE_LEAST = 1e-3  # Of smaller ones what is known by brute force is noise, too.


def bounds(scenes: list[PlannerScene], seeds: int) -> None:
    """By effect; a counted one's is the share of all its reflections."""
    file = Path(__file__).resolve().parents[1] / "images/references/planner_shares.json"
    known = json.loads(file.read_text())
    held: dict[str, list[int]] = defaultdict(lambda: [0, 0, 0])
    errors: dict[str, list[float]] = defaultdict(list)
    for scene in scenes:
        shares = {
            name: share[0] if name in COUNTS else share for name, share in known[scene.name].items()
        }
        for seed in range(seeds):
            with handles.Scene(library.load()) as built:
                scene.build(built)
                built.commit()
                plan = built.explain(
                    width=SHARES_SIZE,
                    height=SHARES_SIZE,
                    samples=64,
                    effects=EVERYTHING,
                    effects_are_auto=1,
                    seed=seed,
                )
            for effect in plan["effects"]:
                true, share = shares.get(effect["name"], 0.0), effect["share"]
                if true > SHARE_LEAST and share is not None:
                    where = 0 if true < share["low"] else 2 if true > share["high"] else 1
                    held[effect["name"]][where] += 1
                    errors[effect["name"]].append(share["value"] / true - 1)
    print("| effect | shares | between their bounds | below | above | predicted / true - 1 |")
    print("|---|---|---|---|---|---|")
    for name, (below, inside, above) in held.items():
        total = below + inside + above
        mean, spread = np.mean(errors[name]), np.std(errors[name])
        print(
            f"| {name} | {total} | {inside / total:.0%} | {below} | {above} "
            f"| {mean:+.1%} +- {spread:.0%} |"
        )
    sums = np.sum(list(held.values()), axis=0)
    print(f"\n{sums[1]} of {sums.sum()} between their bounds: {sums[1] / sums.sum():.1%}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*")
    parser.add_argument("--finished", action="store_true")
    parser.add_argument("--bounds", action="store_true")
    parser.add_argument("--seeds", type=int, help="1, for --bounds 8")
    parser.add_argument("--keep", type=Path, help="folder")
    parser.add_argument("--accuracy", type=float, default=0.05)
    parser.add_argument("--samples", type=int, default=0)
    parser.add_argument("--tuned", action="store_true")
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
    if options.bounds:
        bounds(scenes, options.seeds or 8)
        return
    keep = Keep(options.keep)
    if options.finished:
        finish(scenes, options.size, options.accuracy, keep, **common)
        return
    budget = (
        {"samples": options.samples, "accuracy": 0.0}
        if options.samples
        else {"accuracy": options.accuracy}
    )
    common |= {"effects": EVERYTHING, **budget}
    seeds = options.seeds or 1
    compare(scenes, options.size, options.repeat, seeds, options.tuned, keep, **common)


if __name__ == "__main__":
    main()
