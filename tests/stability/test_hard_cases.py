# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs the tables of hard cases, and holds docs/stability.md against them."""

from __future__ import annotations

import math

import hard
import pytest
from api import LIBRARY

needs_library = pytest.mark.skipif(not LIBRARY.is_file(), reason=f"{LIBRARY} is not built")


def marks(case: hard.Case) -> list:
    if case.needs is None:
        return []
    return [pytest.mark.skipif(not case.needs.is_file(), reason=f"no {case.needs.name}")]


def entries() -> list:
    """One test for each method of each case."""
    return [
        pytest.param(
            case,
            method,
            id=f"{case.key}-{method}",
            marks=marks(case),
        )
        for case in hard.all_cases()
        for method in case.methods
    ]


@needs_library
@pytest.mark.parametrize(("case", "method"), entries())
def test_hard_case(case: hard.Case, method: str) -> None:
    error = case.error(method)
    hard.RECORDER.add(case.key, method, error)
    assert math.isfinite(error)
    assert error <= case.bound_of(method), case.truth


def test_names_are_unique() -> None:
    keys = [case.key for case in hard.all_cases()]
    assert len(set(keys)) == len(keys)


def test_document_has_every_case_and_what_was_measured() -> None:
    results = hard.read_results()
    native = hard.native_table()
    expected = {case.key for case in hard.all_cases()}
    operators = {key for key, entry in results.items() if entry.get("where") == "operator"}
    assert set(results) - operators == expected
    assert native is None or operators == set(native)
    for case in hard.all_cases():
        entry = results[case.key]
        assert entry["truth"] == case.truth
        assert entry["bounds"] == {method: case.bound_of(method) for method in case.methods}
        assert set(entry["errors"]) == set(case.methods), f"{case.key} was never recorded"
    for key, entry in results.items():
        for method, error in entry["errors"].items():
            assert error <= 1.05 * entry["bounds"][method], f"{key}, {method}"


def test_document_is_written_from_the_results() -> None:
    assert hard.DOCUMENT.read_text() == hard.document(hard.read_results())
