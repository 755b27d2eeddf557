# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes orders.json: radiance by order of scattering, by the independent path tracer.

For each shape and optical radius the tracer's own answer for 2 x 2 regions of the picture: means
and standard errors of the orders 0, 1, 2, 3, 4 and up, and 1 and up. Takes half an hour of one
processor. Needs the tracer, which comes with the C tests:

    cmake --preset dev && cmake --build build/dev --target order_tracer
    python3 tests/images/references/make_orders.py [--paths 8e6] [--threads 1] [SCENE ...]
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

from order_scenes import RADII, reference_scene, trace  # noqa: E402

FILE = HERE / "orders.json"
NAMES = [f"{shape} {radius:g}" for radius in RADII for shape in ("sphere", "slab", "bumpy")]


def rounded(values: list[float]) -> list[float]:
    """More digits than the errors have would only lengthen the file."""
    return [float(f"{value:.6g}") for value in values]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--paths", type=float, default=8e6, help="paths in each region")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help="'sphere 2'; none: all")
    options = parser.parse_args()
    stored = json.loads(FILE.read_text()) if FILE.is_file() else {}
    for name in options.scenes or NAMES:
        shape, radius = name.split()
        scene = reference_scene(shape, float(radius))
        data = trace(scene, options.paths, threads=options.threads).data
        for region in data["regions"]:
            region.update({key: rounded(region[key]) for key in ("mean", "error")})
        stored[name] = {"paths": data["paths"], "lost": data["lost"], "regions": data["regions"]}
        ordered = {key: stored[key] for key in NAMES if key in stored}
        FILE.write_text(json.dumps(ordered, indent=1) + "\n")
        print(f"{name}: {data['cpu_seconds']:.0f} CPU s", flush=True)


if __name__ == "__main__":
    main()
