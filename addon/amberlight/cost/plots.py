# SPDX-License-Identifier: GPL-3.0-or-later
"""cost.png: curves, stages and images of a measurement. The only file that needs matplotlib.

It is imported late, without pyplot: nothing global is touched inside of Blender, and without
matplotlib the numbers are still written.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import curve, tables
from .curve import NotReached, percent
from .measurement import Measurement
from .rows import STAGES, Row

# Okabe and Ito's colours, which the colour-blind can tell apart; the shapes differ too.
COLOURS = {
    "POINTS_FIXED": "#D55E00",
    "POINTS_COVARIANCE": "#0072B2",
    "TUBES": "#009E73",
    "SPECULAR": "#CC79A7",
}
MARKERS = {"POINTS_FIXED": "s", "POINTS_COVARIANCE": "o", "TUBES": "^", "SPECULAR": "D"}
STAGE_COLOURS = {"scene": "#000000", "light": "#E69F00", "field": "#56B4E9", "camera": "#BBBBBB"}
GREY = "#666666"

# Inches.
WIDTH, MARGIN = 15.0, 0.15
HEAD, CURVES, BARS = 0.85, 4.6, 2.7
IMAGE_GAP, TITLE = 0.12, 0.24
DPI = 110
# The 99th percentile of the reference is shown as white.
WHITE_PERCENTILE = 99.0
# A bar is cut where it is so many times longer than the second.
LONGEST_BAR = 3.0
# As in figures 9 to 11 of the paper.
DIFFERENCE_FACTOR = 5.0


def draw(m: Measurement, shown: Mapping[str, Row], path: Path) -> None:
    """ImportError where matplotlib is not installed."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    columns = max(len(shown) + 1, 3)
    image_width = (WIDTH - 2 * MARGIN - (columns - 1) * IMAGE_GAP) / columns
    image_height = image_width * m.height / m.width
    height = HEAD + CURVES + BARS + 2 * image_height + 3 * TITLE + 2 * MARGIN
    figure = Figure(figsize=(WIDTH, height), dpi=DPI)
    FigureCanvasAgg(figure)
    figure.suptitle(f"What accuracy costs: {m.name}", x=0.01, y=1 - 0.12 / height,
                    ha="left", va="top", fontsize=15, weight="bold")  # fmt: skip
    about = (
        f"{m.width} x {m.height}, {m.samples} samples a pixel, single scattering; reference: "
        f"{m.reference.name}"
    )
    figure.text(0.01, 1 - 0.45 / height, about, ha="left", va="top", color=GREY)
    top = 1 - HEAD / height

    def band(inches: float, before: float, gap: float) -> dict[str, float]:
        """Where a band of the figure lies, below what stands before it."""
        upper = top - before / height
        return {"top": upper, "bottom": upper - (inches - gap) / height}

    grid = figure.add_gridspec(1, 3, left=0.06, right=0.985, wspace=0.42, **band(CURVES, 0, 0.95))
    axes = [figure.add_subplot(grid[0, i]) for i in range(3)]
    _draw_error_time(m, axes[0])
    _draw_floored(m, axes[1])
    _draw_memory(m, axes[2])
    handles, labels = axes[0].get_legend_handles_labels()
    axes[0].legend(handles, labels, fontsize=8, loc="best", framealpha=0.9)

    grid = figure.add_gridspec(1, 2, left=0.13, right=0.985, wspace=0.42,
                               **band(BARS, CURVES, 0.85))  # fmt: skip
    axes = [figure.add_subplot(grid[0, i]) for i in range(2)]
    error, time = m.target_error, m.target_time
    if error is not None and time is not None:
        _draw_stages(
            m, axes[0], tables.equal_error(m), f"Stages at equal error, {percent(error)} {m.metric}"
        )
        _draw_stages(m, axes[1], tables.equal_time(m), f"Stages in equal time, {time:.3g} CPU s")
        handles = [Patch(color=STAGE_COLOURS[stage], label=stage) for stage in STAGES]
        figure.legend(handles=handles, fontsize=8, ncols=4, frameon=False, loc="upper center",
                      bbox_to_anchor=(0.5, top - (CURVES + BARS - 0.45) / height))  # fmt: skip

    def place(column: int, row: int) -> Any:
        """The axes of an image, counted from the left and the top."""
        x = MARGIN + column * (image_width + IMAGE_GAP)
        y = MARGIN + (1 - row) * (image_height + TITLE + MARGIN)
        box = (x / WIDTH, y / height, image_width / WIDTH, image_height / height)
        axis = figure.add_axes(box)
        axis.set_axis_off()
        return axis

    _draw_images(m, shown, place)
    figure.savefig(path, format="png", metadata={"Software": "Amberlight"})


# ---- Curves --------------------------------------------------------------------------------------


def _draw_curves(m: Measurement, axis: Any, x: Any, metric: str) -> None:
    """All rows as pale marks, the fronts as lines."""
    for name in m.estimators:
        front = curve.front(m.rows_of(name), metric, x)
        colour, marker = COLOURS[name], MARKERS[name]
        rest = [row for row in m.rows_of(name) if row not in front and row.error(metric) > 0]
        axis.plot([x(row) for row in rest], [row.error(metric) for row in rest], marker,
                  color=colour, alpha=0.35, markersize=4, markeredgewidth=0)  # fmt: skip
        line = [row for row in front if row.error(metric) > 0]
        axis.plot([x(row) for row in line], [row.error(metric) for row in line], "-",
                  marker=marker, color=colour, markersize=6, linewidth=1.8, label=name)  # fmt: skip
    if not axis.lines or not any(line.get_xdata().size for line in axis.lines):
        axis.text(0.5, 0.5, "no error to be seen", ha="center", transform=axis.transAxes)
        return
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.grid(True, which="major", color="#cccccc", linewidth=0.8)
    axis.grid(True, which="minor", color="#e6e6e6", linewidth=0.5)
    axis.set_axisbelow(True)
    _label_decades(axis)


def _label_decades(axis: Any) -> None:
    """Plain numbers; 2 and 5 of each decade too where only few decades are shown."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for side, formatter in (
        (axis.xaxis, lambda v, _: f"{v:g}"),
        (axis.yaxis, lambda v, _: f"{100 * v:g} %"),
    ):
        low, high = side.get_view_interval()
        few = low > 0 and high / low < 3e2
        side.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,)))
        side.set_major_formatter(FuncFormatter(formatter))
        side.set_minor_formatter(NullFormatter())
        side.set_tick_params(labelsize=8)


def _draw_error_time(m: Measurement, axis: Any) -> None:
    _draw_curves(m, axis, lambda row: row.total, "rel_rmse")
    axis.set_title("Error and time", loc="left", fontsize=11)
    axis.set_xlabel("CPU s, scene + light + field + camera")
    axis.set_ylabel("rel_rmse")
    _draw_targets(m, axis, "rel_rmse")
    axis.axvline(m.ray_cost, color="black", linewidth=1, linestyle=":", label="camera rays alone")
    # The paper's figure 15 shows the same as MSE = (rel_rmse mean)^2.
    mean = m.mean
    right = axis.secondary_yaxis(
        "right",
        functions=(
            lambda e: (np.maximum(e, 1e-30) * mean) ** 2,
            lambda s: np.sqrt(np.maximum(s, 1e-30)) / mean,
        ),
    )
    right.set_ylabel("MSE", fontsize=9, color=GREY)
    right.tick_params(labelsize=8, colors=GREY)


def _draw_targets(m: Measurement, axis: Any, metric: str) -> None:
    if m.target_time is not None:
        axis.axvline(m.target_time, color=GREY, linewidth=1, linestyle="--", label="equal time")
    if m.metric == metric and m.target_error is not None:
        axis.axhline(m.target_error, color=GREY, linewidth=1, linestyle="-.", label="equal error")


def _draw_floored(m: Measurement, axis: Any) -> None:
    _draw_curves(m, axis, lambda row: row.total, "floored_rel")
    axis.set_title("Error of dark regions and time", loc="left", fontsize=11)
    axis.set_xlabel("CPU s")
    axis.set_ylabel("floored_rel")
    _draw_targets(m, axis, "floored_rel")


def _draw_memory(m: Measurement, axis: Any) -> None:
    _draw_curves(m, axis, lambda row: max(row.field_bytes, 1) / 1e6, m.metric)
    axis.set_title("Error and memory", loc="left", fontsize=11)
    axis.set_xlabel("MB of the light structure")
    axis.set_ylabel(m.metric)


# ---- Stages --------------------------------------------------------------------------------------


def _draw_stages(m: Measurement, axis: Any, answers: Mapping[str, Any], title: str) -> None:
    names = list(answers)
    axis.set_title(title, loc="left", fontsize=11)
    totals = sorted(p.total for p in answers.values() if not isinstance(p, NotReached))
    reach = totals[-1] if totals else 1.0
    if len(totals) > 1 and reach > LONGEST_BAR * totals[-2]:
        reach = LONGEST_BAR * totals[-2]
    for y, (_, point) in enumerate(answers.items()):
        if isinstance(point, NotReached):
            axis.text(0.01 * reach, y, f"not reached: {point.reason}", va="center", fontsize=8,
                      color=GREY)  # fmt: skip
            continue
        left = 0.0
        for stage in STAGES:
            shown = max(min(point.stages[stage], reach - left), 0.0)
            axis.barh(y, shown, left=left, height=0.62, color=STAGE_COLOURS[stage])
            left += point.stages[stage]
        text = f" {tables.seconds(point.total)} s, {percent(getattr(point, m.metric))}"
        if left > reach:
            text = f"{text}, not to scale"
        axis.text(min(left, reach), y, text, va="center", fontsize=8)
    axis.set_yticks(range(len(names)), names, fontsize=8)
    axis.set_ylim(len(names) - 0.5, -0.5)
    axis.set_xlim(0, 1.4 * reach)
    axis.set_xlabel("CPU s", fontsize=9)
    axis.tick_params(axis="x", labelsize=8)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)


# ---- Images --------------------------------------------------------------------------------------


def to_display(image: NDArray[Any], white: float) -> NDArray[Any]:
    """sRGB in [0,1], row 0 at the top, of linear radiance of which `white` is white."""
    linear = np.clip(np.asarray(image[::-1], np.float64) / white, 0.0, 1.0)
    power = 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, power)


def _draw_images(m: Measurement, shown: Mapping[str, Row], place: Any) -> None:
    truth = m.reference.image
    lit = truth[truth > 0.0]
    white = float(np.percentile(lit, WHITE_PERCENTILE)) if lit.size else 1.0

    def show(axis: Any, image: NDArray[Any], title: str) -> None:
        axis.imshow(to_display(image, white), interpolation="nearest", aspect="auto")
        axis.set_title(title, fontsize=9, pad=3)

    show(place(0, 0), truth, f"reference: {m.reference.name}")
    for column, row in enumerate(shown.values(), 1):
        image = m.image(row.setting)
        show(place(column, 0), image, str(row.setting).replace(", ", "\n", 1))
        difference = DIFFERENCE_FACTOR * np.abs(image - truth)
        text = f"difference x{DIFFERENCE_FACTOR:g}: {percent(row.error('rel_rmse'))} rel_rmse, "
        show(place(column, 1), difference, text + f"{tables.seconds(row.total)} s")
    place(0, 1).text(
        0.5, 0.5,
        "For each estimator the setting\nthat is nearest to equal time.\n\n"
        f"White: radiance {white:.3g}, the 99th\npercentile of the reference.",
        ha="center", va="center", fontsize=9, color=GREY,
    )  # fmt: skip
