# SPDX-License-Identifier: GPL-3.0-or-later
"""Peak memory of a render of a large mesh: bench_memory.py [LEVEL [ESTIMATOR]].

An icosphere of 20 * 4^LEVEL triangles (default 9: 5.2 million), smooth, a lamp and 64 x 64 pixels;
ESTIMATOR is TUBES, POINTS_COVARIANCE or AUTO. Prints what the process held at most, and what the
library says of itself.
"""

from __future__ import annotations

import resource
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "images"))

import numpy as np
from api import ESTIMATORS, Medium, add_body, add_point, handles, library, set_perspective
from meshes import Mesh, icosphere, subdivide

MIB = 1 << 20


def sphere(level: int) -> Mesh:
    """Finer than ``icosphere``, one level at a time."""
    base = icosphere(min(level, 5))
    points, triangles = base.positions.astype(np.float64), base.triangles
    for _ in range(level - 5):
        points, triangles = subdivide(points, triangles)
        points /= np.linalg.norm(points, axis=1, keepdims=True)
    smooth = points.astype(np.float32)
    return Mesh(smooth, triangles.astype(np.uint32), smooth)


def peak() -> float:
    """MiB that the process held at most so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    level = int(sys.argv[1]) if len(sys.argv) > 1 else 9
    name = sys.argv[2] if len(sys.argv) > 2 else "AUTO"
    mesh = sphere(level)
    print(f"{len(mesh.triangles)} triangles, {peak():.0f} MiB before the library has them")
    with handles.Scene(library.load()) as scene:
        add_body(scene, mesh, Medium(1.5, 1.0, 0.1))
        add_point(scene, (2, -2, 3), 50)
        set_perspective(scene, (0, -4, 0), (0, 1, 0), (0, 0, 1), 0.6)
        del mesh
        scene.commit()
        estimator = ESTIMATORS.get(name, 0)
        with scene.start(width=64, height=64, samples=4, estimator=estimator) as job:
            job.wait()
            report = job.report()
    memory = {key: round(value / MIB) for key, value in report["memory"].items()}
    print(f"{report['estimator']}, MiB: {memory}")
    print(
        f"peak of the process: {peak():.0f} MiB, CPU s: "
        f"{sum(stage['cpu_s'] for stage in report['stages']):.1f}"
    )
    print(f"warnings: {[warning['text'] for warning in report['warnings']]}")


if __name__ == "__main__":
    main()
