# SPDX-License-Identifier: GPL-3.0-or-later
"""What one setting of one estimator costs, and how far its image is from the reference."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ..binding import _ffi
from .metrics import Errors

# The stages of the library's report; the first three are what table 4 of the paper calls
# preprocessing.
STAGES = ("scene", "light", "field", "camera")
PRECOMPUTED = STAGES[:3]

# The order of tables and legends.
ESTIMATORS = {
    "POINTS_FIXED": _ffi.AMB_ESTIMATOR_POINTS_FIXED,
    "POINTS_COVARIANCE": _ffi.AMB_ESTIMATOR_POINTS_COVARIANCE,
    "TUBES": _ffi.AMB_ESTIMATOR_TUBES,
    "SPECULAR": _ffi.AMB_ESTIMATOR_SPECULAR,
}
POINTS = ("POINTS_FIXED", "POINTS_COVARIANCE")


@dataclass(frozen=True)
class Setting:
    """An estimator and the budgets that belong to it; the others are 0."""

    estimator: str
    light_samples: int = 0
    kernel_size: float = 0.0
    tube_refinement: int = 0

    @property
    def budgets(self) -> dict[str, Any]:
        """Members of AmbRenderParams and names of scene.amberlight, without the estimator."""
        if self.estimator in POINTS:
            return {"light_samples": self.light_samples, "kernel_size": self.kernel_size}
        return {"tube_refinement": self.tube_refinement} if self.estimator == "TUBES" else {}

    @property
    def params(self) -> dict[str, Any]:
        """Members of AmbRenderParams."""
        return {"estimator": ESTIMATORS[self.estimator], **self.budgets}

    @property
    def budget(self) -> str:
        """The budgets in words."""
        if self.estimator in POINTS:
            return f"{self.light_samples} samples, kernel size {self.kernel_size:g}"
        return f"refinement {self.tube_refinement}" if self.estimator == "TUBES" else ""

    def __str__(self) -> str:
        return f"{self.estimator}, {self.budget}" if self.budget else self.estimator


@dataclass(frozen=True)
class Run:
    """One render: CPU seconds of each stage."""

    stages: dict[str, float]

    @property
    def total(self) -> float:
        return sum(self.stages.values())


@dataclass
class Row:
    """A setting with all its runs; their images are equal bit for bit."""

    setting: Setting
    elements: int  # volume samples or tubes that were made; 0: the estimator stores none
    field_bytes: int  # what the camera rays gather from
    light_bytes: int  # the light rays, which are freed before the camera begins
    nonfinite: int
    errors: Errors | None = None
    runs: list[Run] = field(default_factory=list)
    # False: the time cut off the sweep of kernels at this budget, so that it may not be the best.
    is_tuned: bool = True

    @property
    def run(self) -> Run:
        """The median run by total; of an even number the cheaper of the middle two."""
        return sorted(self.runs, key=lambda run: run.total)[(len(self.runs) - 1) // 2]

    @property
    def total(self) -> float:
        return self.run.total

    @property
    def precompute(self) -> float:
        return sum(self.run.stages[name] for name in PRECOMPUTED)

    @property
    def camera(self) -> float:
        return self.run.stages["camera"]

    def error(self, metric: str) -> float:
        """A member of Errors."""
        assert self.errors is not None, "measured after the reference"
        return float(getattr(self.errors, metric))


@dataclass(frozen=True)
class Missing:
    """What was left out and why."""

    what: str
    reason: str


def read_run(report: dict[str, Any], scene_once: float) -> Run:
    """CPU seconds of a report; building the scene is done once and charged to every render."""
    stages = dict.fromkeys(STAGES, 0.0)
    for stage in report.get("stages", ()):
        if stage["name"] in stages:
            stages[stage["name"]] += stage["cpu_s"]
    stages["scene"] += scene_once
    return Run(stages)


def read_row(setting: Setting, report: dict[str, Any], scene_once: float) -> Row:
    light, memory = report.get("light", {}), report.get("memory", {})
    return Row(
        setting,
        int(light.get("tubes", 0) or light.get("volume_samples", 0)),
        int(memory.get("field_bytes", 0)),
        int(memory.get("light_bytes", 0)),
        int(report.get("nonfinite", 0)),
        runs=[read_run(report, scene_once)],
    )
