# SPDX-License-Identifier: GPL-3.0-or-later
"""SmallUPBP's images of the shared cases beside ours. Prints markdown; never asserts.

    python3 tests/bench/bench_upbp.py [--threads 2]

SmallUPBP is the reference renderer of the paper; the cases have two independent runs A, B of each
and say what CPU time each took, on another machine and before this project: its seconds and ours
may be compared in their order of magnitude and no closer. Our errors are from the product of the
differences to A and to B, in which their noise cancels; a run of SmallUPBP has the noise that
A - B shows. Where a quadrature exists, both are also held against that.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "images"))

import metrics  # noqa: E402
from api import ESTIMATORS, LIBRARY, render  # noqa: E402
from bumpy import stage_cpu  # noqa: E402
from cases import FOLDER, Case, load_case, sphere_interior  # noqa: E402

SIZE = 128
# Estimator, camera samples a pixel, settings: the pixels' own sampling is most of the error.
SETTINGS = (
    ("TUBES", 16, {"tube_refinement": 0}),
    ("TUBES", 64, {"tube_refinement": 1}),
    ("TUBES", 256, {"tube_refinement": 1}),
    ("POINTS_COVARIANCE", 16, {"light_samples": 2**18, "kernel_size": 4.0}),
    ("POINTS_COVARIANCE", 64, {"light_samples": 2**21, "kernel_size": 4.0}),
    ("POINTS_FIXED", 64, {"light_samples": 2**21, "kernel_size": 1.0}),
)


def stated_seconds(case: Case) -> float:
    """CPU seconds of one run, from the sentence in case.json."""
    log = case.data["renders"][0]["log"]
    found = re.search(r"([\d.]+) (?:CPU-seconds|s \()", log if isinstance(log, str) else log[0])
    if found is None:
        sys.exit(f"{case.folder}/case.json states no CPU time")
    return float(found.group(1))


def percent(mean_square: float, mean: float) -> str:
    """Root of a mean square over the mean; one below zero is noise around zero."""
    return f"{100 * np.sign(mean_square) * np.sqrt(abs(mean_square)) / mean:.3g} %"


def compare(case: Case, threads: int) -> None:
    first, second = case.reference("ref_128_A"), case.reference("ref_128_B")
    both = (first + second) / 2
    has_truth = (case.folder / "analytic_128.npy").is_file()
    truth = case.reference("analytic_128") if has_truth else None
    images = []
    for name, samples, settings in SETTINGS:
        chosen = {"estimator": ESTIMATORS[name], "samples": samples, "threads": threads}
        images.append(render(case.build, SIZE, **chosen, **settings))
    mask = images[0].cover > 0
    if case.name == "sphere":
        mask &= sphere_interior(SIZE, case)
    mean = float(both[mask].mean())

    def against_truth(image: NDArray[np.floating]) -> str:
        return "" if truth is None else f"{100 * metrics.rel_rmse(image, truth, mask):.3g} %"

    print(f"\n### {case.name}, {SIZE} x {SIZE}\n")
    print("| | samples a pixel | CPU s | error, A x B | mean / SmallUPBP's | error, quadrature |")
    print("|---|---|---|---|---|---|")
    noise = float(np.mean((first - second)[mask] ** 2)) / 2
    print(
        f"| SmallUPBP, one run | | {stated_seconds(case):g} (stated) | {percent(noise, mean)} "
        f"(noise) | 1 | {against_truth(first)} |"
    )
    for (name, samples, settings), image in zip(SETTINGS, images, strict=True):
        error = metrics.cross_mse(image.pixels, first, second, mask)
        ratio = float(image.pixels[mask].mean()) / mean
        chosen = ", ".join(f"{key} {value:.7g}" for key, value in settings.items())
        print(
            f"| {name}, {chosen} | {samples} | {stage_cpu(image):.2f} | {percent(error, mean)} "
            f"| {ratio:.4f} | {against_truth(image.pixels)} |"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    if not LIBRARY.is_file():
        sys.exit(f"{LIBRARY} is not built: ./amberlight build")
    if not FOLDER.is_dir():
        sys.exit(f"no reference cases in {FOLDER}")
    print(f"{arguments.threads} thread(s)")
    for name in ("bumpy", "slab", "sphere"):
        compare(load_case(name), arguments.threads)


if __name__ == "__main__":
    main()
