# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene of a measurement in the library, the pixels that count, and the size of the image."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from ..binding.errors import AmberlightError
from ..binding.handles import Scene
from ..binding.library import Library
from ..export.scene_data import BLACK, WHITE, SceneData
from ..export.upload import upload
from .references import ImageReference


@contextmanager
def open_scenes(library: Library, data: SceneData) -> Iterator[tuple[Scene, Scene]]:
    """The committed scene, and its twin in which translucent objects glow and all else is black:
    where that one is not black, primary rays hit a translucent object."""
    with Scene(library) as scene, Scene(library) as twin:
        for target, source in ((scene, data), (twin, glowing(data))):
            upload(source, target)
            target.commit()
        yield scene, twin


def glowing(data: SceneData) -> SceneData:
    materials = [
        replace(
            material,
            is_dielectric=False,
            albedo=BLACK,
            emission=WHITE if material.is_dielectric else BLACK,
        )
        for material in data.materials
    ]
    return replace(data, materials=materials, lights=[], world=BLACK)


def image_size(
    scene_size: tuple[int, int], longest: int, reference: ImageReference | None
) -> tuple[int, int]:
    """Width and height in pixels: those of the reference, else the scene's own with at most
    `longest` pixels on the longer side; 0 for the scene's own."""
    width, height = scene_size
    if reference is not None:
        wide, high = reference.size
        if abs(wide * height / (high * width) - 1.0) > 0.01:
            raise AmberlightError(
                f"the reference {reference.name} has {wide} x {high} pixels, another shape than "
                f"the scene's {width} x {height}"
            )
        return wide, high
    scale = min(longest / max(width, height), 1.0) if longest > 0 else 1.0
    return max(round(width * scale), 1), max(round(height * scale), 1)
