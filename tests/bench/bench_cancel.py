# SPDX-License-Identifier: GPL-3.0-or-later
"""How long a render takes to end once it is cancelled, at random moments of it. Prints; never
asserts.

    python3 tests/bench/bench_cancel.py [COUNT]

Beside other work wall seconds tell what the machine gave; CPU seconds of the process from the call
to its return, of all threads, tell what there was still to do.
"""

from __future__ import annotations

import contextlib
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "images"))

import bench_caustics  # noqa: E402
from api import (  # noqa: E402
    ESTIMATORS,
    Medium,
    _ffi,
    add_body,
    add_point,
    errors,
    handles,
    library,
    set_perspective,
)
from bumpy import EYE, FOV, UP, bumpy  # noqa: E402
from meshes import bumpy_sphere  # noqa: E402
from ref_bumpy import bumpy_scene  # noqa: E402

BAR = 0.2
LATER = _ffi.AMB_EFFECT_DOUBLE_SCATTERING | _ffi.AMB_EFFECT_MULTIPLE_SCATTERING


def dense(handle: handles.Scene) -> None:
    case = bumpy_scene(bumpy_sphere(4))
    add_body(handle, case.mesh, Medium(1.5, 1000.0, 0.0, 0.0))
    add_point(handle, case.light, case.intensity)
    set_perspective(handle, (0.0, 0.0, EYE), (0.0, 0.0, -1.0), UP, FOV)


def scenes() -> dict:
    single = _ffi.AMB_EFFECT_SINGLE_SCATTERING
    found = {
        name: (bumpy(4), {"estimator": value, "effects": single})
        for name, value in ESTIMATORS.items()
    }
    photons = {"scatter_estimator": 2, "effects": LATER}
    found["photons"] = (bumpy(4), photons)
    found["walks"] = (bumpy(4), {"scatter_estimator": 1, "effects": LATER})
    found["dense photons"] = (dense, photons)
    found["dense walks"] = (dense, {"scatter_estimator": 1, "effects": LATER})
    caustics = {"effects": _ffi.AMB_EFFECT_CAUSTICS | single}
    found["caustics"] = (lambda handle: bench_caustics.build(handle, "bumpy"), caustics)
    found["AUTO"] = (bumpy(4), {"effects_are_auto": 1})
    return found


def cancel_after(scene: handles.Scene, settings: dict, seconds: float) -> tuple[float, float]:
    """Wall and CPU seconds from the call to the render's end."""
    with scene.start(**settings) as job:
        time.sleep(seconds)
        wall, used = time.perf_counter(), time.process_time()
        job.cancel()
        # It may have come to its end.
        with contextlib.suppress(errors.AmbCancelled):
            job.wait()
        return time.perf_counter() - wall, time.process_time() - used


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 500
    rng = np.random.default_rng(1)
    found = scenes()
    each = -(-count // len(found))
    print(f"{each} of each at random moments (bar: {BAR} s)")
    print(f"{'render':<20}{'wall s: median':>15}{'largest':>9}{'CPU s: median':>15}{'largest':>9}")
    for name, (build, given) in found.items():
        settings = {"width": 64, "height": 64, "samples": 64, "light_samples": 2**17} | given
        with handles.Scene(library.load()) as scene:
            build(scene)
            scene.commit()
            times = np.array(
                [cancel_after(scene, settings, rng.uniform(0.0, 0.6)) for _ in range(each)]
            )
        wall, used = times.T
        print(
            f"{name:<20}{np.median(wall):>15.3f}{wall.max():>9.3f}"
            f"{np.median(used):>15.3f}{used.max():>9.3f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
