# SPDX-License-Identifier: GPL-3.0-or-later
"""All that a sweep found, as the tables and the figure want it."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray

from . import curve
from .rows import ESTIMATORS, Missing, Row, Setting

# Errors of rows within this factor of the reference's own are named.
DOUBTFUL = 2.0


@dataclass(frozen=True)
class Reference:
    """`images`: one, or two of independent noise. `row`: what it cost, where it was rendered.
    `own`: its own error by the metric of the sweep, with words on how that is known."""

    name: str
    images: tuple[NDArray[Any], ...]
    row: Row | None = None
    own: float | None = None
    about: str = ""

    @property
    def image(self) -> NDArray[Any]:
        return sum(self.images[1:], self.images[0]) / len(self.images)


@dataclass
class Measurement:
    """`rays`: CPU seconds of the camera rays alone, one for each run. `image` returns the pixels
    of a row, (height, width, 3), row 0 at the bottom."""

    name: str
    width: int
    height: int
    samples: int
    metric: str
    reference: Reference
    rows: list[Row]
    rays: list[float]
    image: Callable[[Setting], NDArray[Any]]
    coverage: float = 0.0
    mean: float = 0.0  # of the reference over the mask
    missing: list[Missing] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    threads: int = 0
    wall: float = 0.0
    wanted_error: float = 0.0  # 0: the smallest that every estimator reaches
    wanted_time: float = 0.0  # 0: the longest to which every estimator was measured

    @property
    def ray_cost(self) -> float:
        return statistics.median(self.rays)

    @property
    def estimators(self) -> list[str]:
        """Those with a row, in the order of tables."""
        found = {row.setting.estimator for row in self.rows}
        return [name for name in ESTIMATORS if name in found]

    def rows_of(self, estimator: str) -> list[Row]:
        return [row for row in self.rows if row.setting.estimator == estimator]

    def front(self, estimator: str) -> list[Row]:
        return curve.front(self.rows_of(estimator), self.metric)

    @property
    def fronts(self) -> dict[str, list[Row]]:
        return {name: self.front(name) for name in self.estimators}

    @property
    def target_error(self) -> float | None:
        return self.wanted_error or curve.common_error(list(self.fronts.values()), self.metric)

    @property
    def target_time(self) -> float | None:
        return self.wanted_time or curve.common_time(list(self.fronts.values()))

    def is_doubtful(self, row: Row) -> bool:
        """Whether the reference may be as wrong as the row."""
        error = row.error(self.metric)
        return self.reference.own is not None and not error > DOUBTFUL * self.reference.own
