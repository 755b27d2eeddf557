#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""What AUTO takes for the committed scenes, and how much noise it leaves. Prints; never asserts.

    python3 tests/bench/bench_scenes.py [--scale 0.1] [--samples 16] [--reference 128]
                                        [--before LIBRARY] [SCENE ...]

Blender exports each scene once (kept under build/bench); all renders are of the C library then, on
one thread. The reference is the same scene with many samples and another seed. Error: the root of
the mean squared difference over the mean of the reference, whole pictures, its own noise included;
99.9 %: of the absolute differences in all pixels and channels, in the same unit, which fireflies
show in. Efficiency: 1 / (CPU seconds of the camera's samples times error^2). With --before the same
of an older build of the library, and how much more efficient this one is.
"""

from __future__ import annotations

import argparse
import json
import os
import pickle
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[2]
BUILT = ROOT / "build/release/lib/libamberlight.so"
KEPT = ROOT / "build/bench"
SCENES = ("still_life", "caustics")
SEED, REFERENCE_SEED = 1, 1000
Image = NDArray[np.float64]


def export(name: str) -> Path:
    """What the add-on makes of the scene."""
    blend, kept = ROOT / f"scenes_blend/{name}.blend", KEPT / f"{name}.pickle"
    if not kept.exists() or kept.stat().st_mtime < blend.stat().st_mtime:
        KEPT.mkdir(parents=True, exist_ok=True)
        command = [str(ROOT / "amberlight"), "blender", "-b", str(blend), "--python-exit-code", "1"]
        command += ["--python", str(Path(__file__).with_name("export_blend.py")), "--", str(kept)]
        subprocess.run(command, check=True, capture_output=True)
    return kept


def render(kept: str, out: str, changed: str) -> None:
    """In a process of its own, which has loaded one library: a picture and the report."""
    sys.path.insert(0, str(ROOT / "addon"))
    from amberlight.binding import handles, library
    from amberlight.export.upload import upload

    data, params = pickle.loads(Path(kept).read_bytes())
    change = json.loads(changed)
    scale = change.pop("scale")
    size = {name: max(round(params[name] * scale), 1) for name in ("width", "height")}
    with handles.Scene(library.load()) as scene:
        upload(data, scene)
        scene.commit()
        with scene.start(**(params | size | {"threads": 1} | change)) as job:
            job.wait()
            np.save(out, job.read_pass("Combined")[..., :3].astype(np.float64))
            Path(out).with_suffix(".json").write_text(json.dumps(job.report()))


def run(name: str, built: Path, **changed: Any) -> tuple[Image, dict[str, Any]]:
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "picture.npy"
        command = [sys.executable, __file__, "--render", str(export(name)), str(out)]
        environment = os.environ | {"AMBERLIGHT_LIBRARY": str(built)}
        subprocess.run([*command, json.dumps(changed)], check=True, env=environment)
        return np.load(out), json.loads(out.with_suffix(".json").read_text())


def measure(name: str, built: Path, truth: Image, **changed: Any) -> float:
    """A row of the table; returns the efficiency."""
    picture, report = run(name, built, seed=SEED, **changed)
    cpu = {stage["name"]: stage["cpu_s"] for stage in report["stages"]}
    difference = np.abs(picture - truth) / truth.mean()
    error = float(np.sqrt(np.mean(difference**2)))
    samples = picture.shape[0] * picture.shape[1] * changed["samples"]
    bias = picture.mean() / truth.mean() - 1
    print(
        f"| {name} | {built.name} | {1e6 * cpu['camera'] / samples:.1f} | "
        f"{sum(cpu.values()) - cpu['camera']:.2f} | {error:.2%} | {bias:+.2%} | "
        f"{np.percentile(difference, 99.9):.3f} |",
        flush=True,
    )
    return 1.0 / (cpu["camera"] * error**2)


def main() -> None:
    if sys.argv[1:2] == ["--render"]:
        render(*sys.argv[2:])
        return
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", default=SCENES)
    parser.add_argument("--scale", type=float, default=0.1)
    parser.add_argument("--samples", type=int, default=16)
    parser.add_argument("--reference", type=int, default=128)
    parser.add_argument("--before", type=Path)
    options = parser.parse_args()
    print("| scene | library | camera, us a sample | before it, s | error | mean | 99.9 % |")
    print("|---|---|---|---|---|---|---|")
    for name in options.scenes:
        kept = KEPT / f"{name}_{options.scale:g}_{options.reference}.npy"
        if not kept.exists():
            picture, _ = run(
                name, BUILT, seed=REFERENCE_SEED, samples=options.reference, scale=options.scale
            )
            np.save(kept, picture)
        truth = np.load(kept)
        change = {"samples": options.samples, "scale": options.scale}
        efficiency = measure(name, BUILT, truth, **change)
        if options.before:
            ratio = efficiency / measure(name, options.before.resolve(), truth, **change)
            print(f"\n{name}: {ratio:.1f} times as efficient as {options.before}\n")


if __name__ == "__main__":
    main()
