# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel of the cost report."""

from __future__ import annotations

from typing import Any

import bpy

from .ui import _Panel


def short_name(row: Any) -> str:
    """A row in the width of a narrow panel: Fixed 512k 0.5."""
    name = row.estimator.removeprefix("POINTS_").capitalize()
    if row.light_samples:
        return f"{name} {row.light_samples / 1024:g}k {row.kernel_size:g}"
    return f"{name} {row.tube_refinement}" if row.estimator == "TUBES" else name


class AMBERLIGHT_UL_cost_rows(bpy.types.UIList):
    """Estimator, budget, CPU seconds, error; the best of each estimator has a mark."""

    def draw_item(
        self, context: Any, layout: Any, data: Any, item: Any, icon: int, active_data: Any,
        active_name: str, index: int = 0, flag: int = 0,
    ) -> None:  # fmt: skip
        mark = "SOLO_ON" if item.is_best else "BLANK1"
        split = layout.split(factor=0.5)
        split.label(text=short_name(item), icon=mark)
        split.label(text=f"{item.total:.2g} s, {100 * item.error:.2g} %")


class AMBERLIGHT_RENDER_PT_cost(_Panel, bpy.types.Panel):
    bl_label = "Accuracy Cost"
    bl_context = "render"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: Any) -> None:
        wanted, state = context.scene.amberlight_cost, context.window_manager.amberlight_cost
        col = self.column(self.layout)
        col.enabled = not state.is_running
        for name in ("size", "samples", "time_limit", "repeats", "metric"):
            col.prop(wanted, name)
        for name in ("equal_error", "equal_time", "reference", "directory"):
            col.prop(wanted, name)
        self.layout.operator("amberlight.measure_cost", icon="SORTTIME")
        if state.is_running:
            self.layout.prop(state, "fraction", slider=True)
            self.layout.label(text=state.text)
        if state.rows:
            self.layout.template_list("AMBERLIGHT_UL_cost_rows", "", state, "rows", state, "active")
            if 0 <= state.active < len(state.rows):
                row = state.rows[state.active]
                col = self.layout.column(align=True)
                for text in (
                    row.estimator,
                    row.budget,
                    f"{row.total:.3g} CPU s, {100 * row.error:.3g} %",
                ):
                    if text:
                        col.label(text=text)
            # The active row; the default of the operator may be a row that was applied before.
            self.layout.operator("amberlight.apply_cost_row").index = -1


CLASSES = (AMBERLIGHT_UL_cost_rows, AMBERLIGHT_RENDER_PT_cost)


def register() -> None:
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
