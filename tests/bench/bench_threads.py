# SPDX-License-Identifier: GPL-3.0-or-later
"""What a second thread brings, on the bumpy sphere. Prints; never asserts.

python3 tests/bench/bench_threads.py
"""

from __future__ import annotations

import statistics
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "images"))

from api import LIBRARY, POINTS, BuildScene  # noqa: E402
from bumpy import bumpy, measure, stage_cpu  # noqa: E402

BAR_SPEEDUP = 1.8


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
    if not LIBRARY.is_file():
        sys.exit(f"{LIBRARY} is not built: ./amberlight build")
    speed_up(bumpy())


if __name__ == "__main__":
    main()
