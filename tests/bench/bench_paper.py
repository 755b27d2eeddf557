# SPDX-License-Identifier: GPL-3.0-or-later
"""Table 4 of [Liang19] with our columns. Prints markdown; never asserts.

    python3 tests/bench/bench_paper.py [--meshes DIR] [--time-limit 300] [SETTING=VALUE ...]

Measures what accuracy costs (`./amberlight cost`) in the paper's scenes and their stand-ins, and
sets one row of covariance points beside fixed points of equal time and of equal quality, as the
paper does; then tubes and exact connections, which the paper does not have in this form. Between
two measured rows of an estimator's front logarithms are interpolated. DIR has bunny.obj and
buddha.obj, which are not in this repository; without them their scenes are left out.
"""

from __future__ import annotations

import argparse
import csv
import math
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SCENES = ("bumpy_sphere", "bunny", "buddha", "oil", "suzanne")
FROM_MESH = ("bunny", "buddha")
# What the paper measures: light that scatters once, without internal reflections.
SETTINGS = ("effects=MANUAL", "light_bounces=0", "camera_bounces=0")

# [Liang19] table 4: fixed points of equal quality over covariance points: samples, bytes, time.
PRINTED = {
    "bumpy_sphere": (15.51 / 4.19, 1800 / 507.6, 81.14 / 26.47),
    "bunny": (12.08 / 3.94, 1400 / 481.4, 69.20 / 37.71),
    "buddha": (21.99 / 7.34, 2600 / 896.5, 123.18 / 53.14),
    "oil": (71.88 / 10.88, 8600 / 1331.2, 1966.53 / 932.15),
}


@dataclass(frozen=True)
class Place:
    """A row, or a place between two of them."""

    samples: float
    megabytes: float
    precompute: float  # CPU seconds
    render: float
    mse: float
    rel_rmse: float

    @property
    def total(self) -> float:
        return self.precompute + self.render


def read_front(path: Path, estimator: str) -> list[Place]:
    with path.open() as file:
        rows = [
            row
            for row in csv.DictReader(file)
            if row["estimator"] == estimator and row["on_front"] == "1" and row["role"] == "row"
        ]
    places = [
        Place(
            float(row["elements"] or "nan"),
            float(row["field_bytes"]) / 1e6,
            float(row["precompute_cpu_s"]),
            float(row["camera_cpu_s"]),
            float(row["mse"]),
            float(row["rel_rmse"]),
        )
        for row in rows
    ]
    return sorted(places, key=lambda place: place.total)


def between(a: Place, b: Place, part: float) -> Place:
    values = [
        math.exp((1 - part) * math.log(x) + part * math.log(y))
        for x, y in zip(vars(a).values(), vars(b).values(), strict=True)
    ]
    return Place(*values)


def at(front: list[Place], name: str, target: float) -> Place | None:
    """Where a quantity that falls (an error) or rises (the total) crosses the target."""
    for a, b in pairwise(front):
        x, y = (math.log(getattr(place, name) / target) for place in (a, b))
        if x * y <= 0 and x != y:
            return between(a, b, x / (x - y))
    return None


def line(what: str, place: Place | None) -> str:
    if place is None:
        return f"| {what} | not reached | | | | | | |"
    return (
        f"| {what} | {place.samples / 1e3:.4g} | {place.megabytes:.3g} | {place.precompute:.3g} "
        f"| {place.render:.3g} | {place.total:.3g} | {place.mse:.2e} "
        f"| {100 * place.rel_rmse:.2f} % |"
    )


def print_scene(name: str, path: Path) -> str:
    fronts = {
        estimator: read_front(path, estimator)
        for estimator in ("POINTS_FIXED", "POINTS_COVARIANCE", "TUBES", "SPECULAR")
    }
    fixed, covariance = fronts["POINTS_FIXED"], fronts["POINTS_COVARIANCE"]
    print(f"\n## {name}\n")
    if not fixed or not covariance:
        print("Too little time: raise --time-limit.")
        return ""
    # The best that both reach.
    least = max(min(place.rel_rmse for place in front) for front in (fixed, covariance))
    ours = at(covariance, "rel_rmse", least) or covariance[-1]
    quality, time = at(fixed, "rel_rmse", ours.rel_rmse), at(fixed, "total", ours.total)
    quality = quality or next((p for p in fixed if p.rel_rmse <= ours.rel_rmse * 1.0001), None)
    print("| | samples, 10^3 | MB | precompute s | render s | total s | MSE | `rel_rmse` |")
    print("|---|---|---|---|---|---|---|---|")
    print(line("POINTS_FIXED, equal time", time))
    print(line("POINTS_FIXED, equal quality", quality))
    print(line("POINTS_COVARIANCE", ours))
    for estimator in ("TUBES", "SPECULAR"):
        for place in fronts[estimator]:
            print(line(estimator, place))
    sys.stdout.flush()
    if quality is None:
        return ""
    ratios = [quality.samples / ours.samples, quality.megabytes / ours.megabytes,
              quality.total / ours.total]  # fmt: skip
    shown = " | ".join(f"{ratio:.2f}" for ratio in ratios)
    printed = " | ".join(f"{ratio:.2f}" for ratio in PRINTED[name]) if name in PRINTED else " |  | "
    return f"| {name} | {shown} | {printed} |"


def make_scene(name: str, meshes: Path | None, folder: Path) -> Path | None:
    if name not in FROM_MESH:
        return ROOT / f"scenes_blend/{name}.blend"
    mesh = meshes / f"{name}.obj" if meshes is not None else None
    if mesh is None or not mesh.is_file():
        return None
    out = folder / f"{name}.blend"
    command = ["blender", "-b", "--factory-startup", "--python-exit-code", "1", "--python",
               f"scenes_blend/build_{name}.py", "--", str(mesh), str(out)]  # fmt: skip
    subprocess.run([str(ROOT / "amberlight"), *command], cwd=ROOT, check=True, capture_output=True)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--meshes", type=Path, help="folder of bunny.obj and buddha.obj")
    parser.add_argument("--time-limit", type=float, default=300, help="seconds a scene")
    parser.add_argument("--scenes", nargs="*", choices=SCENES, default=SCENES)
    parser.add_argument("settings", nargs="*", help="SETTING=VALUE of ./amberlight cost")
    arguments = parser.parse_args()
    ratios = []
    with tempfile.TemporaryDirectory() as folder:
        for name in arguments.scenes:
            blend = make_scene(name, arguments.meshes, Path(folder))
            if blend is None:
                print(f"\n## {name}\n\nLeft out: its mesh is not here.")
                continue
            out = Path(folder) / name
            command = [str(ROOT / "amberlight"), "cost", str(blend), "-o", str(out),
                       f"time_limit={arguments.time_limit:g}",
                       *SETTINGS, *arguments.settings]  # fmt: skip
            subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
            ratios.append(print_scene(name, out / "cost.csv"))
    print("\n## POINTS_FIXED of equal quality over POINTS_COVARIANCE, ours and in print\n")
    print("| scene | samples | bytes | time | samples in print | bytes in print | time in print |")
    print("|---|---|---|---|---|---|---|")
    print("\n".join(line for line in ratios if line))


if __name__ == "__main__":
    main()
