# SPDX-License-Identifier: GPL-3.0-or-later
"""The render engine: lifecycle, passes, and the one place where errors become reports.

Blender crashes if render() raises, or returns with neither a finished result nor an ERROR report.
So every way out of render() is one of three: a finished result; an ERROR report, with a result
that was begun ended; after a break, a result ended with cancel.
"""

from __future__ import annotations

import json
import logging
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from . import report as reports
from .binding import library
from .binding.errors import AmberlightError
from .binding.handles import Progress, import_numpy
from .export.conventions import border_rectangle
from .export.export_log import ExportLog
from .export.extract import extract_scene
from .export.extract_camera import resolution
from .export.scene_data import SceneData
from .passes import COMBINED, PASSES, Pass
from .properties import read_settings
from .render_job import Frame, RenderJob, Settings, render_params
from .viewport import Viewport

log = logging.getLogger("amberlight")

PREVIEW_SAMPLES = 8
PREVIEW_LIGHT_SAMPLES = 20_000
# A preview shows what it has after this time, if every pixel has a sample.
PREVIEW_SECONDS = 1.0
# Seconds between pictures of an unfinished render in the user interface, and the least of this
# time in units of what such a picture takes: while it is made nothing looks for a break.
DISPLAY_SECONDS = 1.0
DISPLAY_INTERVAL = 10.0
# Seconds between texts of one stage: a background Blender prints a line for each.
STATS_SECONDS = 0.5


@dataclass(frozen=True)
class Exported:
    """What a final render begins with."""

    data: SceneData
    settings: Settings
    frame: Frame
    messages: ExportLog


# Where a list stands here, the next final render is put into it and not rendered.
_wanted: list[Exported] | None = None
# What would crop a picture, or do more than render it.
CAPTURE_OFF = ("use_border", "use_compositing", "use_sequencer")


def export_for_render(scene: Any, layer: str) -> Exported:
    """The scene as F12 sees it: only a render evaluates it so. The picture of an earlier render
    stays in its slot; RuntimeError with Blender's or our own words where nothing can be rendered.
    """
    global _wanted
    kept = {name: getattr(scene.render, name) for name in CAPTURE_OFF}
    result = next((image for image in bpy.data.images if image.type == "RENDER_RESULT"), None)
    slots = result.render_slots if result else ()
    active = slots.active_index if result else 0
    _wanted = found = []
    try:
        for name in CAPTURE_OFF:
            setattr(scene.render, name, False)
        if len(slots) > 1:
            slots.active_index = len(slots) - (2 if active == len(slots) - 1 else 1)
        bpy.ops.render.render(scene=scene.name, layer=layer)
    finally:
        _wanted = None
        for name, value in kept.items():
            setattr(scene.render, name, value)
        if len(slots) > 1:
            slots.active_index = active
    if not found:
        raise RuntimeError("Blender did not render the scene")
    return found[0]


class AmberlightRenderEngine(bpy.types.RenderEngine):
    bl_idname = "AMBERLIGHT"
    bl_label = "Amberlight"
    bl_use_preview = True
    bl_use_eevee_viewport = True
    bl_use_shading_nodes_custom = False

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.viewport: Viewport | None = None

    # ---- Final and preview renders ---------------------------------------------------------------

    def update_render_passes(self, scene: Any = None, renderlayer: Any = None) -> None:
        for item in PASSES:
            if item.name != "Depth" or renderlayer.use_pass_z:
                self.register_pass(
                    scene, renderlayer, item.name, item.channels, item.channel_ids, item.kind
                )

    def render(self, depsgraph: Any) -> None:
        try:
            self._render(depsgraph)
        except AmberlightError as error:
            log.debug("render failed", exc_info=True)
            self.fail(str(error))
        except UnicodeDecodeError as error:
            self.fail(no_text(error))
        except Exception as error:
            log.exception("internal error")
            self.fail(f"internal error: {type(error).__name__}: {error}")

    def fail(self, message: str) -> None:
        """Ends with an error: exit code 1 of a background render, and no image."""
        self.report({"ERROR"}, f"Amberlight: {message}")

    def _render(self, depsgraph: Any) -> None:
        scene = depsgraph.scene
        layer = depsgraph.view_layer_eval.name
        messages = ExportLog()
        loaded = library.load()
        import_numpy()
        if loaded.is_replaced:
            messages.warn(str(loaded.path), "the library was replaced, restart Blender to use it")
        wall, cpu = time.perf_counter(), time.process_time()
        data = extract_scene(depsgraph, messages, camera=self.camera_override)
        stage = {
            "name": "export",
            "cpu_s": time.process_time() - cpu,
            "wall_s": time.perf_counter() - wall,
        }

        # The evaluated scene has the values of animated settings.
        settings = read_settings(depsgraph.scene_eval)
        if self.is_preview:
            settings = settings.limited(PREVIEW_SAMPLES, PREVIEW_LIGHT_SAMPLES)
        if scene.render.use_motion_blur:
            messages.warn(f'scene "{scene.name}"', "motion blur is ignored")
        if scene.render.use_multiview:
            messages.warn(f'scene "{scene.name}"', "stereoscopy is ignored")
        frame = self.frame(scene)
        if _wanted is not None and not self.is_preview:
            _wanted.append(Exported(data, settings, frame, messages))
            self.end_result(self.begin_result(0, 0, frame.width, frame.height, layer=layer))
            return
        params = render_params(settings, frame)
        with RenderJob(loaded, data, params) as job:
            del data  # The library has its own copy.
            if not job.run(_Poll(self, job, scene, layer), self.is_enough):
                self.end_result(self.begin(job, layer), cancel=True)
            elif self.is_preview:
                self.show(job, layer)
            else:
                self.finish(scene, layer, job, messages, stage)

    def is_enough(self, progress: Progress) -> bool:
        is_late = progress.elapsed > PREVIEW_SECONDS and progress.samples_done > 0
        return self.is_preview and is_late

    def finish(
        self, scene: Any, layer: str, job: RenderJob, messages: ExportLog, stage: dict[str, Any]
    ) -> None:
        """Files, result, report and remarks of a complete render."""
        report = job.render.report()
        # The library knows nothing of the export: add what it took and what it could not follow.
        report.setdefault("stages", []).insert(0, stage)
        said = [{"text": line, "count": 1} for line in messages.lines()]
        report["warnings"] = said + report.get("warnings", [])
        self.write_files(scene, layer, job, report)
        self.show(job, layer)
        summary = reports.Summary(reports.summary_lines(report), reports.warning_lines(report))
        reports.LAST[scene.name] = summary
        if bpy.app.background:
            for line in summary.lines:
                say(f"{self.prefix(scene, layer)}{line}")
        if summary.warnings:
            self.report({"WARNING"}, f"Amberlight: {reports.joined_warning(summary.warnings)}")

    @staticmethod
    def prefix(scene: Any, layer: str) -> str:
        """Names the view layer where there are several."""
        return f'view layer "{layer}", ' if len(layer_names(scene)) > 1 else ""

    def frame(self, scene: Any) -> Frame:
        render = scene.render
        width, height = resolution(render)
        crop = None
        if render.use_border and not self.is_preview:
            border = (
                render.border_min_x,
                render.border_max_x,
                render.border_min_y,
                render.border_max_y,
            )
            crop = border_rectangle(border, (width, height))
        threads = render.threads if render.threads_mode == "FIXED" else 0
        return Frame(width, height, crop, threads, render.film_transparent)

    def begin(self, job: RenderJob, layer: str) -> Any:
        # Blender counts from the corner of the border, if there is one.
        return self.begin_result(0, 0, *job.render.size, layer=layer)

    def show(self, job: RenderJob, layer: str, passes: tuple[Pass, ...] = PASSES) -> None:
        """Hands the pixels of passes of the view layer to Blender."""
        for item in passes:
            if not item.is_builtin:
                self.add_pass(item.name, item.channels, item.channel_ids, layer=layer)
        result = self.begin(job, layer)
        is_shown = False
        try:
            width, height = job.render.size
            if (result.resolution_x, result.resolution_y) != (width, height):
                raise AmberlightError(
                    f"Blender expects {result.resolution_x}x{result.resolution_y} pixels, "
                    f"the library rendered {width}x{height}"
                )
            known = {item.name: item for item in passes}
            for target in result.layers[0].passes:
                item = known.get(target.name)
                if item and item.channels == target.channels:
                    write_pixels(target, job.render.read_pass(item.name))
            is_shown = True
        finally:
            self.end_result(result, cancel=not is_shown)

    def write_files(self, scene: Any, layer: str, job: RenderJob, report: dict[str, Any]) -> None:
        """The EXR and the JSON report that the settings ask for."""
        names = layer_names(scene)
        index = names.index(layer) if layer in names else 0
        settings = scene.amberlight

        def path_of(template: str) -> str:
            path = bpy.path.abspath(template)
            path = reports.output_path(path, scene.frame_current, index, layer)
            os.makedirs(os.path.dirname(os.path.abspath(path)), exist_ok=True)
            return path

        try:
            if settings.exr_path:
                job.render.write_exr(path_of(settings.exr_path), layer)
            if settings.report_path:
                text = json.dumps(report, indent=1, ensure_ascii=False)
                Path(path_of(settings.report_path)).write_text(text + "\n", encoding="utf-8")
        except OSError as error:
            raise AmberlightError(f"the render is complete but not written: {error}") from error

    # ---- Viewport --------------------------------------------------------------------------------

    def view_update(self, context: Any, depsgraph: Any) -> None:
        if self.viewport is None:
            self.viewport = Viewport()
        self.guarded(self.viewport.update, self, context, depsgraph)

    def view_draw(self, context: Any, depsgraph: Any) -> None:
        if self.viewport is None:
            self.viewport = Viewport()
        self.guarded(self.viewport.draw, self, context, depsgraph)

    def guarded(self, function: Any, *args: Any) -> None:
        """A viewport shows its error as a line of text; it never raises."""
        try:
            function(*args)
        except AmberlightError as error:
            self.update_stats("Amberlight", str(error))
        except UnicodeDecodeError as error:
            self.update_stats("Amberlight", no_text(error))
        except Exception as error:
            log.exception("internal error")
            self.update_stats("Amberlight", f"internal error: {error}")


class _Poll:
    """Called on the way through a render: progress and text out, a break in."""

    def __init__(
        self, engine: AmberlightRenderEngine, job: RenderJob, scene: Any, layer: str
    ) -> None:
        self.engine = engine
        self.job = job
        self.layer = layer
        self.prefix = engine.prefix(scene, layer)
        self.stage = ""
        self.text = ""
        self.told_at = 0.0
        self.shown_samples = 0
        self.show_at = time.perf_counter() + DISPLAY_SECONDS

    def __call__(self, progress: Progress) -> bool:
        engine = self.engine
        engine.update_progress(progress.fraction)
        self.tell(progress)
        if bpy.app.background:
            if progress.stage != self.stage and not engine.is_preview:
                say(f"{self.prefix}{progress.stage}: {progress.detail}")
        elif not engine.is_preview:
            self.show(progress)
        self.stage = progress.stage
        return not engine.test_break()

    def show(self, progress: Progress) -> None:
        """The picture as far as it is done."""
        begin = time.perf_counter()
        is_new = progress.samples_done > self.shown_samples and progress.fraction < 1.0
        if is_new and begin >= self.show_at and not self.engine.test_break():
            self.engine.show(self.job, self.layer, (COMBINED,))
            self.shown_samples = progress.samples_done
            end = time.perf_counter()
            self.show_at = end + max(DISPLAY_SECONDS, DISPLAY_INTERVAL * (end - begin))

    def tell(self, progress: Progress) -> None:
        """The text of the status line: each stage at once, what changes within it now and then."""
        text = f"{self.layer} | {progress.stage}: {progress.detail}"
        now = time.perf_counter()
        is_due = progress.stage != self.stage or now - self.told_at >= STATS_SECONDS
        if is_due and text != self.text:
            self.engine.update_stats("", text)
            self.text, self.told_at = text, now


def layer_names(scene: Any) -> list[str]:
    """The view layers that are rendered, in order."""
    return [layer.name for layer in scene.view_layers if layer.use]


def no_text(error: UnicodeDecodeError) -> str:
    """A damaged file may hold names that Blender itself cannot hand out."""
    return f'the name "{error.object.decode(errors="replace")}" is not UTF-8, rename what has it'


def write_pixels(target: Any, pixels: Any) -> None:
    """`pixels`: (height, width, channels) float32 -> the RenderPass, through one buffer copy.

    Blender before 4.1 takes one item for each pixel, and checks no more than their number.
    """
    flat = pixels.reshape(-1)
    if bpy.app.version < (4, 1):
        flat = pixels.reshape(-1, target.channels)
    target.rect.foreach_set(flat)


def say(line: str) -> None:
    """A line for those who render without a window, at once: a crash must not swallow it."""
    print(f"Amberlight: {line}", flush=True)


def register() -> None:
    bpy.utils.register_class(AmberlightRenderEngine)


def unregister() -> None:
    bpy.utils.unregister_class(AmberlightRenderEngine)
