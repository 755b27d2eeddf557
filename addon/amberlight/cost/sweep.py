# SPDX-License-Identifier: GPL-3.0-or-later
"""Which settings are rendered, and in which order, as long as the time allows.

The finest tubes that fit are the reference; where tubes cannot render the scene, specular
connections, else the largest number of points. Then the kernels of the point estimators are swept
at each budget, so that each is played at its best, and what is left of the time goes into repeats.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..binding.errors import AmberlightError, AmbUnsupported
from . import curve
from .bench import OUT_OF_TIME, Bench, Steps, simulated
from .measurement import Measurement, Reference
from .rows import POINTS, Missing, Setting

KERNELS = tuple(2.0**k for k in range(-5, 7))
FIRST_KERNEL = 4.0
REFINEMENTS = (0, 1, 2, 3, 4)
# Measured last: they are cheap, and no reference.
COARSE_REFINEMENTS = (-1, -2)
# Where an image from elsewhere is the reference, tubes need not be finer than this.
REFINEMENT_MAX = 3
# The kernel of points that are the reference: small, for little bias.
REFERENCE_KERNEL = 2.0

# Shares of the time limit until which the reference and the sweep may begin another render; the
# rest is for repeats, which make medians of single runs, where they are wanted.
REFERENCE_SHARE = 0.35
SWEEP_SHARE = 0.85
SPECULAR_SHARE, PROBE_SHARE = 0.25, 0.05
# Of one render of points as the reference: their rows, of a quarter of its samples and less with
# some kernels each, take twice as long as it.
POINTS_SHARE = 0.3
# What a four times larger budget costs at most, and tubes where that is not known yet.
GROWTH_MAX, TUBE_GROWTH = 4.0, 3.0
# Tubes that would take more memory than this are not tried.
TUBE_BYTES_MAX = 2 * 2**30


class Sweep(Bench):
    """`run` renders, step by step, and leaves `measurement`."""

    measurement: Measurement | None = None

    def run(self) -> Steps:
        """Yields some twenty times a second; closing the generator cancels."""
        yield from self._cover()
        yield from self._rays(is_needed=True)
        yield from self._first_row()
        yield from self._tubes()
        yield from self._find_reference()
        for row in self.rows.values():
            self._judge(row)
        if not self._is_tried("SPECULAR"):
            yield from self._specular(SPECULAR_SHARE)
        yield from self._coarse_tubes()
        yield from self._sweep_points()
        yield from self._repeats()
        self.measurement = self._result()

    @property
    def _sweep_share(self) -> float:
        return SWEEP_SHARE if self.options.repeats > 1 else 1.0

    def _is_tried(self, estimator: str) -> bool:
        """Whether it has a row, is the reference or is known to be missing."""
        reference = self._known_reference().row
        tried = {setting.estimator for setting in self.rows}
        tried |= {item.what for item in self.missing}
        return estimator in tried or (
            reference is not None and reference.setting.estimator == estimator
        )

    def _result(self) -> Measurement:
        reference = self._known_reference()
        return Measurement(
            self.name,
            self.params["width"],
            self.params["height"],
            self.params["samples"],
            self.options.metric,
            reference,
            list(self.rows.values()),
            self.rays,
            self.image,
            self.coverage,
            float(np.mean(reference.image[self.mask], dtype=np.float64)),
            self.missing,
            self.notes,
            self.threads,
            self.clock() - self.begin,
        )

    # ---- Reference -------------------------------------------------------------------------------

    def _first_row(self) -> Steps:
        """Points can render every scene: they tell which paths there are."""
        setting = Setting("POINTS_COVARIANCE", self.options.levels[0], FIRST_KERNEL)
        yield from self._measure(setting, is_needed=True)
        report = self.reports[setting]
        for effect in report.get("effects", ()):
            if effect["name"] == "single scattering" and not effect["simulated"]:
                raise AmberlightError(f"there is nothing to measure: {effect['reason']}")
        self.paths = simulated(report)
        if not self.image(setting)[self.mask].any():
            raise AmberlightError("there is nothing to measure: no light that scatters is in view")

    def _tubes(self) -> Steps:
        """Rising refinements; the finest may become the reference."""
        has_reference = self.options.reference is not None
        last: list[float] = []
        for refinement in REFINEMENTS[: REFINEMENT_MAX + 1] if has_reference else REFINEMENTS:
            setting = Setting("TUBES", tube_refinement=refinement)
            growth = last[-1] / last[-2] if len(last) > 1 else TUBE_GROWTH
            predicted = last[-1] * min(max(growth, 2.0), GROWTH_MAX) if last else 0.0
            memory = GROWTH_MAX * self.rows[_coarser(setting)].field_bytes if last else 0
            if len(last) > 1 and not self._has_all_paths("TUBES"):
                # What they leave out is all of their error.
                return
            if memory > TUBE_BYTES_MAX or not self._fits(predicted, REFERENCE_SHARE):
                reason = "memory" if memory > TUBE_BYTES_MAX else OUT_OF_TIME
                self.missing.append(Missing(f"TUBES from refinement {refinement} on", reason))
                return
            try:
                row = yield from self._measure(setting)
            except AmbUnsupported as error:
                self._refuse("TUBES", error)
                return
            if row is None:
                return
            last.append(self.walls[setting])

    def _coarse_tubes(self) -> Steps:
        is_missing = "TUBES" in {item.what for item in self.missing}
        if self._is_tried("TUBES") and not is_missing and self._has_all_paths("TUBES"):
            for refinement in COARSE_REFINEMENTS:
                yield from self._measure(Setting("TUBES", tube_refinement=refinement))

    def _find_reference(self) -> Steps:
        given = self.options.reference
        if given is not None:
            about = "from elsewhere: errors contain the sampling of the pixels of both images"
            self.reference = Reference(given.name, given.images, about=about)
            return
        tubes = [setting for setting in self.rows if setting.estimator == "TUBES"]
        if tubes and self._has_all_paths("TUBES"):
            self._take_reference(tubes, "the next coarser tubes differ from it by")
            return
        row = yield from self._specular(REFERENCE_SHARE)
        if row is not None and self._has_all_paths("SPECULAR"):
            self._take_reference([row.setting], "")
        else:
            yield from self._points_reference()

    def _points_reference(self) -> Steps:
        """As many points as the time allows."""
        settings: list[Setting] = []
        limit = self._part(POINTS_SHARE)
        for level in self.options.levels:
            setting = Setting("POINTS_COVARIANCE", level, REFERENCE_KERNEL)
            predicted = GROWTH_MAX * self.walls[settings[-1]] if settings else 0.0
            fits = self._fits(predicted, self._sweep_share) and not 0.0 < limit < predicted
            if len(settings) > 1 and not fits:
                break
            row = yield from self._measure(setting)
            if row is None:
                break
            settings.append(setting)
        if len(settings) < 2:
            raise AmberlightError(
                f"{self.options.time_limit:g} s are too short for a reference: raise the time "
                "limit, or lower the size or the samples"
            )
        self._take_reference(settings, "a quarter of its samples differ from it by")

    def _take_reference(self, settings: list[Setting], words: str) -> None:
        """The last of `settings`, which rise in accuracy, leaves the rows and becomes the
        reference."""
        setting = settings[-1]
        own, about = None, "its own error is not known"
        if len(settings) > 1:
            step = self._difference(settings[-2], setting)
            own = step
            about = f"{words} {curve.percent(step)} {self.options.metric}"
        if len(settings) > 2:
            # Errors e, q e, q^2 e of three settings that approach one image from one side differ
            # by (q - 1) e and (q^2 - 1) e.
            ratio = self._difference(settings[-3], setting) / step - 1.0 if step > 0.0 else 0.0
            if ratio > 1.0:
                own = step / (ratio - 1.0)
                about += f", its own error by extrapolation is {curve.percent(own)}"
        row = self.rows.pop(setting)
        self.reference = Reference(str(setting), (self.image(setting),), row, own, about)

    # ---- Rows ------------------------------------------------------------------------------------

    def _specular(self, share: float) -> Steps:
        """The one row of SPECULAR, if it fits into a share of the time; a picture of few rays
        tells beforehand."""
        setting = Setting("SPECULAR")
        try:
            seconds = yield from self._probe(setting, self._part(PROBE_SHARE))
            limit = self._part(share)
            if seconds is not None and (limit <= 0.0 or seconds <= limit):
                return (yield from self._measure(setting, most=limit))
            about = "" if seconds is None else f", it would take some {seconds:.0f} s"
            self.missing.append(Missing("SPECULAR", OUT_OF_TIME + about))
        except AmbUnsupported as error:
            self._refuse("SPECULAR", error)
        return None

    def _sweep_points(self) -> Steps:
        tuned = yield from self._rounds()
        for setting, row in self.rows.items():
            level = (setting.estimator, setting.light_samples)
            row.is_tuned = setting.estimator not in POINTS or level in tuned

    def _rounds(self) -> Steps:
        """Each estimator of points at each level, small ones first: what the time cuts off is the
        most expensive, for both alike. The pairs whose kernels were swept to the end."""
        row = self._known_reference().row
        # Points that share a large part of the reference's own would look too good.
        most = row.setting.light_samples / 4 if row and row.setting.light_samples else np.inf
        start = dict.fromkeys(POINTS, FIRST_KERNEL)
        tuned: set[tuple[str, int]] = set()
        for level in self.options.levels:
            if level > most:
                reason = "more than a quarter of the reference's samples"
                self.missing.append(Missing(f"points from {level} samples on", reason))
                break
            # Both or none: a budget that one has and the other lacks would favour it.
            first = sum(self._predict(Setting(e, level, start[e])) for e in POINTS)
            if not self._fits(first, self._sweep_share):
                self.missing.append(Missing(f"points from {level} samples on", OUT_OF_TIME))
                break
            done = yield from self._level(level, start)
            tuned |= {(estimator, level) for estimator in done}
        return tuned

    def _level(self, level: int, start: dict[str, float]) -> Steps:
        """Sweeps the kernels of both in turns, from `start`, and leaves the best there; those whose
        sweep came to its end."""
        errors: dict[str, dict[int, float]] = {estimator: {} for estimator in POINTS}
        active = list(POINTS)
        done: list[str] = []
        while active:
            yield from self._rays()
            for estimator in list(active):
                known = errors[estimator]
                index = next_kernel(known, KERNELS.index(start[estimator]))
                if index is None:
                    active.remove(estimator)
                    done.append(estimator)
                    continue
                setting = Setting(estimator, level, KERNELS[index])
                row = None
                if setting in self.rows or self._fits(self._predict(setting), self._sweep_share):
                    row = yield from self._measure(setting)
                if row is None:
                    what = f"more kernels of {estimator}, {level} samples"
                    self.missing.append(Missing(what, OUT_OF_TIME))
                    active.remove(estimator)
                    continue
                # An error below what the reference can show is not a number.
                error = row.error(self.options.metric)
                known[index] = 0.0 if math.isnan(error) else error
        for estimator, known in errors.items():
            if known:
                start[estimator] = KERNELS[_best(known)]
        return done

    def _predict(self, setting: Setting) -> float:
        """Wall seconds, from the rows of the same estimator: with as many samples, else with the
        most; a larger kernel takes longer, so of several the next one."""
        if setting in self.rows:
            return 0.0
        known = [
            s
            for s in self.rows
            if s.estimator == setting.estimator and s.light_samples <= setting.light_samples
        ]
        if not known:
            return 0.0
        most = max(s.light_samples for s in known)
        near = min(
            (s for s in known if s.light_samples == most),
            key=lambda s: abs(math.log(s.kernel_size / setting.kernel_size)),
        )
        return self.walls[near] * (1.0 if most == setting.light_samples else GROWTH_MAX)

    def _repeats(self) -> Steps:
        """Again what is on the front, in turns: whatever else the machine does slows all alike."""
        for count in range(1, self.options.repeats):
            yield from self._rays()
            for estimator in {row.setting.estimator: None for row in self.rows.values()}:
                rows = [r for r in self.rows.values() if r.setting.estimator == estimator]
                for row in curve.front(rows, self.options.metric):
                    if len(row.runs) <= count and self._fits(self.walls[row.setting]):
                        yield from self._repeat(row)


def next_kernel(errors: dict[int, float], first: int) -> int | None:
    """The index of the kernel to try next: around the least error, until both its neighbours are
    known; None when they are."""
    if not errors:
        return first
    best = _best(errors)
    wanted = (best - 1, best + 1)
    return next((i for i in wanted if 0 <= i < len(KERNELS) and i not in errors), None)


def _best(errors: dict[int, float]) -> int:
    return min(errors, key=lambda index: errors[index])


def _coarser(setting: Setting) -> Setting:
    return replace(setting, tube_refinement=setting.tube_refinement - 1)
