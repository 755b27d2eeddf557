# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the cost report: measure it, and apply one of its rows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy
from bpy.props import IntProperty

from .binding import library
from .binding.errors import AmberlightError
from .binding.handles import import_numpy
from .engine import Exported, export_for_render
from .render_job import render_params

if TYPE_CHECKING:
    from .cost.session import Outcome, Request, Worker

TIMER_SECONDS = 0.1


def cost_request(scene: Any, exported: Exported, name: str, folder: Path) -> Request:
    """What scene.amberlight_cost asks for, for a scene that was exported."""
    import_numpy()
    from .cost.bench import Options
    from .cost.references import load_reference
    from .cost.scenes import image_size
    from .cost.session import Request

    wanted = scene.amberlight_cost
    reference = None
    if wanted.reference:
        reference = load_reference(Path(bpy.path.abspath(wanted.reference)))
    frame = exported.frame
    width, height = image_size((frame.width, frame.height), wanted.size, reference)
    frame = replace(frame, width=width, height=height, crop=None)
    settings = replace(exported.settings, samples=wanted.samples, accuracy=0.0)
    params = render_params(settings, frame)
    return Request(
        exported.data,
        name,
        params,
        Options(wanted.time_limit, wanted.repeats, wanted.metric, reference),
        folder,
        tuple(exported.messages.lines()),
        wanted.equal_error,
        wanted.equal_time,
    )


def scene_name(scene: Any) -> str:
    return Path(bpy.data.filepath).stem or scene.name


def output_folder(scene: Any) -> Path:
    """As set; a path beside a file that was never saved is in Blender's own temporary folder."""
    directory = scene.amberlight_cost.directory
    if directory.startswith("//") and not bpy.data.filepath:
        return Path(bpy.app.tempdir) / directory[2:]
    return Path(bpy.path.abspath(directory))


def start_worker(context: Any) -> Worker:
    scene = context.scene
    loaded = library.load()
    import_numpy()
    from .cost.session import Worker

    exported = export_for_render(scene, context.view_layer.name)
    worker = Worker(loaded, cost_request(scene, exported, scene_name(scene), output_folder(scene)))
    worker.start()
    return worker


def fill_rows(state: Any, outcome: Outcome) -> None:
    """The rows in the order of the tables: by estimator, the best ones first, then by cost."""
    found = outcome.measurement
    state.rows.clear()
    state.active = 0
    for name, front in found.fronts.items():
        rest = sorted((r for r in found.rows_of(name) if r not in front), key=lambda r: r.total)
        for row in [*front, *rest]:
            item = state.rows.add()
            item.estimator = name
            item.light_samples = row.setting.light_samples
            item.kernel_size = row.setting.kernel_size
            item.tube_refinement = row.setting.tube_refinement
            item.budget = row.setting.budget
            item.total = row.total
            item.error = row.error(found.metric)
            item.is_best = row in front


def show_picture(context: Any, path: Path) -> None:
    """In an image editor; without one, in a new window."""
    image = bpy.data.images.load(str(path), check_existing=True)
    image.reload()
    manager = context.window_manager
    areas = [area for window in manager.windows for area in window.screen.areas]
    editor = next((area for area in areas if area.type == "IMAGE_EDITOR"), None)
    if editor is None and manager.windows and not bpy.app.background:
        with context.temp_override(window=manager.windows[0]):
            bpy.ops.wm.window_new()
        editor = manager.windows[-1].screen.areas[0]
        editor.type = "IMAGE_EDITOR"
    if editor is not None:
        editor.spaces.active.image = image


class AMBERLIGHT_OT_measure_cost(bpy.types.Operator):
    bl_idname = "amberlight.measure_cost"
    bl_label = "Measure Accuracy Cost"
    bl_description = (
        "Render the scene with every estimator at a sweep of budgets, and compare errors with "
        "times. Esc stops"
    )

    # A Worker; Blender evaluates annotations of operators and does not know the name.
    worker: Any
    timer: Any

    @classmethod
    def poll(cls, context: Any) -> bool:
        is_running = context.window_manager.amberlight_cost.is_running
        return context.scene.render.engine == "AMBERLIGHT" and not is_running

    def begin(self, context: Any) -> bool:
        """True if the measurement runs."""
        try:
            self.worker = start_worker(context)
        except (AmberlightError, RuntimeError) as error:
            message = str(error).removeprefix("Error: ").rstrip()
            self.report({"ERROR"}, message)
            return False
        context.window_manager.amberlight_cost.is_running = True
        return True

    def execute(self, context: Any) -> set[str]:
        """Waits: for scripts, and in the background."""
        if not self.begin(context):
            return {"CANCELLED"}
        try:
            self.worker.join()
        except KeyboardInterrupt:
            self.worker.cancel()
            self.worker.join()
        return self.end(context)

    def invoke(self, context: Any, event: Any) -> set[str]:
        if not self.begin(context):
            return {"CANCELLED"}
        manager = context.window_manager
        self.timer = manager.event_timer_add(TIMER_SECONDS, window=context.window)
        manager.progress_begin(0.0, 1.0)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        if event.type == "ESC" and event.value == "PRESS":
            self.worker.cancel()
            return {"RUNNING_MODAL"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if self.worker.is_alive():
            self.show_progress(context)
            return {"PASS_THROUGH"}
        self.leave(context)
        return self.end(context)

    def cancel(self, context: Any) -> None:
        """Blender ends, or opens another file."""
        self.worker.cancel()
        self.worker.join()
        self.leave(context)
        context.window_manager.amberlight_cost.is_running = False

    def leave(self, context: Any) -> None:
        manager = context.window_manager
        manager.event_timer_remove(self.timer)
        manager.progress_end()
        if context.workspace:
            context.workspace.status_text_set(None)

    def show_progress(self, context: Any) -> None:
        manager, status = context.window_manager, self.worker.status
        state = manager.amberlight_cost
        state.fraction = 100.0 * status.fraction
        state.text = f"{status.text} ({status.row_count} rows)"
        manager.progress_update(status.fraction)
        context.workspace.status_text_set(f"Measuring accuracy cost: {state.text}. Esc stops")
        redraw(manager)

    def end(self, context: Any) -> set[str]:
        """The thread has ended: rows, picture and words."""
        state = context.window_manager.amberlight_cost
        state.is_running = False
        outcome = self.worker.outcome
        redraw(context.window_manager)
        if outcome is None:
            if self.worker.error is None:
                self.report({"WARNING"}, "Amberlight: the measurement was stopped")
            else:
                self.report({"ERROR"}, f"Amberlight: {self.worker.message}")
            return {"CANCELLED"}
        fill_rows(state, outcome)
        picture = next((file for file in outcome.files if file.suffix == ".png"), None)
        if picture:
            show_picture(context, picture)
        words = f"Amberlight: wrote {len(outcome.files)} files into {outcome.files[0].parent}"
        if outcome.said:
            self.report({"WARNING"}, f"{words}; {outcome.said}")
        else:
            self.report({"INFO"}, words)
        return {"FINISHED"}


class AMBERLIGHT_OT_apply_cost_row(bpy.types.Operator):
    bl_idname = "amberlight.apply_cost_row"
    bl_label = "Apply Row"
    bl_description = "Render with the estimator and the budget of a measured row"
    bl_options = {"REGISTER", "UNDO"}

    index: IntProperty(
        name="Row", description="The row to apply; -1 is the active one", min=-1, default=-1
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        return len(context.window_manager.amberlight_cost.rows) > 0

    def execute(self, context: Any) -> set[str]:
        state = context.window_manager.amberlight_cost
        index = self.index if self.index >= 0 else state.active
        if not 0 <= index < len(state.rows):
            self.report({"ERROR"}, f"there is no row {index}")
            return {"CANCELLED"}
        apply_row(context.scene.amberlight, state.rows[index])
        return {"FINISHED"}


def apply_row(settings: Any, row: Any) -> None:
    """Budgets that do not belong to the estimator keep their values. A target accuracy, which would
    choose others, is switched off."""
    settings.accuracy = 0.0
    settings.estimator = row.estimator
    if row.light_samples:
        settings.light_samples = row.light_samples
        settings.kernel_size = row.kernel_size
    if row.estimator == "TUBES":
        settings.tube_refinement = row.tube_refinement


def redraw(manager: Any) -> None:
    for window in manager.windows:
        for area in window.screen.areas:
            if area.type == "PROPERTIES":
                area.tag_redraw()


CLASSES = (AMBERLIGHT_OT_measure_cost, AMBERLIGHT_OT_apply_cost_row)


def register() -> None:
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
