# SPDX-License-Identifier: GPL-3.0-or-later
"""The harness of the hard cases: what a case is, how its error is recorded, and the document.

A case says what is true where optics, a mesh or a medium degenerates, and by how much a picture
may miss it. It is one entry of a table (table_*.py); it is run by test_hard_cases.py with every
method that it names; the largest errors go into docs/stability.json, and docs/stability.md is
written from that file:

    python3 -m pytest tests/stability --record
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import api
from api import _ffi

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "docs/stability.json"
DOCUMENT = ROOT / "docs/stability.md"
HEAD = Path(__file__).with_name("stability_head.md")

# One line adds a method: its name in the table, what it sets in AmbRenderParams.
METHODS: dict[str, dict[str, Any]] = {
    "POINTS_FIXED": {"estimator": api.POINTS_FIXED},
    "POINTS_COVARIANCE": {"estimator": api.POINTS_COVARIANCE},
    "TUBES": {"estimator": api.TUBES},
    "SPECULAR": {"estimator": api.SPECULAR},
}
# Later orders of scattering, over the tubes.
LATER = _ffi.AMB_EFFECT_DOUBLE_SCATTERING | _ffi.AMB_EFFECT_MULTIPLE_SCATTERING
for _name in ("WALK", "PHOTONS"):
    METHODS[_name] = {
        "effects": api.SINGLE | LATER,
        "scatter_estimator": getattr(_ffi, f"AMB_SCATTER_{_name}"),
    }
ORDERS = ("WALK", "PHOTONS")
POINTS = ("POINTS_FIXED", "POINTS_COVARIANCE")
TRIANGLES = ("TUBES", "SPECULAR")
ALL = POINTS + TRIANGLES
# What has no kernel, no order of scattering, no estimator: one entry, this name.
ONE = ("-",)


@dataclass(frozen=True)
class Case:
    """``error(method)`` is compared with ``bound``; kernels may have a bound of their own.

    ``truth``: one line, what is true there and what the error is measured in.
    """

    name: str
    truth: str
    bound: float
    error: Callable[[str], float]
    methods: tuple[str, ...] = ALL
    bound_points: float | None = None
    needs: Path | None = None  # a file that not every checkout has
    group: str = ""

    def bound_of(self, method: str) -> float:
        is_kernel = method in (*POINTS, "PHOTONS") and self.bound_points is not None
        return float(self.bound_points if is_kernel else self.bound)

    @property
    def key(self) -> str:
        return f"{self.group}: {self.name}"


class Recorder:
    """Errors of this run: key of a case -> method -> error."""

    def __init__(self) -> None:
        self.errors: dict[str, dict[str, float]] = {}

    def add(self, key: str, method: str, error: float) -> None:
        self.errors.setdefault(key, {})[method] = float(f"{error:.2g}")


RECORDER = Recorder()


def all_cases() -> list[Case]:
    """Every entry of every table, in the order of the document."""
    import tables

    return tables.CASES


# ---- Results and document -----------------------------------------------------------------------


def read_results() -> dict[str, dict[str, Any]]:
    return json.loads(RESULTS.read_text()) if RESULTS.is_file() else {}


def update_results() -> dict[str, dict[str, Any]]:
    """The stored results with those of this run in their place; cases that are gone leave."""
    stored = read_results()
    results: dict[str, dict[str, Any]] = {}
    for case in all_cases():
        errors = stored.get(case.key, {}).get("errors", {}) | RECORDER.errors.get(case.key, {})
        results[case.key] = {
            "truth": case.truth,
            "errors": {method: errors[method] for method in case.methods if method in errors},
            "bounds": {method: case.bound_of(method) for method in case.methods},
        }
    for key, entry in native_results().items():
        results[key] = entry
    RESULTS.write_text(json.dumps(results, indent=1) + "\n")
    return results


def native_results() -> dict[str, dict[str, Any]]:
    """Those of the operators: what `amb_test hard` wrote, else what is stored of it."""
    found = native_table()
    if found is not None:
        return found
    return {key: entry for key, entry in read_results().items() if entry.get("where") == "operator"}


def native_table() -> dict[str, dict[str, Any]] | None:
    """Runs the C table; None where the tests in C are not built."""
    import subprocess

    program = ROOT / "build/dev/tests/amb_test"
    if not program.is_file():
        return None
    lines = subprocess.run(
        [program, "hard"], capture_output=True, text=True, check=False
    ).stdout.splitlines()
    table = {}
    for line in lines:
        words = line.split("\t")
        if words[0] == "hard":
            _, group, name, truth, bound, error = words
            table[f"{group}: {name}"] = {
                "truth": truth,
                "errors": {"-": float(f"{float(error):.2g}")},
                "bounds": {"-": float(bound)},
                "where": "operator",
            }
    return table


SHORT = {
    "POINTS_FIXED": "fixed",
    "POINTS_COVARIANCE": "cov.",
    "TUBES": "tubes",
    "SPECULAR": "spec.",
}


def cell(entry: dict[str, Any], what: str) -> str:
    """Errors or bounds, one for each method, those alike taken together."""
    values: dict[str, list[str]] = {}
    for method, value in entry[what].items():
        text = "0" if value == 0 else f"{value:.2g}"
        values.setdefault(text, []).append(SHORT.get(method, method))
    if not values:
        return "not run"
    if len(values) == 1:
        return next(iter(values))
    return ", ".join(f"{text} {'/'.join(names)}" for text, names in values.items())


def document(results: dict[str, dict[str, Any]]) -> str:
    """docs/stability.md."""
    text = HEAD.read_text()
    count = len(results)
    runs = sum(len(entry["errors"]) for entry in results.values())
    text = text.replace("@CASES@", str(count)).replace("@RUNS@", str(runs))
    group = ""
    for key, entry in results.items():
        head, name = key.split(": ", 1)
        if head != group:
            group = head
            text += f"\n## {group}\n\n| case | what is true | bound | largest error |\n"
            text += "|---|---|---|---|\n"
        text += f"| {name} | {entry['truth']} | {cell(entry, 'bounds')} "
        text += f"| {cell(entry, 'errors')} |\n"
    return text


def write_document(results: dict[str, dict[str, Any]]) -> None:
    DOCUMENT.write_text(document(results))
