# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders numpy scenes through the public C API, by way of the add-on's own ctypes binding.

The library is AMBERLIGHT_LIBRARY, else build/release/lib/libamberlight.so of this checkout.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from meshes import Mesh
from numpy.typing import ArrayLike, NDArray

ROOT = Path(__file__).resolve().parents[2]
LIBRARY = Path(os.environ.get("AMBERLIGHT_LIBRARY", ROOT / "build/release/lib/libamberlight.so"))
os.environ["AMBERLIGHT_LIBRARY"] = str(LIBRARY)
# The package above the binding imports bpy; the binding itself does not, so it is imported alone.
sys.path.append(str(ROOT / "addon/amberlight"))

from binding import _ffi, errors, handles, library  # noqa: E402, F401 - errors for the tests

POINTS_FIXED = _ffi.AMB_ESTIMATOR_POINTS_FIXED
POINTS_COVARIANCE = _ffi.AMB_ESTIMATOR_POINTS_COVARIANCE
TUBES = _ffi.AMB_ESTIMATOR_TUBES
SPECULAR = _ffi.AMB_ESTIMATOR_SPECULAR
POINTS = {"POINTS_FIXED": POINTS_FIXED, "POINTS_COVARIANCE": POINTS_COVARIANCE}
# Those that refract at the mesh's own triangles.
TRIANGLES = {"TUBES": TUBES, "SPECULAR": SPECULAR}
ESTIMATORS = POINTS | TRIANGLES
SINGLE = _ffi.AMB_EFFECT_SINGLE_SCATTERING

BuildScene = Callable[[handles.Scene], None]


@dataclass(frozen=True)
class Medium:
    """What fills a mesh; coefficients are RGB or one number for all channels, 1/m."""

    ior: float
    sigma_s: ArrayLike
    sigma_a: ArrayLike
    g: float = 0.0


@dataclass(frozen=True)
class Image:
    """``pixels``: (height, width, channels) float32, row 0 = top; ``cover``: (height, width), the
    part of each pixel's samples that hit something; ``report``: the library's own."""

    pixels: NDArray[np.float32]
    cover: NDArray[np.float32]
    report: dict[str, Any]


def rgb(value: ArrayLike) -> list[float]:
    """One number or three, as three."""
    return [float(v) for v in np.broadcast_to(np.asarray(value, dtype=np.float64), 3)]


def add_body(
    scene: handles.Scene, mesh: Mesh, medium: Medium, black: NDArray[np.bool_] | None = None
) -> None:
    """A dielectric object at the origin; the triangles in ``black`` absorb instead."""
    material = scene.add_material(
        "body",
        surface=_ffi.AMB_SURFACE_DIELECTRIC,
        ior=medium.ior,
        sigma_a=rgb(medium.sigma_a),
        lobes=[(rgb(medium.sigma_s), medium.g)],
    )
    absorber = scene.add_material("black", surface=_ffi.AMB_SURFACE_DIFFUSE, albedo=rgb(0))
    domain = _ffi.AMB_NORMALS_NONE if mesh.normals is None else _ffi.AMB_NORMALS_VERTEX
    slots = None if black is None else black.astype(np.uint32)
    shape = scene.add_mesh("body", mesh.positions, mesh.triangles, mesh.normals, domain, slots)
    scene.add_object("body", shape, np.eye(4).tolist(), [material, absorber])


def add_sun(scene: handles.Scene, direction: ArrayLike, irradiance: ArrayLike = 1.0) -> None:
    """``direction`` of travel; irradiance perpendicular to it, W/m^2."""
    travel = rgb(direction)
    scene.add_light(_ffi.AMB_LIGHT_SUN, "sun", color=rgb(irradiance), direction=travel)


def add_point(scene: handles.Scene, position: ArrayLike, intensity: ArrayLike) -> None:
    """Radiant intensity in W/sr."""
    place = rgb(position)
    scene.add_light(_ffi.AMB_LIGHT_POINT, "point", color=rgb(intensity), position=place)


def add_spot(
    scene: handles.Scene,
    position: ArrayLike,
    direction: ArrayLike,
    intensity: ArrayLike,
    half_angle: float,
) -> None:
    """A hard-edged cone of constant intensity, W/sr."""
    scene.add_light(
        _ffi.AMB_LIGHT_SPOT,
        "spot",
        color=rgb(intensity),
        position=rgb(position),
        direction=rgb(direction),
        spot_size=2 * half_angle,
        spot_blend=0.0,
        spot_cosine=0.0,
    )


def look(eye: ArrayLike, forward: ArrayLike, up: ArrayLike) -> NDArray[np.float64]:
    """Camera-to-world matrix, (4, 4): x right, y up, looks along -z."""
    back = -np.asarray(forward, dtype=np.float64)
    back /= np.linalg.norm(back)
    right = np.cross(np.asarray(up, dtype=np.float64), back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = np.column_stack([right, np.cross(back, right), back])
    matrix[:3, 3] = eye
    return matrix


def set_orthographic(
    scene: handles.Scene,
    eye: ArrayLike,
    forward: ArrayLike,
    up: ArrayLike,
    width: float,
    height: float | None = None,
) -> None:
    """``width`` and ``height`` of the window in metres, centred on the axis."""
    x, y = width / 2, (width if height is None else height) / 2
    scene.set_camera(
        _ffi.AMB_CAMERA_ORTHOGRAPHIC,
        look(eye, forward, up).tolist(),
        window=(-x, x, -y, y),
        clip_start=1e-3,
        clip_end=1e3,
    )


def set_perspective(
    scene: handles.Scene, eye: ArrayLike, forward: ArrayLike, up: ArrayLike, fov: float
) -> None:
    """Pinhole; ``fov`` is the full angle across the square image, radians."""
    half = np.tan(fov / 2)
    scene.set_camera(
        _ffi.AMB_CAMERA_PERSPECTIVE,
        look(eye, forward, up).tolist(),
        window=(-half, half, -half, half),
        clip_start=1e-3,
        clip_end=1e3,
    )


def render(
    build: BuildScene, size: int | tuple[int, int], name: str = "Single Scattering", **params: Any
) -> Image:
    """Builds a scene, renders it with members of AmbRenderParams and reads one pass.

    Defaults of the tests, unless given: single scattering only, first passes only, no adjoint
    normals (the closed forms and the reference cases are of the light-tracing kind).
    """
    width, height = (size, size) if isinstance(size, int) else size
    settings = {
        "effects": SINGLE,
        "light_bounces": 0,
        "camera_bounces": 0,
        "adjoint_normals": 0,
        "film_transparent": 1,
        "samples": 1,
        "width": width,
        "height": height,
    } | params
    with handles.Scene(library.load()) as scene:
        build(scene)
        scene.commit()
        with scene.start(**settings) as job:
            job.wait()
            pixels = job.read_pass(name)[::-1].copy()
            cover = job.read_pass("Combined")[::-1, :, 3].copy()
            image = Image(pixels, cover, job.report())
    # A number that is not finite must have been counted where it was born, and then it is a bug.
    assert image.report["nonfinite"] == 0
    assert np.all(np.isfinite(image.pixels))
    return image


def radiance(build: BuildScene, size: int = 1, **params: Any) -> NDArray[np.float64]:
    """Mean of the single-scattering pass over the image, RGB."""
    return render(build, size, **params).pixels.astype(np.float64).mean(axis=(0, 1))
