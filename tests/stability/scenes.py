# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes of the hard cases as values: bodies, lamps and a camera that can be moved together."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from api import _ffi, handles, look, render, rgb
from hard import METHODS
from meshes import Mesh
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

SUN = _ffi.AMB_LIGHT_SUN
POINT = _ffi.AMB_LIGHT_POINT
SPOT = _ffi.AMB_LIGHT_SPOT
AREA = _ffi.AMB_LIGHT_AREA


@dataclass(frozen=True)
class Body:
    """A dielectric object; coefficients RGB or one number, 1/m. ``black`` triangles absorb. Or an
    opaque one of ``albedo``, which shines with ``emission``, W m^-2 sr^-1."""

    mesh: Mesh
    ior: float = 1.0
    sigma_s: ArrayLike = 0.4
    sigma_a: ArrayLike = 0.1
    g: float = 0.0
    black: NDArray[np.bool_] | None = None
    is_opaque: bool = False
    albedo: ArrayLike = 0.0
    emission: ArrayLike = 0.0
    normals_at_corners: Array | None = None


@dataclass(frozen=True)
class Lamp:
    """``more``: other members of AmbLight, none of which is a length."""

    kind: int
    color: ArrayLike = 1.0
    position: ArrayLike = (0, 0, 0)
    direction: ArrayLike = (0, 0, -1)
    radius: float = 0.0
    size: tuple[float, float] = (1.0, 1.0)
    more: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Camera:
    """``window``: full width in metres of an orthographic one, tan of the half angle times 2 of
    one in perspective; ``shift`` moves it in units of itself."""

    at: ArrayLike = (0, 0, 5)
    forward: ArrayLike = (0, 0, -1)
    up: ArrayLike = (0, 1, 0)
    window: float = 2e-3
    shift: tuple[float, float] = (0, 0)
    is_perspective: bool = False
    clip: tuple[float, float] = (1e-3, 1e3)


@dataclass(frozen=True)
class Setup:
    """What is rendered. ``scale``, ``turn`` (a rotation) and ``move`` are applied to all of it in
    float64 before the library sees it: by the objects' matrices, or in their vertices."""

    bodies: tuple[Body, ...]
    lamps: tuple[Lamp, ...]
    camera: Camera = Camera()
    scale: float = 1.0
    turn: Array = field(default_factory=lambda: np.eye(3))
    move: ArrayLike = (0, 0, 0)
    moves_vertices: bool = False
    size: int = 1

    def placed(self, **changes: Any) -> Setup:
        return replace(self, **changes)

    def _point(self, p: ArrayLike) -> Array:
        return self.turn @ (self.scale * np.asarray(p, np.float64)) + np.asarray(self.move)

    def _direction(self, d: ArrayLike) -> Array:
        return self.turn @ np.asarray(d, np.float64)

    def build(self, scene: handles.Scene) -> None:
        for index, body in enumerate(self.bodies):
            self._add_body(scene, body, f"body {index}")
        for index, lamp in enumerate(self.lamps):
            self._add_lamp(scene, lamp, f"lamp {index}")
        camera = self.camera
        length = 1.0 if camera.is_perspective else self.scale
        half = length * camera.window / 2
        x, y = (length * camera.window * s for s in camera.shift)
        matrix = look(
            self._point(camera.at), self._direction(camera.forward), self._direction(camera.up)
        )
        scene.set_camera(
            _ffi.AMB_CAMERA_PERSPECTIVE if camera.is_perspective else _ffi.AMB_CAMERA_ORTHOGRAPHIC,
            matrix.tolist(),
            window=(x - half, x + half, y - half, y + half),
            clip_start=self.scale * camera.clip[0],
            clip_end=self.scale * camera.clip[1],
        )

    def _add_body(self, scene: handles.Scene, body: Body, name: str) -> None:
        if body.is_opaque:
            kind = {
                "surface": _ffi.AMB_SURFACE_DIFFUSE,
                "albedo": rgb(body.albedo),
                "emission": rgb(body.emission),
            }
        else:
            kind = {
                "surface": _ffi.AMB_SURFACE_DIELECTRIC,
                "ior": body.ior,
                "sigma_a": [v / self.scale for v in rgb(body.sigma_a)],
                "lobes": [([v / self.scale for v in rgb(body.sigma_s)], body.g)],
            }
        material = scene.add_material(name, **kind)
        black = scene.add_material("black", surface=_ffi.AMB_SURFACE_DIFFUSE, albedo=rgb(0))
        mesh = body.mesh
        matrix = np.eye(4)
        positions, normals = mesh.positions, mesh.normals
        if body.normals_at_corners is not None:
            normals = body.normals_at_corners
        if self.moves_vertices:
            positions = positions @ (self.scale * self.turn).T + np.asarray(self.move)
            normals = None if normals is None else normals @ self.turn.T
        else:
            matrix[:3, :3] = self.scale * self.turn
            matrix[:3, 3] = self.move
        domain = _ffi.AMB_NORMALS_NONE
        if normals is not None:
            domain = _ffi.AMB_NORMALS_CORNER if normals.ndim == 3 else _ffi.AMB_NORMALS_VERTEX
        slots = None if body.black is None else body.black.astype(np.uint32)
        shape = scene.add_mesh(name, positions, mesh.triangles, normals, domain, slots)
        scene.add_object(name, shape, matrix.tolist(), [material, black])

    def _add_lamp(self, scene: handles.Scene, lamp: Lamp, name: str) -> None:
        # Intensity falls with the square of the distance, which grows with the scale.
        power = self.scale**2 if lamp.kind in (POINT, SPOT) else 1.0
        fields: dict[str, Any] = {"color": [power * v for v in rgb(lamp.color)]}
        if lamp.kind != SUN:
            fields["position"] = self._point(lamp.position).tolist()
        if lamp.kind != POINT:
            fields["direction"] = self._direction(lamp.direction).tolist()
        if lamp.kind in (POINT, SPOT):
            fields["radius"] = self.scale * lamp.radius
        if lamp.kind == AREA:
            fields["size"] = [self.scale * v for v in lamp.size]
            across = np.cross(lamp.direction, (0.3, 0.5, 0.1))
            fields["tangent"] = self._direction(across / np.linalg.norm(across)).tolist()
        scene.add_light(lamp.kind, name, **(fields | lamp.more))


def picture(setup: Setup, method: str, name: str = "Single Scattering", **params: Any) -> Array:
    """(size, size, channels) of one pass; every number finite and the film's guard at zero, which
    ``api.render`` asserts."""
    settings = {"threads": 1, "light_samples": 2**14, "kernel_size": 16.0, "samples": 1}
    settings |= METHODS.get(method, {}) | params
    pixels = render(setup.build, setup.size, name, **settings).pixels.astype(np.float64)
    assert np.all(pixels >= 0)
    return pixels


def mean(setup: Setup, method: str, **params: Any) -> Array:
    """Mean over the image, RGB."""
    return picture(setup, method, **params).mean(axis=(0, 1))


def relative(value: ArrayLike, expected: ArrayLike) -> float:
    """Largest relative error; where 0 is expected, infinite unless it is exactly that."""
    v, e = np.broadcast_arrays(np.asarray(value, np.float64), np.asarray(expected, np.float64))
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.where(v == e, 0.0, np.abs(v - e) / np.abs(e))
    return float(np.max(error))


def difference(a: Array, b: Array) -> float:
    """Root of the mean squared difference of two pictures, in units of the mean of the second."""
    return float(np.sqrt(np.mean((a - b) ** 2)) / np.mean(b))
