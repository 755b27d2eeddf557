# SPDX-License-Identifier: GPL-3.0-or-later
"""A measurement as numbers for programs (CSV) and for people (Markdown)."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterable, Sequence

from . import curve
from .curve import NotReached, Point, percent
from .measurement import Measurement
from .rows import STAGES, Row

CSV_COLUMNS = (
    "estimator", "light_samples", "kernel_size", "tube_refinement", "elements", "field_bytes",
    "light_bytes", *(f"{name}_cpu_s" for name in STAGES), "precompute_cpu_s", "total_cpu_s",
    "over_camera_rays", "runs", "mse", "rel_rmse", "floored_rel", "mean_ratio_r", "mean_ratio_g",
    "mean_ratio_b", "p9999", "nonfinite", "is_tuned", "on_front", "role",
)  # fmt: skip


# ---- CSV -----------------------------------------------------------------------------------------


def csv_text(measurement: Measurement) -> str:
    """One line a row; the reference is the first, where it was rendered."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    if measurement.reference.row:
        writer.writerow(_csv_row(measurement, measurement.reference.row, "reference", False))
    fronts = measurement.fronts
    for name in measurement.estimators:
        for row in _ordered(measurement.rows_of(name)):
            writer.writerow(_csv_row(measurement, row, "row", row in fronts[name]))
    return out.getvalue()


def _ordered(rows: Iterable[Row]) -> list[Row]:
    return sorted(
        rows,
        key=lambda r: (r.setting.light_samples, r.setting.kernel_size, r.setting.tube_refinement),
    )


def _csv_row(measurement: Measurement, row: Row, role: str, is_front: bool) -> list[object]:
    setting, errors = row.setting, row.errors
    accuracy: list[object] = [""] * 7
    if errors is not None:
        values = [errors.mse, errors.rel_rmse, errors.floored_rel, *errors.mean_ratio, errors.peak]
        accuracy = ["" if math.isnan(value) else f"{value:.6g}" for value in values]
    return [
        setting.estimator,
        *(setting.budgets.get(name, "") for name in CSV_COLUMNS[1:4]),
        row.elements or "",
        row.field_bytes,
        row.light_bytes,
        *(f"{row.run.stages[name]:.6f}" for name in STAGES),
        f"{row.precompute:.6f}",
        f"{row.total:.6f}",
        f"{row.total / measurement.ray_cost:.4g}",
        len(row.runs),
        *accuracy,
        row.nonfinite,
        int(row.is_tuned),
        int(is_front),
        role,
    ]


# ---- Markdown ------------------------------------------------------------------------------------


def markdown_text(measurement: Measurement) -> str:
    """Head, table 4 of the paper, equal error, equal time, what was left out."""
    m = measurement
    parts = [f"# What accuracy costs: {m.name}", _head(m), "## Rows", _rows(m)]
    if m.target_error is not None:
        parts += [f"## Equal error: {percent(m.target_error)} {m.metric}", _equal_error(m)]
    if m.target_time is not None:
        parts += [f"## Equal time: {m.target_time:.3g} CPU s", _equal_time(m)]
    if m.missing:
        parts += ["## Left out", "\n".join(f"- {item.what}: {item.reason}" for item in m.missing)]
    return "\n\n".join(parts) + "\n"


def _head(m: Measurement) -> str:
    cost = f", {m.reference.row.total:.3g} CPU s" if m.reference.row else ""
    lines = [
        f"{m.width} x {m.height} pixels, {m.samples} camera samples a pixel, single scattering, "
        f"{100 * m.coverage:.0f} % of the pixels see a translucent object; {m.threads} threads, "
        f"{m.wall:.0f} s in all",
        f"reference: {m.reference.name}{cost}; {m.reference.about}; its mean is {m.mean:.4g}",
        f"camera rays alone: {m.ray_cost:.3g} CPU s, median of {len(m.rays)}",
        *m.notes,
    ]
    return "\n".join(f"- {line}" for line in lines)


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Numbers to the right, the first column to the left."""
    lines = [header, ["---"] + ["--:"] * (len(header) - 1), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def seconds(value: float) -> str:
    return f"{value:.3g}" if value < 100 else f"{value:.0f}"


def megabytes(value: float) -> str:
    return f"{value / 1e6:.3g}" if value < 1e8 else f"{value / 1e6:.0f}"


def bias(ratios: Sequence[float]) -> str:
    """The channel whose mean is the farthest from the reference's."""
    return f"{max(ratios, key=lambda ratio: abs(ratio - 1.0)):.4f}"


def budget(row: Row) -> str:
    s = row.setting
    if s.kernel_size:
        return f"C_k {s.kernel_size:g}"
    return f"refinement {s.tube_refinement}" if s.estimator == "TUBES" else ""


def _rows(m: Measurement) -> str:
    header = [
        *("estimator", "samples", "setting", "MB", "precompute s", "render s", "total s"),
        *("/ rays", "runs", "MSE", "rel_rmse", "floored_rel", "mean ratio", "p99.99"),
    ]
    lines = []
    fronts = m.fronts
    for name in m.estimators:
        for row in _ordered(m.rows_of(name)):
            errors = row.errors
            assert errors is not None
            marks = "*" if row in fronts[name] else "" if row.is_tuned else "-"
            marks += "?" if m.is_doubtful(row) else ""
            lines.append([
                f"{name} {marks}".strip(),
                str(row.elements) if row.elements else "",
                budget(row),
                megabytes(row.field_bytes),
                seconds(row.precompute),
                seconds(row.camera),
                seconds(row.total),
                f"{row.total / m.ray_cost:.3g}",
                str(len(row.runs)),
                f"{errors.mse:.2e}",
                percent(errors.rel_rmse),
                percent(errors.floored_rel),
                bias(errors.mean_ratio),
                f"{errors.peak:.3g}",
            ])  # fmt: skip
    words = "`*`: on the estimator's front, no other setting is both cheaper and better."
    if any(m.is_doubtful(row) for row in m.rows):
        words += " `?`: the reference itself may be as wrong."
    if not all(row.is_tuned for row in m.rows):
        words += " `-`: other kernels may be better at this budget, but did not fit into the time; "
        words += "not on the front."
    broken = [str(row.setting) for row in m.rows if row.nonfinite]
    if broken:
        words += f" Not finite samples were left out of: {'; '.join(broken)}."
    return f"{table(header, lines)}\n\n{words}"


Answer = Point | NotReached


def _equal(m: Measurement, answer: Callable[[list[Row]], Answer]) -> dict[str, Answer]:
    return {name: answer(front) for name, front in m.fronts.items()}


def equal_error(m: Measurement) -> dict[str, Answer]:
    target = m.target_error
    assert target is not None
    return _equal(m, lambda front: curve.at_error(front, m.metric, target))


def equal_time(m: Measurement) -> dict[str, Answer]:
    target = m.target_time
    assert target is not None
    return _equal(m, lambda front: curve.at_time(front, target))


def _over(fixed: Answer | None, value: float, of: Callable[[Point], float]) -> str:
    """How many times more the baseline takes."""
    return f"{of(fixed) / value:.3g}" if isinstance(fixed, Point) and value > 0.0 else ""


def _equal_error(m: Measurement) -> str:
    header = ["estimator", "samples", "MB", "precompute s", "render s", "total s", "/ rays",
              "times cheaper", "times smaller", "floored_rel", "where"]  # fmt: skip
    answers = equal_error(m)
    fixed = answers.get("POINTS_FIXED")
    lines = []
    for name, point in answers.items():
        if isinstance(point, NotReached):
            lines.append([name, *[""] * (len(header) - 2), f"not reached: {point.reason}"])
            continue
        lines.append([
            name,
            f"{point.elements:.3g}" if point.elements else "",
            megabytes(point.field_bytes),
            seconds(point.total - point.stages["camera"]),
            seconds(point.stages["camera"]),
            seconds(point.total),
            f"{point.total / m.ray_cost:.3g}",
            _over(fixed, point.total, lambda p: p.total),
            _over(fixed, point.field_bytes, lambda p: p.field_bytes),
            percent(point.floored_rel),
            point.how,
        ])  # fmt: skip
    return f"{table(header, lines)}\n\nTimes cheaper and smaller: than POINTS_FIXED at its best."


def _equal_time(m: Measurement) -> str:
    header = ["estimator", "samples", "MB", "total s", "MSE", "rel_rmse", "floored_rel",
              "times more accurate", "where"]  # fmt: skip
    answers = equal_time(m)
    fixed = answers.get("POINTS_FIXED")
    lines = []
    for name, point in answers.items():
        if isinstance(point, NotReached):
            lines.append([name, *[""] * (len(header) - 2), f"not reached: {point.reason}"])
            continue
        error = getattr(point, m.metric)
        lines.append([
            name,
            f"{point.elements:.3g}" if point.elements else "",
            megabytes(point.field_bytes),
            seconds(point.total),
            f"{point.mse:.2e}",
            percent(point.rel_rmse),
            percent(point.floored_rel),
            _over(fixed, error, lambda p: getattr(p, m.metric)),
            point.how,
        ])  # fmt: skip
    return table(header, lines)
