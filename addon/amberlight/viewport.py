# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendered mode of a 3D view: renders again after each change, and shows what there is so far."""

from __future__ import annotations

from typing import Any

from .binding import library
from .binding.handles import import_numpy
from .export.conventions import projection_window
from .export.export_log import ExportLog
from .export.extract import extract_scene
from .export.extract_camera import matrix_rows
from .export.scene_data import CameraData, SceneData
from .properties import read_settings
from .render_job import Frame, RenderJob, render_params

SAMPLES = 16
LIGHT_SAMPLES = 200_000


class Viewport:
    """Exported scene, running render and picture of one 3D view."""

    def __init__(self) -> None:
        self.data: SceneData | None = None
        self.job: RenderJob | None = None
        self.view: Any = None
        self.shown_samples = 0
        self.texture: Any = None

    def __del__(self) -> None:
        # Goes with its engine, which Blender has already taken apart by then.
        self.stop()

    def update(self, engine: Any, context: Any, depsgraph: Any) -> None:
        """The scene changed: export it anew."""
        self.stop()
        import_numpy()
        self.data = extract_scene(depsgraph, ExportLog(), with_camera=False)
        engine.tag_redraw()

    def draw(self, engine: Any, context: Any, depsgraph: Any) -> None:
        """Blender does not say that the view moved: compare what it depends on."""
        region, view = context.region, context.region_data
        key = (
            region.width,
            region.height,
            matrix_rows(view.view_matrix),
            matrix_rows(view.window_matrix),
        )
        if self.data and (self.job is None or key != self.view):
            self.stop()
            self.view = key
            self.start(context, depsgraph, self.data)
        if self.job:
            progress = self.job.render.progress()
            engine.update_stats("Amberlight", f"{progress.stage}: {progress.detail}")
            if progress.samples_done > self.shown_samples:
                self.texture = make_texture(self.job.render.read_pass("Combined"))
                self.shown_samples = progress.samples_done
            if not self.job.render.wait(0.0):
                engine.tag_redraw()
        if self.texture:
            draw_texture(engine, depsgraph.scene, self.texture, (region.width, region.height))

    def stop(self) -> None:
        if self.job:
            self.job.close()
        self.job = None
        self.shown_samples = 0

    def start(self, context: Any, depsgraph: Any, data: SceneData) -> None:
        settings = read_settings(depsgraph.scene).limited(SAMPLES, LIGHT_SAMPLES)
        frame = Frame(context.region.width, context.region.height)
        data.camera = read_view(context)
        params = render_params(settings, frame)
        self.job = RenderJob(library.load(), data, params)


def read_view(context: Any) -> CameraData:
    """The view as a camera, without its depth of field."""
    view, space = context.region_data, context.space_data
    orthographic = view.window_matrix[3][3] == 1.0
    clip_start, clip_end = space.clip_start, space.clip_end
    if view.view_perspective == "CAMERA" and space.camera and space.camera.type == "CAMERA":
        clip_start, clip_end = space.camera.data.clip_start, space.camera.data.clip_end
    elif orthographic:
        # A free orthographic view has no place of its own: it shows what lies behind it too.
        clip_start = -clip_end
    return CameraData(
        matrix_rows(view.view_matrix.inverted()),
        projection_window(view.window_matrix, orthographic),
        orthographic,
        clip_start,
        clip_end,
    )


def make_texture(pixels: Any) -> Any:
    """`pixels`: (height, width, 4) float32."""
    import gpu

    height, width = pixels.shape[:2]
    buffer = gpu.types.Buffer("FLOAT", pixels.size, pixels.reshape(-1))
    return gpu.types.GPUTexture((width, height), format="RGBA16F", data=buffer)


def draw_texture(engine: Any, scene: Any, texture: Any, size: tuple[int, int]) -> None:
    import gpu
    from gpu_extras.presets import draw_texture_2d

    gpu.state.blend_set("ALPHA_PREMULT")
    engine.bind_display_space_shader(scene)
    try:
        draw_texture_2d(texture, (0, 0), *size)
    finally:
        engine.unbind_display_space_shader()
        gpu.state.blend_set("NONE")
