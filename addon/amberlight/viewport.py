# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendered mode of a 3D view: renders again after each change, and shows what there is so far."""

from __future__ import annotations

from typing import Any, NamedTuple

from .binding import library
from .binding.handles import Render, Scene, import_numpy
from .export.conventions import projection_window
from .export.export_log import ExportLog
from .export.extract import extract_scene
from .export.extract_camera import matrix_rows
from .export.scene_data import CameraData, SceneData
from .export.upload import set_camera
from .properties import read_settings
from .render_job import Frame, committed_scene, render_params


class Budget(NamedTuple):
    """What a picture may cost at most."""

    samples: int
    light_samples: int


# Who turns the view or a knob waits for a draft, whose light costs a tenth. It gives way to the
# picture once it shows so many pixels: the rest would take as long as the picture's first sample.
DRAFT, PICTURE = Budget(1, 4_000), Budget(16, 200_000)
DRAFT_STEP = 2
NOTHING = 1 << 30  # step of a picture that shows nothing


class Viewport:
    """Exported scene, running render and picture of one 3D view."""

    def __init__(self) -> None:
        self.data: SceneData | None = None
        self.scene: Scene | None = None  # the data in the library
        self.render: Render | None = None
        self.budget = DRAFT  # the render's
        self.view: Any = None
        self.shown: Any = None  # how much of the render the picture has
        self.step = NOTHING  # the picture shows every so many pixels of the view
        self.texture: Any = None
        self.size = (0, 0)  # of the picture in the region, pixels

    def __del__(self) -> None:
        # Goes with its engine, which Blender has already taken apart by then.
        self.forget_scene()

    def update(self, engine: Any, context: Any, depsgraph: Any) -> None:
        """The scene changed: export it anew."""
        self.forget_scene()
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
        if self.data and (self.render is None or key != self.view):
            self.view, self.step = key, NOTHING
            self.start(context, depsgraph, self.data, DRAFT)
        if self.render:
            progress = self.render.progress()
            engine.update_stats("Amberlight", f"{progress.stage}: {progress.detail}")
            done = (progress.pixel_step, progress.samples_done)
            if 0 < progress.pixel_step <= self.step and done != self.shown:
                self.take_picture(self.render, progress.pixel_step)
                self.shown = done
            has_ended = self.render.wait(0.0)
            if self.data and self.budget is DRAFT and (has_ended or self.step <= DRAFT_STEP):
                self.start(context, depsgraph, self.data, PICTURE)
                has_ended = False
            if not has_ended:
                engine.tag_redraw()
        if self.texture:
            draw_texture(engine, depsgraph.scene, self.texture, self.size)

    def take_picture(self, render: Render, step: int) -> None:
        """Of the pixels that are there; each stands for those up to the next."""
        pixels = render.read_pass("Combined")[::step, ::step]
        self.step = step
        self.texture = make_texture(pixels)
        self.size = (step * pixels.shape[1], step * pixels.shape[0])

    def stop(self) -> None:
        if self.render:
            self.render.close()
        self.render = self.shown = None

    def forget_scene(self) -> None:
        self.stop()
        if self.scene:
            self.scene.close()
        self.scene = None

    def start(self, context: Any, depsgraph: Any, data: SceneData, budget: Budget) -> None:
        self.stop()
        self.budget = budget
        settings = read_settings(depsgraph.scene).limited(*budget)
        frame = Frame(context.region.width, context.region.height, coarse_first=True)
        data.camera = read_view(context)
        if self.scene:
            set_camera(self.scene, data.camera)
        else:
            self.scene = committed_scene(library.load(), data)
        self.render = Render(self.scene, **render_params(settings, frame))


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
