# SPDX-License-Identifier: GPL-3.0-or-later
"""The best that an estimator offers, and what it costs or reaches between its budgets.

Between two measured settings logarithms are interpolated. Beyond them nothing is invented: a
target that no setting reaches is "not reached"; one that the cheapest setting already reaches is
answered by that setting itself, because there is no cheaper one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .rows import STAGES, Row


@dataclass(frozen=True)
class Point:
    """A place on the curve of an estimator; `how` says where it comes from."""

    stages: dict[str, float]  # CPU seconds
    mse: float
    rel_rmse: float
    floored_rel: float
    elements: float
    field_bytes: float
    how: str

    @property
    def total(self) -> float:
        return sum(self.stages.values())


@dataclass(frozen=True)
class NotReached:
    """There is no such place, and why."""

    reason: str


def total_of(row: Row) -> float:
    return row.total


def front(rows: Sequence[Row], metric: str, cost: Callable[[Row], float] = total_of) -> list[Row]:
    """The rows to which no other is both cheaper and better, by rising cost: there an estimator is
    played at its best."""
    best: list[Row] = []
    for row in sorted(rows, key=lambda row: (cost(row), row.error(metric))):
        # An error that is not a number is below what the reference can show: no place on a curve.
        error = row.error(metric)
        if row.is_tuned and error >= 0.0 and (not best or error < best[-1].error(metric)):
            best.append(row)
    return best


def at_error(curve: Sequence[Row], metric: str, target: float) -> Point | NotReached:
    """The cheapest place with at most this error."""
    if not curve:
        return NotReached("nothing was measured")
    if curve[-1].error(metric) > target:
        return NotReached(f"the best is {percent(curve[-1].error(metric))}")
    if curve[0].error(metric) <= target:
        return _measured(curve[0], "the cheapest setting")
    i = next(i for i, row in enumerate(curve) if row.error(metric) <= target)
    a, b = curve[i - 1], curve[i]
    if b.error(metric) <= 0.0:
        return _measured(b, "measured")
    share = math.log(a.error(metric) / target) / math.log(a.error(metric) / b.error(metric))
    return _between(a, b, share)


def at_time(curve: Sequence[Row], target: float) -> Point | NotReached:
    """The best place with at most this total."""
    if not curve:
        return NotReached("nothing was measured")
    if curve[0].total > target:
        return NotReached(f"the cheapest takes {curve[0].total:.3g} s")
    if curve[-1].total <= target:
        return _measured(curve[-1], "the best setting")
    i = next(i for i, row in enumerate(curve) if row.total > target)
    a, b = curve[i - 1], curve[i]
    return _between(a, b, math.log(target / a.total) / math.log(b.total / a.total))


def common_error(curves: Sequence[Sequence[Row]], metric: str) -> float | None:
    """The smallest error that every estimator reaches."""
    return max((curve[-1].error(metric) for curve in curves if curve), default=None)


def common_time(curves: Sequence[Sequence[Row]]) -> float | None:
    """The longest total up to which every estimator has been measured."""
    return min((curve[-1].total for curve in curves if curve), default=None)


def nearest(rows: Sequence[Row], total: float) -> Row:
    """The row whose total is the closest, by ratio."""
    return min(rows, key=lambda row: abs(math.log(row.total / total)))


def percent(value: float) -> str:
    """An error as a reader wants it: three digits."""
    if math.isnan(value):
        return "below noise"
    return f"{100 * value:.3g} %"


def _measured(row: Row, how: str) -> Point:
    errors = row.errors
    assert errors is not None
    return Point(
        dict(row.run.stages),
        errors.mse,
        errors.rel_rmse,
        errors.floored_rel,
        row.elements,
        row.field_bytes,
        f"{how}: {row.setting.budget}" if row.setting.budget else how,
    )


def _between(a: Row, b: Row, share: float) -> Point:
    """`share` of the way from a to b. The total is interpolated and divided among the stages as
    both ends divide it, so that the parts add up."""
    total = _mix(a.total, b.total, share)
    stages = {
        name: total
        * ((1 - share) * a.run.stages[name] / a.total + share * b.run.stages[name] / b.total)
        for name in STAGES
    }
    first, last = a.errors, b.errors
    assert first is not None and last is not None
    return Point(
        stages,
        _mix(first.mse, last.mse, share),
        _mix(first.rel_rmse, last.rel_rmse, share),
        _mix(first.floored_rel, last.floored_rel, share),
        _mix(a.elements, b.elements, share),
        _mix(a.field_bytes, b.field_bytes, share),
        f"between {a.setting.budget} and {b.setting.budget}",
    )


def _mix(a: float, b: float, share: float) -> float:
    """In logarithms; where one of them is not positive, as it is."""
    if a > 0.0 and b > 0.0:
        return math.exp((1 - share) * math.log(a) + share * math.log(b))
    return (1 - share) * a + share * b
