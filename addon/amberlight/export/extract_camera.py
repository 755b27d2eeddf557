# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's camera object -> CameraData."""

from __future__ import annotations

from typing import Any

from ..binding.errors import AmberlightError
from . import conventions as conv
from .export_log import ExportLog
from .scene_data import CameraData, Matrix


def matrix_rows(matrix: Any) -> Matrix:
    """A mathutils matrix as rows of floats, copied."""
    return tuple(tuple(row) for row in matrix)


def read_camera(camera_object: Any, render: Any, log: ExportLog) -> CameraData:
    """`camera_object`: evaluated bpy Object; `render`: RenderSettings. The window is that of the
    full image; a border crops pixels, not the window."""
    if camera_object is None:
        raise AmberlightError("the scene has no camera: add one and make it the active camera")
    camera = camera_object.data
    if camera_object.type != "CAMERA":
        raise AmberlightError(
            f'the object "{camera_object.name}" cannot be the camera: choose a camera object'
        )
    if camera.type not in {"PERSP", "ORTHO"}:
        raise AmberlightError(
            f'the camera "{camera_object.name}" is of type {camera.type.lower()}: Amberlight '
            "renders perspective and orthographic cameras"
        )
    # As in Blender, the camera's scale has no effect.
    matrix = camera_object.matrix_world.normalized()
    orthographic = camera.type == "ORTHO"
    window = conv.camera_window(
        is_orthographic=orthographic,
        lens=camera.lens,
        ortho_scale=camera.ortho_scale,
        sensor_fit=camera.sensor_fit,
        sensor_width=camera.sensor_width,
        sensor_height=camera.sensor_height,
        shift=(camera.shift_x, camera.shift_y),
        resolution=resolution(render),
        pixel_aspect=(render.pixel_aspect_x, render.pixel_aspect_y),
    )
    radius = distance = 0.0
    if camera.dof.use_dof:
        radius = conv.lens_radius(camera.lens, camera.dof.aperture_fstop, orthographic)
        distance = _focus_distance(camera, matrix)
        if camera.dof.aperture_blades > 2 or camera.dof.aperture_ratio != 1.0:
            log.warn(f'camera "{camera_object.name}"', "the aperture is rendered as round")
    return CameraData(
        matrix_rows(matrix),
        window,
        orthographic,
        camera.clip_start,
        camera.clip_end,
        radius,
        distance,
    )


def resolution(render: Any) -> tuple[int, int]:
    """(width, height) of the full image, pixels, truncated as Blender truncates it."""
    scale = render.resolution_percentage
    return (
        max(render.resolution_x * scale // 100, 1),
        max(render.resolution_y * scale // 100, 1),
    )


def _focus_distance(camera: Any, matrix: Any) -> float:
    target = camera.dof.focus_object
    if target is None:
        return max(float(camera.dof.focus_distance), 1e-5)
    forward = matrix.to_3x3().col[2]
    offset = target.matrix_world.translation - matrix.translation
    return max(abs(float(forward.dot(offset))), 1e-5)
