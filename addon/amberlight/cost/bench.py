# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders one scene with one setting after the other, keeps rows and images, and minds the time.

All renders share their camera rays: the same seed, samples and size, so that errors show the
estimator and not the sampling of pixels. Only single scattering is rendered, in which alone the
estimators differ. What a render needs of the machine is the library's own account.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..binding import _ffi
from ..binding.errors import AmberlightError, AmbUnsupported
from . import metrics
from .measurement import Reference
from .references import ImageReference
from .rows import Missing, Row, Setting, read_row, read_run

PASS = "Single Scattering"
EFFECTS = _ffi.AMB_EFFECT_SINGLE_SCATTERING | _ffi.AMB_EFFECT_TRANSMITTED_LIGHT
LEVELS = tuple(2**k for k in range(13, 24, 2))
POLL_SECONDS = 0.05
# A probe has a pixel for so many by so many.
PROBE_DIVISOR = 8
OUT_OF_TIME = "the time limit"


@dataclass(frozen=True)
class Options:
    """`time_limit` in seconds, 0 for none; `metric`: the error that the kernels are tuned for and
    that equal error means; `reference`: an image from elsewhere."""

    time_limit: float = 300.0
    repeats: int = 3
    metric: str = "rel_rmse"
    reference: ImageReference | None = None
    levels: tuple[int, ...] = LEVELS


@dataclass(frozen=True)
class Status:
    """For a progress bar: `fraction` in [0,1], one line, rows so far."""

    fraction: float
    text: str
    row_count: int


@dataclass(frozen=True)
class Shot:
    """A finished render."""

    pixels: NDArray[np.float32]
    report: dict[str, Any]
    wall: float


def simulated(report: dict[str, Any]) -> frozenset[str]:
    return frozenset(e["name"] for e in report.get("effects", ()) if e["simulated"])


Steps = Generator[Status, None, Any]
Self = TypeVar("Self", bound="Bench")


class Bench:
    """A context manager, whose end takes the images away. `scenes`: see open_scenes."""

    def __init__(
        self,
        scenes: tuple[Any, Any],
        name: str,
        params: dict[str, Any],
        options: Options,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.scene, self.twin = scenes
        self.name = name
        self.options = options
        # All that the estimators share; a part of the image would cost more of the precomputation.
        self.params = {
            **params,
            "effects": params["effects"] & EFFECTS,
            "film_transparent": 1,
            **dict.fromkeys(("crop_x", "crop_y", "crop_width", "crop_height"), 0),
        }
        self.clock = clock
        self.begin = clock()
        self.rows: dict[Setting, Row] = {}
        self.walls: dict[Setting, float] = {}
        self.reports: dict[Setting, dict[str, Any]] = {}
        self.rays: list[float] = []
        self.missing: list[Missing] = []
        self.notes: list[str] = []
        self.scene_once = 0.0
        self.threads = 0
        self.paths: frozenset[str] = frozenset()
        self.mask: NDArray[np.bool_] = np.zeros((0, 0), bool)
        self.coverage = 0.0
        self.reference: Reference | None = None
        self.text = "starting"
        self._folder = tempfile.TemporaryDirectory(prefix="amberlight_cost_")

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._folder.cleanup()

    # ---- Time ------------------------------------------------------------------------------------

    @property
    def elapsed(self) -> float:
        return self.clock() - self.begin

    def _fits(self, seconds: float, share: float = 1.0) -> bool:
        """Whether a render that takes so long may begin."""
        limit = self.options.time_limit
        return limit <= 0.0 or self.elapsed + seconds <= share * limit

    def _status(self) -> Status:
        limit = self.options.time_limit
        # Without a limit: the rows of an ordinary sweep.
        share = self.elapsed / limit if limit > 0.0 else len(self.rows) / 60
        return Status(min(share, 1.0), self.text, len(self.rows))

    # ---- Renders ---------------------------------------------------------------------------------

    def _render(
        self, scene: Any, params: dict[str, Any], text: str, *, pass_name: str = PASS,
        is_needed: bool = False, most: float = 0.0,
    ) -> Steps:  # fmt: skip
        """A Shot; None if the time ran out, or `most` seconds, unless the render is needed."""
        begin = self.clock()
        self.text = text
        with scene.start(**{**self.params, **params}) as render:
            while not render.wait(POLL_SECONDS):
                is_late = not self._fits(0.0) or 0.0 < most < self.clock() - begin
                if is_late and not is_needed:
                    return None
                yield self._status()
            return Shot(render.read_pass(pass_name), render.report(), self.clock() - begin)

    def _cover(self) -> Steps:
        """The pixels that count."""
        shot = yield from self._render(
            self.twin, {"effects": 0}, "coverage", pass_name="Surface", is_needed=True
        )
        seen = shot.pixels[..., 0]
        self.mask = seen > 0.0
        self.coverage = float(np.mean(self.mask))
        if not self.mask.any():
            raise AmberlightError("there is nothing to measure: no translucent object is in view")

    def _rays(self, is_needed: bool = False) -> Steps:
        """The camera rays alone: to the boundary, refracted, on to the far side, no gather."""
        shot = yield from self._render(
            self.scene, {"effects": 0}, "camera rays alone", is_needed=is_needed
        )
        if shot is None:
            return
        run = read_run(shot.report, 0.0)
        if not self.rays:
            # The first render of a scene builds it.
            self.scene_once = run.stages["scene"]
            self.threads = int(shot.report.get("threads", 0))
        self.rays.append(run.stages["camera"])

    def _measure(self, setting: Setting, *, is_needed: bool = False, most: float = 0.0) -> Steps:
        """The row of a setting, measured now if it was not yet; None if the time ran out."""
        if setting in self.rows:
            return self.rows[setting]
        shot = yield from self._render(
            self.scene, setting.params, str(setting), is_needed=is_needed, most=most
        )
        if shot is None:
            self.missing.append(Missing(str(setting), OUT_OF_TIME))
            return None
        row = read_row(setting, shot.report, self.scene_once)
        np.save(self._path(setting), shot.pixels)
        self.rows[setting] = row
        self.walls[setting] = shot.wall
        self.reports[setting] = shot.report
        self._compare_paths(setting)
        if self.reference is not None:
            self._judge(row)
        return row

    def _probe(self, setting: Setting, most: float) -> Steps:
        """The wall seconds that a setting will take, from an image of a few of its rays; None if
        even that takes more than `most`."""
        width, height, samples = (self.params[name] for name in ("width", "height", "samples"))
        few = {
            "width": max(width // PROBE_DIVISOR, 1),
            "height": max(height // PROBE_DIVISOR, 1),
            "samples": 1,
        }
        shot = yield from self._render(
            self.scene, {**setting.params, **few}, f"{setting}, a few rays", most=most
        )
        if shot is None:
            return None
        run = read_run(shot.report, 0.0)
        times = width * height * samples / (few["width"] * few["height"])
        # So few rays are no work for all threads: how many the machine gives a long render tells
        # wall seconds from CPU seconds.
        longest = max(self.rows, key=lambda known: self.walls[known])
        spent = self.rows[longest].runs[0].total - self.scene_once
        share = self.walls[longest] / max(spent, 1e-9)
        return share * (run.total + (times - 1.0) * run.stages["camera"])

    def _refuse(self, estimator: str, error: AmbUnsupported) -> None:
        """An estimator that cannot render the scene is a line of the report."""
        cannot = "cannot render this: "
        reason = error.message.removeprefix(f"estimator {estimator} ").removeprefix(cannot)
        self.missing.append(Missing(estimator, cannot + reason))

    def _compare_paths(self, setting: Setting) -> None:
        """What an estimator leaves out that points simulate is said."""
        less = sorted(self.paths - simulated(self.reports[setting]))
        if less:
            note = f"{setting.estimator} leaves out {', '.join(less)}: its error contains that"
            if note not in self.notes:
                self.notes.append(note)

    def _has_all_paths(self, estimator: str) -> bool:
        return not any(note.startswith(f"{estimator} leaves out") for note in self.notes)

    # ---- Images ----------------------------------------------------------------------------------

    def _path(self, setting: Setting) -> Path:
        name = "_".join(str(value) for value in (setting.estimator, *setting.budgets.values()))
        return Path(self._folder.name) / f"{name}.npy"

    def image(self, setting: Setting) -> NDArray[Any]:
        return np.asarray(np.load(self._path(setting)))

    def _known_reference(self) -> Reference:
        assert self.reference is not None
        return self.reference

    def _judge(self, row: Row) -> None:
        images = self._known_reference().images
        row.errors = metrics.errors(self.image(row.setting), images, self.mask)

    def _difference(self, a: Setting, b: Setting) -> float:
        errors = metrics.errors(self.image(a), [self.image(b)], self.mask)
        return float(getattr(errors, self.options.metric))

    def _part(self, share: float) -> float:
        """Seconds of a share of the limit; 0 without a limit."""
        return max(share * self.options.time_limit, 0.0)

    def _repeat(self, row: Row) -> Steps:
        text = f"{row.setting}, run {len(row.runs) + 1}"
        shot = yield from self._render(self.scene, row.setting.params, text)
        if shot is not None:
            row.runs.append(read_run(shot.report, self.scene_once))
