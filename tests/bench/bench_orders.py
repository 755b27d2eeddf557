# SPDX-License-Identifier: GPL-3.0-or-later
"""Orders of scattering: how well the library agrees with the independent path tracer, and what each
pays for order 2.

    python3 tests/bench/bench_orders.py table [--runs 16]   # z-scores, as in docs/accuracy.md
    python3 tests/bench/bench_orders.py flux [--runs 16]    # watts in and out of spheres
    python3 tests/bench/bench_orders.py speed               # order 2, at equal error
    python3 tests/bench/bench_orders.py full                # all orders against the first
    python3 tests/bench/bench_orders.py noise               # which of its parts is the noise

The tracer comes with the C tests: cmake --build build/dev --target order_tracer.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "images"))

from api import SINGLE, TUBES, _ffi, handles, library, render  # noqa: E402
from bumpy import bumpy, stage_cpu  # noqa: E402
from order_scenes import (  # noqa: E402
    DOUBLE,
    LAMP,
    ORDERS,
    RADII,
    SCATTERED,
    WALK,
    Ball,
    balance,
    library_orders,
    reference_scene,
    stored_orders,
    trace,
    whole,
)

PHOTONS = _ffi.AMB_SCATTER_PHOTONS
SHAPES = ["sphere", "slab", "bumpy"]
TABLE_SIZE = 32
# Kernels must be narrow against free paths, and thin media need many walks.
KERNEL_SIZE = 1.0
VOLUME_SAMPLES = {0.3: 2**15, 2.0: 2**15, 10.0: 2**17}
TABLE_SAMPLES = {0.3: 8, 2.0: 4, 10.0: 4}

LAMP_RADIUS = 0.05
SPEED_PATHS = 1.6e7
SPEED_SIZE, SPEED_SAMPLES, SPEED_RUNS = 32, 2, 8
# What the costs are stated for: each pixel of a picture to this relative error.
PICTURE, PIXEL_ERROR = 128 * 128, 0.05
COARSEST = 0.64  # of the full picture's errors


def table(runs: int) -> None:
    names = ["1", "2", "3", "4+", "1+"]
    print("| scene | " + " | ".join(f"order {name}" for name in names) + " | z of regions |")
    print("|---|" + "---|" * (len(names) + 1))
    for shape in SHAPES:
        for radius in RADII:
            known = stored_orders(shape, radius)
            scene = reference_scene(shape, radius)
            found = library_orders(
                scene,
                TABLE_SIZE,
                runs,
                samples=TABLE_SAMPLES[radius],
                kernel_size=KERNEL_SIZE,
                light_samples=VOLUME_SAMPLES[radius],
            )
            (mean, error), (ours, our_error) = whole(known), whole(found)
            cells = []
            for name in names:
                k = ORDERS.index(name)
                sigma = np.hypot(error[k], our_error[k])
                off, z = ours[k] / mean[k] - 1, (ours[k] - mean[k]) / sigma
                cells.append(f"{off:+.2%} ({sigma / mean[k]:.2%}), {z:+.1f}")
            columns = [ORDERS.index(name) for name in names[:-1]]
            sigma = np.hypot(found.error, known.error)[..., columns]
            z = (found.mean - known.mean)[..., columns] / sigma
            rms, most = np.sqrt(np.mean(z**2)), np.abs(z).max()
            tail = f"rms {rms:.2f}, most {most:.1f}"
            print(f"| {shape} {radius:g} | " + " | ".join([*cells, tail]) + " |", flush=True)


def flux(runs: int) -> None:
    print("| index | albedo | g | out | absorbed | out + absorbed - 1 | its error |")
    print("|---|---|---|---|---|---|---|")
    for ior, g in ((0.75, 0.0), (1.0, 0.5), (1.33, 0.5), (1.5, 0.0), (2.4, 0.0)):
        for albedo in (1.0, 0.7):
            found = balance(ior, albedo, g, runs, samples=4)
            off = found.out + found.absorbed - 1
            print(
                f"| {ior:g} | {albedo:g} | {g:g} | {found.out:.4f} | {found.absorbed:.4f} "
                f"| {off:+.2%} | {found.error:.2%} |",
                flush=True,
            )


def speed() -> None:
    """CPU seconds for order 2 of a picture; both follow all internal reflections that matter."""
    k = ORDERS.index("2")
    intensity = LAMP.radiance * LAMP.size[0] * LAMP.size[1]
    print("| scene | radiance, tracer | walk | tracer, CPU s | walk, CPU s | ratio |")
    print("|---|---|---|---|---|---|")
    for shape, radius in (("sphere", 2.0), ("bumpy", 2.0), ("slab", 2.0), ("sphere", 0.3)):
        lamps = [Ball(LAMP.position, LAMP_RADIUS, intensity)]
        scene = dataclasses.replace(reference_scene(shape, radius), lamps=lamps, regions=(1, 1))
        traced = trace(scene, SPEED_PATHS, last_order=2)
        mean, error = traced.mean[0, 0, k], traced.error[0, 0, k]
        paths = traced.data["paths"]
        per_path = traced.data["cpu_seconds"] / paths
        paths_needed = PICTURE * error**2 * paths / (PIXEL_ERROR * mean) ** 2
        pictures, camera, field = [], 0.0, 0.0
        for seed in range(SPEED_RUNS):
            image = render(
                scene.build,
                SPEED_SIZE,
                name="Double Scattering",
                effects=DOUBLE,
                estimator=TUBES,
                scatter_estimator=WALK,
                scatter_order_max=2,
                light_bounces=2,
                camera_bounces=64,
                adjoint_normals=1,
                samples=SPEED_SAMPLES,
                seed=seed,
            )
            pictures.append(image.pixels[..., 1].astype(np.float64))
            cost = {stage["name"]: stage["cpu_s"] for stage in image.report["stages"]}
            camera += cost["camera"] / SPEED_RUNS
            field += (cost["scene"] + cost["light"] + cost["field"]) / SPEED_RUNS
        stack = np.array(pictures)
        ours = stack.mean()
        variance = stack.var(axis=0, ddof=1).mean() * SPEED_SAMPLES  # of one sample
        needed = PICTURE * variance / (PIXEL_ERROR * ours) ** 2
        walk = field + needed * camera / (SPEED_SIZE**2 * SPEED_SAMPLES)
        tracer = paths_needed * per_path
        print(
            f"| {shape} {radius:g} | {mean:.4g} +- {error / mean:.1%} | {ours:.4g} "
            f"+- {np.sqrt(variance / stack.size / SPEED_SAMPLES) / ours:.1%} "
            f"| {tracer:.3g} | {walk:.3g} | {tracer / walk:.0f} |",
            flush=True,
        )


def planned_bounces(size: int, target: float) -> dict[str, int]:
    """The internal reflections that AUTO follows for this target."""
    with handles.Scene(library.load()) as scene:
        bumpy()(scene)
        scene.commit()
        plan = scene.explain(
            width=size, height=size, effects=SCATTERED, effects_are_auto=1, accuracy=target
        )
    counts = {effect["name"]: effect["count"] for effect in plan["effects"]}
    return {
        "light_bounces": counts["light-side internal reflection"],
        "camera_bounces": counts["camera-side internal reflection"],
    }


def full(size: int, scatter: int, target: float, seconds: float) -> None:
    """All that scatters in the paper's bumpy sphere, with the internal reflections that show at
    this error, and its first passes alone, both to this error of their own. The former from a
    coarse error on, halved while the next one should come to an end within these CPU seconds. What
    it takes to the target is more than the last one's light and, as noise falls with the root of
    samples, the square of errors times its camera."""
    bounces = planned_bounces(size, target)
    print(f"{size} x {size}; reflections that show: {bounces}\n")
    print("| picture | target | stated | noise | samples, mean, most | light, CPU s | camera |")
    print("|---|---|---|---|---|---|---|")

    def row(name: str, accuracy: float, **settings: int) -> tuple[float, float, float]:
        image = render(
            bumpy(),
            size,
            name="Combined",
            adjoint_normals=1,
            accuracy=accuracy,
            threads=1,
            **settings,
        )
        known = image.report["accuracy"]
        camera = stage_cpu(image, ["camera"])
        others = stage_cpu(image) - camera
        print(
            f"| {name} | {accuracy:.0%} | {known['stated']:.1%} | {known['noise']:.1%} "
            f"| {known['samples_mean']:.0f}, {known['samples_max']} "
            f"| {others:.2f} | {camera:.2f} |",
            flush=True,
        )
        return known["stated"], others, camera

    _, *first = row("order 1, no reflections", target, effects=SINGLE)
    everything = {"effects": SCATTERED, "scatter_estimator": scatter, **bounces}
    accuracy, costs = COARSEST, [0.0]
    while accuracy >= target and (len(costs) < 3 or costs[-1] ** 2 / costs[-2] < seconds):
        stated, others, camera = row("all orders and reflections", accuracy, **everything)
        costs.append(others + camera)
        accuracy /= 2
    least = others + camera * max(stated / target, 1.0) ** 2
    print(f"\nat {target:.0%} at least {least:.3g} CPU s, ratio {least / sum(first):.3g} (bar 5)")


def noise(size: int, scatter: int, target: float) -> None:
    """What each part of the full picture costs and leaves at sixteen samples, in units of the
    whole's mean radiance: what falls with the root of the samples, as of walks, sets the price. By
    two seeds: over all pixels of the object, over all but the worst tenth, and the part of the
    squared noise that the worst hundredth has. The last column is what each picture alone would
    cost to the target error, where all pixels have as many samples."""
    bounces = 16
    parts: list[tuple[str, int, int, int]] = [
        ("order 1, no reflections", SINGLE, 0, 0),
        ("order 1, of the light", SINGLE, bounces, 0),
        ("order 1, of the camera, 2", SINGLE, 0, 2),
        ("order 1, of the camera", SINGLE, 0, bounces),
        ("order 1, of both", SINGLE, bounces, bounces),
        ("order 2 and more", SCATTERED & ~SINGLE, bounces, bounces),
        ("all", SCATTERED, bounces, bounces),
    ]
    rows = []
    for name, effects, light, camera in parts:
        first, second = (
            render(
                bumpy(),
                size,
                name="Combined",
                effects=effects,
                light_bounces=light,
                camera_bounces=camera,
                scatter_estimator=scatter,
                adjoint_normals=1,
                samples=16,
                seed=seed,
                threads=1,
            )
            for seed in (0, 1)
        )
        mask = (first.cover > 0) & (second.cover > 0)
        pair = [image.pixels[mask][:, :3].astype(np.float64) for image in (first, second)]
        squares = np.sort(((pair[0] - pair[1]) ** 2).mean(axis=-1) / 2)
        worst = squares[-max(len(squares) // 100, 1) :].sum() / squares.sum()
        most = float(np.sqrt(squares[: -max(len(squares) // 10, 1)].mean()))
        left, mean = float(np.sqrt(squares.mean())), float(np.mean(pair))
        cost = stage_cpu(first, ["field", "camera"])
        seconds = stage_cpu(first, ["camera"])
        needed = cost - seconds + seconds * (left / mean / target) ** 2
        rows.append((name, left, most, worst, mean, cost, needed))
    whole_mean = rows[-1][4]
    print(
        "| part | of the radiance | noise of 16 samples | but for a tenth | in 1 % | CPU s "
        f"| CPU s of {target:.0%} |"
    )
    print("|---|---|---|---|---|---|---|")
    for name, left, most, worst, mean, cost, needed in rows:
        print(
            f"| {name} | {mean / whole_mean:.2f} | {left / whole_mean:.3f} "
            f"| {most / whole_mean:.3f} | {worst:.0%} | {cost:.2f} | {needed:.3g} |"
        )
    ratio = rows[-1][6] / rows[0][6]
    print(f"\nall over order 1 without reflections, each to {target:.0%}: {ratio:.3g} (bar 5)")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["table", "flux", "speed", "full", "noise"])
    parser.add_argument("--runs", type=int, default=16, help="of the table and the flux")
    parser.add_argument("--size", type=int, default=64, help="of the full picture")
    parser.add_argument("--accuracy", type=float, default=0.02, help="of the full picture")
    parser.add_argument("--photons", action="store_true", help="later orders by them")
    parser.add_argument("--seconds", type=float, default=300.0, help="CPU, of a full picture")
    options = parser.parse_args()
    if options.what == "table":
        table(options.runs)
    elif options.what == "flux":
        flux(options.runs)
    elif options.what == "speed":
        speed()
    elif options.what == "noise":
        noise(options.size, PHOTONS if options.photons else WALK, options.accuracy)
    else:
        full(
            options.size,
            PHOTONS if options.photons else WALK,
            options.accuracy,
            options.seconds,
        )


if __name__ == "__main__":
    main()
