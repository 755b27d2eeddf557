# SPDX-License-Identifier: GPL-3.0-or-later
"""What TREE_CUT misses and what it costs, against random walks. Prints; never asserts.

    python3 tests/bench/bench_tree_cut.py [--quick] [--shape sphere|slab] [--threads N]

A body of albedo 0.9 lit by a point lamp from the side, both estimators along the same camera rays
and with the same light field of single scattering. The walk with many samples is the reference.
"bias" is that of the mean of all pixels; "error" the root of the mean square over pixels in units
of the mean, with CUT_SAMPLES camera samples; "walk" the CPU time of walks with so many samples that
their error is as large, over that of TREE_CUT: below 1 walks are cheaper. For double scattering an
error below the reference's own counts as large as that, and for the other it is of both together.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "images"))

import numpy as np  # noqa: E402
from api import _ffi, add_point, handles, library  # noqa: E402
from numpy.typing import NDArray  # noqa: E402
from order_scenes import Camera, OrderScene, reference_scene  # noqa: E402

SIZE = 12
CUT_SAMPLES = 16  # a pixel: enough that its error is not the sampling of pixels
PASSES = ["Double Scattering", "Multiple Scattering"]
EFFECTS = _ffi.AMB_EFFECT_DOUBLE_SCATTERING | _ffi.AMB_EFFECT_MULTIPLE_SCATTERING
CAMERAS = {
    "sphere": Camera((0, 0, 5), (0, 0, -1), (0, 1, 0), (1.9, 1.9), is_pinhole=False),
    "slab": Camera((0, 4, 4), (0, -1, -1), (0, 1, 0), (2.0, 1.2), is_pinhole=False),
}


@dataclass(frozen=True)
class Picture:
    """``orders``: (2, SIZE, SIZE), double and multiple scattering."""

    orders: NDArray[np.float64]
    camera: float  # CPU seconds
    field: float


def picture(scene: OrderScene, estimator: int, samples: int, threads: int, seed: int) -> Picture:
    with handles.Scene(library.load()) as target:
        scene.build(target)
        add_point(target, (-1.6, 1.4, 2.8), 20.0)
        target.commit()
        settings = {"width": SIZE, "height": SIZE, "samples": samples, "seed": seed}
        with target.start(
            **settings,
            effects=EFFECTS,
            scatter_estimator=estimator,
            light_bounces=2,
            camera_bounces=8,
            threads=threads,
        ) as job:
            job.wait()
            orders = [job.read_pass(name).astype(np.float64).mean(axis=-1) for name in PASSES]
            cpu = {stage["name"]: stage["cpu_s"] for stage in job.report()["stages"]}
    return Picture(np.array(orders), cpu["camera"], cpu["field"])


def row(scene: OrderScene, samples: int, threads: int) -> str:
    walks = [picture(scene, _ffi.AMB_SCATTER_WALK, samples, threads, s) for s in (1, 2)]
    cut = picture(scene, _ffi.AMB_SCATTER_TREE_CUT, CUT_SAMPLES, threads, 1)
    truth = (walks[0].orders + walks[1].orders) / 2
    half = (walks[0].orders - walks[1].orders) / 2
    text = ""
    for k in range(2):
        mean = truth[k].mean()
        noise = np.sqrt((half[k] ** 2).sum()) / half[k].size / mean
        bias = cut.orders[k].mean() / mean - 1
        error = np.sqrt(max(((cut.orders[k] - truth[k]) ** 2 - half[k] ** 2).mean(), 0)) / mean
        text += f"{100 * bias:>9.1f} +-{100 * noise:>4.1f} %{100 * error:>8.1f} %"
    seconds = sum(w.camera for w in walks) / (2 * samples)
    for found, right, spread in (
        (cut.orders[0], truth[0], half[0]),
        (cut.orders.sum(axis=0), truth.sum(axis=0), half.sum(axis=0)),
    ):
        noise2 = (spread**2).mean()
        error2 = max(((found - right) ** 2).mean() - noise2, noise2)
        # The half difference of two means of n samples has the variance of one sample over 2 n.
        text += f"{2 * samples * noise2 / error2 * seconds / cut.camera:>8.2f}"
    return f"{text}{cut.camera / CUT_SAMPLES / seconds:>9.0f}{cut.field:>8.2f}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--shape", choices=sorted(CAMERAS), default="sphere")
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    samples = 64 if options.quick else 256
    print(
        f"{options.shape}, {SIZE}^2, walks of 2 x {samples} samples a pixel\n\n"
        f"{'radius':>6}{'ior':>5}{'double: bias':>20}{'error':>10}{'multiple: bias':>20}"
        f"{'error':>10}{'walk 2':>8}{'walk':>8}{'samples':>9}{'build s':>8}"
    )
    for radius in (0.3, 2.0, 10.0):
        for ior in (1.0, 1.5):
            scene = reference_scene(options.shape, radius)
            scene = replace(scene, ior=ior, lamps=[], camera=CAMERAS[options.shape])
            line = row(scene, samples, options.threads)
            print(f"{radius:>6}{ior:>5}{line}", flush=True)
    print("\nsamples: walks for the CPU time of one sample of TREE_CUT")
    return 0


if __name__ == "__main__":
    sys.exit(main())
