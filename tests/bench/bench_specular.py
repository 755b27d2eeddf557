# SPDX-License-Identifier: GPL-3.0-or-later
"""Exact connections: errors against closed forms, distances to tubes, and cost. Prints; never
asserts.

    python3 tests/bench/bench_specular.py [--threads N]
"""

from __future__ import annotations

import argparse
import statistics
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "images"))

import metrics  # noqa: E402
from api import LIBRARY, SPECULAR, TUBES, render  # noqa: E402
from bumpy import SAMPLES, SEED, SIZE, bumpy, rays_alone, stage_cpu  # noqa: E402
from cases import FOLDER, load_case, sphere_interior  # noqa: E402
from meshes import icosphere  # noqa: E402
from oracles import Slab, SphereMedium, matched_sphere  # noqa: E402
from test_closed_forms import radiance, slab_scene, sphere_errors, sphere_scene  # noqa: E402


def closed_forms() -> None:
    slab = Slab(g=0.5)
    pixels = render(slab_scene(slab), 8, estimator=SPECULAR, samples=4).pixels
    print(f"slab: mean {pixels.mean() / slab.radiance() - 1:+.1e}, ", end="")
    print(f"spread of the pixels {pixels.std() / pixels.mean():.1e}")
    medium = SphereMedium(1.0, 0.4, 0.5, 0.5)
    light = np.array([0.6, 0, 0.8])
    origin, direction = np.array([5, 0.2, 0.3]), np.array([-1.0, 0, 0])
    expected = matched_sphere(origin, direction, light, medium.sigma_s, medium.sigma_t, medium.g)
    build = sphere_scene(icosphere(5), medium, 0.2, 0.3, (0.6, 0, 0.8))
    value = radiance(build, 2, estimator=SPECULAR, samples=4)[0]
    print(f"sphere of index 1: {value / expected - 1:+.1e}")
    for level in (5, 6, 7):
        worst = np.max(np.abs(sphere_errors(level, SPECULAR, 1, 1.0)))
        print(f"refracting sphere, {20 * 4**level} triangles, worst of four rays: {worst:.1e}")


def reference_cases(threads: int) -> None:
    for name in ("bumpy", "slab", "sphere"):
        if not (FOLDER / name / "case.json").is_file():
            continue
        case = load_case(name)
        image = render(case.build, 128, estimator=SPECULAR, samples=16, threads=threads)
        mask = image.cover > 0
        if name == "bumpy":
            truth = (case.reference("ref_128_A") + case.reference("ref_128_B")) / 2
        else:
            truth = case.reference("analytic_128")
        if name == "sphere":
            mask &= sphere_interior(128, case)
        ratio = metrics.mean_ratio(image.pixels, truth, mask)
        print(f"{name} 128 x 128, 16 samples, mean, green: {ratio[1] - 1:+.1e}")


def distances(threads: int) -> None:
    build = bumpy()
    rays = [stage_cpu(rays_alone(build, threads), ["camera"]) for _ in range(5)]
    unit = statistics.median(rays)
    settings = {"samples": SAMPLES, "seed": SEED, "threads": threads}
    exact = render(build, SIZE, estimator=SPECULAR, **settings)
    print(f"\nbumpy, {SIZE}^2, {SAMPLES} samples a pixel; camera rays alone {unit:.3f} CPU-s")
    print(f"SPECULAR: {stage_cpu(exact) / unit:.0f} x rays, ", end="")
    print(f"{exact.report['memory']['field_bytes'] / 1e6:.1f} MB")
    mask = exact.cover > 0
    for refinement in (0, 1, 2, 3, 4):
        image = render(build, SIZE, estimator=TUBES, tube_refinement=refinement, **settings)
        square = np.sort(((image.pixels - exact.pixels)[mask] ** 2).sum(axis=-1))[::-1]
        print(
            f"TUBES {refinement}: {stage_cpu(image) / unit:.0f} x rays, "
            f"rel_rmse to SPECULAR {metrics.rel_rmse(image.pixels, exact.pixels, mask):.1e}, "
            f"mean {metrics.mean_ratio(image.pixels, exact.pixels, mask)[1] - 1:+.1e}, "
            f"{100 * square[:10].sum() / square.sum():.0f} % of the square in ten pixels"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--threads", type=int, default=1)
    threads = parser.parse_args().threads
    if not LIBRARY.is_file():
        sys.exit(f"{LIBRARY} is not built: cmake --workflow --preset release")
    closed_forms()
    reference_cases(threads)
    distances(threads)


if __name__ == "__main__":
    main()
