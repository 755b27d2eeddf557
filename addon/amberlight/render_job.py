# SPDX-License-Identifier: GPL-3.0-or-later
"""One render of one exported scene: settings to parameters, start, poll, cancel. No Blender."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from .binding import _ffi
from .binding.errors import AmbCancelled
from .binding.handles import Progress, Render, Scene
from .binding.library import Library
from .export.scene_data import SceneData
from .export.upload import upload

ESTIMATORS = {
    "AUTO": _ffi.AMB_ESTIMATOR_AUTO,
    "POINTS_FIXED": _ffi.AMB_ESTIMATOR_POINTS_FIXED,
    "POINTS_COVARIANCE": _ffi.AMB_ESTIMATOR_POINTS_COVARIANCE,
    "TUBES": _ffi.AMB_ESTIMATOR_TUBES,
    "SPECULAR": _ffi.AMB_ESTIMATOR_SPECULAR,
}

EFFECTS = {
    "use_single_scattering": _ffi.AMB_EFFECT_SINGLE_SCATTERING,
    "use_double_scattering": _ffi.AMB_EFFECT_DOUBLE_SCATTERING,
    "use_multiple_scattering": _ffi.AMB_EFFECT_MULTIPLE_SCATTERING,
    "use_world_light": _ffi.AMB_EFFECT_WORLD_LIGHT,
    "use_surface_reflection": _ffi.AMB_EFFECT_SURFACE_REFLECTION,
    "use_background": _ffi.AMB_EFFECT_BACKGROUND,
    "use_transmitted_light": _ffi.AMB_EFFECT_TRANSMITTED_LIGHT,
    "use_caustics": _ffi.AMB_EFFECT_CAUSTICS,
    "use_interreflection": _ffi.AMB_EFFECT_INTERREFLECTION,
    "use_lamp_images": _ffi.AMB_EFFECT_LAMP_IMAGES,
}
SCATTER_ESTIMATORS = {
    "AUTO": _ffi.AMB_SCATTER_AUTO,
    "WALK": _ffi.AMB_SCATTER_WALK,
    "PHOTONS": _ffi.AMB_SCATTER_PHOTONS,
    "TREE_CUT": _ffi.AMB_SCATTER_TREE_CUT,
}
MIB = 1 << 20

# Seconds between looks at a running render: well inside the 0.2 s that a cancel may take.
POLL_SECONDS = 0.05


@dataclass(frozen=True)
class Settings:
    """scene.amberlight as plain values; the same names and defaults."""

    estimator: str = "AUTO"
    samples: int = 16
    accuracy: float = 0.0
    light_samples: int = 1_000_000
    kernel_size: float = 4.0
    tube_refinement: int = 0
    effects: str = "AUTO"
    use_single_scattering: bool = True
    use_double_scattering: bool = False
    use_multiple_scattering: bool = False
    use_world_light: bool = False
    use_surface_reflection: bool = True
    use_background: bool = True
    use_transmitted_light: bool = True
    use_caustics: bool = True
    use_interreflection: bool = True
    use_lamp_images: bool = True
    light_bounces: int = 0
    camera_bounces: int = 0
    adjoint_normals: bool = True
    seed: int = 0
    scatter_estimator: str = "AUTO"
    scatter_order_max: int = 0
    memory_limit: int = 0

    def limited(self, samples: int, light_samples: int) -> Settings:
        """With at most these budgets, and no target beyond them: for previews."""
        return replace(
            self,
            samples=min(self.samples, samples),
            light_samples=min(self.light_samples, light_samples),
            accuracy=0.0,
        )


@dataclass(frozen=True)
class Frame:
    """The image: full size in pixels, rectangle (x, y, width, height) to render, threads, and
    whether a coarse picture comes first."""

    width: int
    height: int
    crop: tuple[int, int, int, int] | None = None
    threads: int = 0
    film_transparent: bool = False
    coarse_first: bool = False


def effect_bits(settings: Settings) -> int:
    """AUTO allows all; the library decides what the scene is worth."""
    bits = 0
    for name, bit in EFFECTS.items():
        if settings.effects == "AUTO" or getattr(settings, name):
            bits |= bit
    return bits


def render_params(settings: Settings, frame: Frame) -> dict[str, Any]:
    """Members of AmbRenderParams."""
    crop = frame.crop or (0, 0, 0, 0)
    return {
        "width": frame.width,
        "height": frame.height,
        "crop_x": crop[0],
        "crop_y": crop[1],
        "crop_width": crop[2],
        "crop_height": crop[3],
        "samples": settings.samples,
        "estimator": ESTIMATORS[settings.estimator],
        "effects": effect_bits(settings),
        "light_samples": settings.light_samples,
        "kernel_size": settings.kernel_size,
        "light_bounces": settings.light_bounces,
        "camera_bounces": settings.camera_bounces,
        "adjoint_normals": int(settings.adjoint_normals),
        "seed": settings.seed,
        "threads": frame.threads,
        "film_transparent": int(frame.film_transparent),
        "coarse_first": int(frame.coarse_first),
        "tube_refinement": settings.tube_refinement,
        "accuracy": settings.accuracy,
        "scatter_estimator": SCATTER_ESTIMATORS[settings.scatter_estimator],
        "scatter_order_max": settings.scatter_order_max,
        "effects_are_auto": int(settings.effects == "AUTO"),
        "memory_limit": settings.memory_limit * MIB,
    }


def committed_scene(library: Library, data: SceneData) -> Scene:
    """The data in the library, ready to be rendered."""
    scene = Scene(library)
    try:
        upload(data, scene)
        scene.commit()
    except BaseException:
        scene.close()
        raise
    return scene


class RenderJob:
    """A scene in the library and its render; a context manager that frees both."""

    def __init__(self, library: Library, data: SceneData, params: dict[str, Any]) -> None:
        self.scene = committed_scene(library, data)
        try:
            self.render = Render(self.scene, **params)
        except BaseException:
            self.scene.close()
            raise

    def __enter__(self) -> RenderJob:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Cancels if needed, then frees."""
        self.render.close()
        self.scene.close()

    def run(
        self,
        poll: Callable[[Progress], bool],
        is_enough: Callable[[Progress], bool] = lambda progress: False,
    ) -> bool:
        """Until the end, calling `poll` on the way; its False cancels.

        True if there is a picture: the render is complete, or `is_enough` of it is done, which
        then goes on until the job is closed. False if it was cancelled; raises its error.
        """
        ended = False
        while not ended:
            try:
                ended = self.render.wait(POLL_SECONDS)
            except AmbCancelled:
                return False
            progress = self.render.progress()
            if not poll(progress) and not ended:
                self.render.cancel()
            elif is_enough(progress):
                return True
        return True
