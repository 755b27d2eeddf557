# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene whose estimators have known errors and costs, and a clock that they turn."""

import numpy as np
from amberlight.binding import _ffi
from amberlight.binding.errors import AmbUnsupported
from amberlight.cost.measurement import Measurement, Reference
from amberlight.cost.metrics import Errors
from amberlight.cost.rows import Row, Run, Setting

SIZE = 16
NAMES = {
    _ffi.AMB_ESTIMATOR_POINTS_FIXED: "POINTS_FIXED",
    _ffi.AMB_ESTIMATOR_POINTS_COVARIANCE: "POINTS_COVARIANCE",
    _ffi.AMB_ESTIMATOR_TUBES: "TUBES",
    _ffi.AMB_ESTIMATOR_SPECULAR: "SPECULAR",
}
TRUTH = np.full((SIZE, SIZE, 3), 2.0, np.float32)
# Of mean 0 and mean square 1: an image TRUTH + e NOISE has the relative error e / 2.
NOISE = np.where(np.indices(TRUTH.shape).sum(axis=0) % 2, 1.0, -1.0).astype(np.float32)
BEST_KERNEL = {"POINTS_FIXED": 0.5, "POINTS_COVARIANCE": 2.0}


def render_params(**more):
    return {
        "width": SIZE, "height": SIZE, "samples": 4, "seed": 7,
        "effects": _ffi.AMB_EFFECT_SINGLE_SCATTERING | _ffi.AMB_EFFECT_BACKGROUND, **more,
    }  # fmt: skip


class Clock:
    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


class StubScene:
    """`refused`: {estimator: message}; `speed`: seconds of the clock for a second of CPU time;
    `less`: estimators that leave out an effect. `started` has the params of every render."""

    def __init__(self, clock, refused=(), speed=1.0, less=(), truth=TRUTH):
        self.clock, self.refused, self.speed = clock, dict(refused), speed
        self.less, self.truth = less, truth
        self.started = []

    def start(self, **params):
        self.started.append(params)
        return StubRender(self, params)


class StubRender:
    def __init__(self, scene, params):
        self.scene, self.params = scene, params
        self.is_open = True
        self.name = NAMES[params["estimator"]] if params["effects"] else ""
        if self.name in scene.refused:
            raise AmbUnsupported(scene.refused[self.name])
        self.rest = scene.speed * sum(self.stages().values())

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.is_open = False

    def wait(self, timeout):
        """Half of the render passes with each look."""
        step = max(self.rest / 2, 1e-3)
        self.scene.clock.now += step
        self.rest -= step
        return self.rest <= 1e-3

    def stages(self):
        p = self.params
        if not self.name:
            return {"scene": 0.25, "camera": 0.1}
        if self.name == "TUBES":
            return {"scene": 0.01, "field": 0.1 * 4 ** p["tube_refinement"],
                    "camera": 0.2 * 2 ** p["tube_refinement"]}  # fmt: skip
        if self.name == "SPECULAR":
            rays = p["width"] * p["height"] * p["samples"]
            return {"scene": 0.01, "camera": 50.0 * rays / (4 * SIZE**2)}
        count = p["light_samples"] / 8192
        return {"scene": 0.01, "light": 0.1 * count, "field": 0.1 * count,
                "camera": 0.2 * count**0.5}  # fmt: skip

    def error(self):
        """Added to TRUTH in a pattern."""
        p = self.params
        if self.name == "TUBES":
            return 0.08 * 4.0 ** -p["tube_refinement"]
        if self.name == "SPECULAR":
            return 1e-3
        kernel = abs(np.log2(p["kernel_size"] / BEST_KERNEL[self.name]))
        return (
            (0.4 if self.name == "POINTS_FIXED" else 0.2)
            * (1 + kernel)
            * (p["light_samples"] / 8192) ** -0.5
        )

    def read_pass(self, name):
        if not self.name:
            return np.ones_like(TRUTH) if name == "Surface" else np.zeros_like(TRUTH)
        return self.scene.truth + np.float32(self.error()) * NOISE * (self.scene.truth > 0)

    def report(self):
        names = ["single scattering", "light through other objects"]
        skipped = names[1] if self.name in self.scene.less else ""
        elements = 0 if self.name in {"", "SPECULAR"} else self.params.get("light_samples", 100)
        return {
            "threads": 2, "nonfinite": 0,
            "effects": [{"name": n, "simulated": n != skipped, "reason": ""} for n in names],
            "stages": [{"name": n, "cpu_s": s} for n, s in self.stages().items()],
            "memory": {"field_bytes": 72 * elements, "light_bytes": 24 * elements},
            "light": {"volume_samples": elements},
        }  # fmt: skip


def make_row(estimator, total, error, runs=1, **budget):
    """A row whose time is halved between field and camera, and whose errors are all `error`."""
    stages = {"scene": 0.0, "light": 0.0, "field": total / 2, "camera": total / 2}
    errors = Errors(error**2, error, error, (1.0, 1.0, 1.0), error)
    return Row(Setting(estimator, **budget), 100, 7200, 2400, 0, errors, [Run(stages)] * runs)


def measurement(rows, **more):
    """What a sweep of these rows would have left."""
    values = {
        "name": "stub", "width": SIZE, "height": SIZE, "samples": 4, "metric": "rel_rmse",
        "reference": Reference("TUBES, refinement 4", (TRUTH,), None, 1e-3, "known"),
        "rows": rows, "rays": [0.1, 0.2, 0.1], "mean": 2.0, "coverage": 1.0, "threads": 2,
        "image": lambda setting: TRUTH + np.float32(0.01) * NOISE,
    }  # fmt: skip
    return Measurement(**{**values, **more})
