# SPDX-License-Identifier: GPL-3.0-or-later
"""Fronts and what lies between their rows, against numbers worked by hand."""

import math

import pytest
from amberlight.cost import curve
from amberlight.cost.curve import NotReached, Point
from cost_stub import make_row

FRONT = [
    make_row("TUBES", 1.0, 0.16, tube_refinement=0),
    make_row("TUBES", 4.0, 0.04, tube_refinement=1),
    make_row("TUBES", 64.0, 0.01, tube_refinement=2),
]


def test_front_leaves_out_what_is_beaten():
    beaten = make_row("TUBES", 5.0, 0.05)
    tied = make_row("TUBES", 6.0, 0.04)
    unseen = make_row("TUBES", 7.0, math.nan)
    assert curve.front([unseen, tied, *reversed(FRONT), beaten], "rel_rmse") == FRONT
    assert curve.front([], "rel_rmse") == []


def test_front_leaves_out_what_is_not_played_at_its_best():
    cut_off = make_row("POINTS_FIXED", 128.0, 0.001)
    cut_off.is_tuned = False
    assert curve.front([*FRONT, cut_off], "rel_rmse") == FRONT


def test_front_by_another_cost():
    by_memory = curve.front(FRONT, "rel_rmse", lambda row: row.field_bytes)
    assert by_memory == [FRONT[2]]


def test_time_of_an_error_between_two_rows():
    # Half way in logarithms from 16 % to 4 %, so half way from 1 s to 4 s.
    point = curve.at_error(FRONT, "rel_rmse", 0.08)
    assert isinstance(point, Point)
    assert point.total == pytest.approx(2.0)
    assert point.rel_rmse == pytest.approx(0.08)
    assert point.mse == pytest.approx(0.0064)
    assert point.stages["field"] == pytest.approx(1.0)
    assert point.how == "between refinement 0 and refinement 1"


def test_error_of_a_time_between_two_rows():
    point = curve.at_time(FRONT, 16.0)
    assert point.rel_rmse == pytest.approx(0.02) and point.total == pytest.approx(16.0)


@pytest.mark.parametrize("row", FRONT)
def test_rows_are_their_own_answer(row):
    assert curve.at_error(FRONT, "rel_rmse", row.error("rel_rmse")).total == pytest.approx(
        row.total
    )
    assert curve.at_time(FRONT, row.total).rel_rmse == pytest.approx(row.error("rel_rmse"))


def test_nothing_is_invented_beyond_the_rows():
    assert curve.at_error(FRONT, "rel_rmse", 0.009) == NotReached("the best is 1 %")
    assert curve.at_time(FRONT, 0.5) == NotReached("the cheapest takes 1 s")
    # What the cheapest reaches costs what the cheapest costs, not less.
    point = curve.at_error(FRONT, "rel_rmse", 0.5)
    assert (point.total, point.rel_rmse) == (1.0, 0.16)
    assert point.how == "the cheapest setting: refinement 0"
    point = curve.at_time(FRONT, 1000.0)
    assert (point.total, point.rel_rmse) == (64.0, 0.01)
    assert isinstance(curve.at_time([], 1.0), NotReached)
    assert isinstance(curve.at_error([], "rel_rmse", 1.0), NotReached)


def test_error_of_zero_has_no_logarithm():
    exact = [FRONT[0], make_row("TUBES", 9.0, 0.0, tube_refinement=3)]
    assert curve.at_error(exact, "rel_rmse", 0.01).total == 9.0
    assert curve.at_time(exact, 3.0).rel_rmse == pytest.approx(0.08)


def test_common_targets():
    other = [make_row("POINTS_FIXED", 2.0, 0.3), make_row("POINTS_FIXED", 8.0, 0.1)]
    assert curve.common_error([FRONT, other], "rel_rmse") == 0.1
    assert curve.common_time([FRONT, other]) == 8.0
    assert curve.common_error([], "rel_rmse") is None and curve.common_time([[]]) is None
    assert curve.nearest(FRONT, 3.0) is FRONT[1]


def test_median_run():
    row = make_row("TUBES", 1.0, 0.1)
    for seconds in (5.0, 2.0, 3.0):
        row.runs += make_row("TUBES", seconds, 0.1).runs
    assert row.total == 2.0  # of 1, 2, 3, 5
    row.runs += make_row("TUBES", 9.0, 0.1).runs
    assert row.total == 3.0
