# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel of the cost report."""

from __future__ import annotations

from typing import Any

import bpy

from .ui import _Panel


class AMBERLIGHT_UL_cost_rows(bpy.types.UIList):
    """Estimator, budget, CPU seconds, error; the best of each estimator has a mark."""

    def draw_item(
        self, context: Any, layout: Any, data: Any, item: Any, icon: int, active_data: Any,
        active_name: str, index: int = 0, flag: int = 0,
    ) -> None:  # fmt: skip
        mark = "SOLO_ON" if item.is_best else "BLANK1"
        split = layout.split(factor=0.62)
        split.label(text=f"{item.estimator} {item.budget}", icon=mark)
        row = split.row()
        row.label(text=f"{item.total:.3g} s")
        row.label(text=f"{100 * item.error:.3g} %")


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
            # The active row; the default of the operator may be a row that was applied before.
            self.layout.operator("amberlight.apply_cost_row").index = -1


CLASSES = (AMBERLIGHT_UL_cost_rows, AMBERLIGHT_RENDER_PT_cost)


def register() -> None:
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
