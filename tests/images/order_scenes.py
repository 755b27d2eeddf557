# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes whose orders of scattering are known, and how the independent path tracer is asked.

One description goes both to the tracer (tests/oracle/order_tracer.c) and to the library. Lamps
are rectangles of uniform radiance: their meaning is the same in both, whatever their size, and
paths that are led by nothing find them.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from api import ROOT, Medium, _ffi, add_body, handles, library, look, render, rgb
from meshes import Mesh, box, bumpy_sphere, icosphere
from numpy.typing import NDArray

TRACER = Path(os.environ.get("AMBERLIGHT_TRACER", ROOT / "build/dev/tests/order_tracer"))
REFERENCES = Path(__file__).resolve().parent / "references"
ORDERS = ["0", "1", "2", "3", "4+", "1+"]

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Camera:
    """``window``: full width and height, at distance 1 where it is a pinhole, else in metres."""

    eye: Triple
    forward: Triple
    up: Triple
    window: tuple[float, float]
    is_pinhole: bool = True

    def add_to(self, scene: handles.Scene) -> None:
        width, height = self.window
        scene.set_camera(
            _ffi.AMB_CAMERA_PERSPECTIVE if self.is_pinhole else _ffi.AMB_CAMERA_ORTHOGRAPHIC,
            look(self.eye, self.forward, self.up).tolist(),
            window=(-width / 2, width / 2, -height / 2, height / 2),
            clip_start=1e-3,
            clip_end=1e3,
        )

    def text(self) -> str:
        kind = "perspective" if self.is_pinhole else "orthographic"
        return f"{kind} {_row(self.eye, self.forward, self.up, self.window)}"


@dataclass(frozen=True)
class Rectangle:
    """A one-sided rectangle that faces the origin."""

    position: Triple
    size: tuple[float, float]
    radiance: float

    @property
    def axis(self) -> NDArray[np.float64]:
        return -np.array(self.position) / np.linalg.norm(self.position)

    @property
    def tangent(self) -> NDArray[np.float64]:
        across = np.cross(self.axis, (0.0, 0.0, 1.0))
        return across / np.linalg.norm(across)

    def add_to(self, scene: handles.Scene) -> None:
        scene.add_light(
            _ffi.AMB_LIGHT_AREA,
            "lamp",
            color=rgb(self.radiance),
            position=rgb(self.position),
            direction=self.axis.tolist(),
            tangent=self.tangent.tolist(),
            size=self.size,
        )

    def text(self) -> str:
        place = _row(self.position, self.axis, self.tangent, self.size)
        return f"rectangle {place} {self.radiance!r}"


@dataclass(frozen=True)
class Sun:
    """``radius``: angular, radians; ``irradiance`` on a plane across the axis."""

    direction: Triple
    radius: float
    irradiance: float

    def add_to(self, scene: handles.Scene) -> None:
        scene.add_light(
            _ffi.AMB_LIGHT_SUN,
            "sun",
            color=rgb(self.irradiance),
            direction=rgb(self.direction),
            angle=2 * self.radius,
        )

    def text(self) -> str:
        radiance = self.irradiance / (np.pi * np.sin(self.radius) ** 2)
        return f"sun {_row(self.direction, (self.radius, radiance))}"


@dataclass(frozen=True)
class Ball:
    """A sphere of uniform radiance; to the library a lamp of the same intensity and radius."""

    position: Triple
    radius: float
    intensity: float

    def add_to(self, scene: handles.Scene) -> None:
        scene.add_light(
            _ffi.AMB_LIGHT_POINT,
            "lamp",
            color=rgb(self.intensity),
            position=rgb(self.position),
            radius=self.radius,
        )

    def text(self) -> str:
        radiance = self.intensity / (np.pi * self.radius**2)
        return f"sphere {_row(self.position, (self.radius, radiance))}"


@dataclass(frozen=True)
class OrderScene:
    """One body in vacuum, seen in ``regions`` = (columns, rows) of the window."""

    mesh: Mesh
    ior: float
    sigma_s: float
    sigma_a: float
    g: float
    camera: Camera
    lamps: list[Rectangle | Sun | Ball] = field(default_factory=list)
    world: float = 0.0
    regions: tuple[int, int] = (2, 2)
    starts_inside: bool = False
    reenters: bool = False

    def build(self, scene: handles.Scene) -> None:
        add_body(scene, self.mesh, Medium(self.ior, self.sigma_s, self.sigma_a, self.g))
        for lamp in self.lamps:
            lamp.add_to(scene)
        if self.world > 0:
            scene.set_world(rgb(self.world))
        self.camera.add_to(scene)

    def text(self) -> str:
        """The scene as the tracer reads it."""
        lines = [f"ior {self.ior!r}", f"sigma_s {self.sigma_s!r}", f"sigma_a {self.sigma_a!r}"]
        lines += [f"g {self.g!r}", f"world {self.world!r}"]
        lines += [f"regions {self.regions[0]} {self.regions[1]}"]
        lines += [f"starts_inside {self.starts_inside:d}", f"reenters {self.reenters:d}"]
        lines += [self.camera.text(), *(lamp.text() for lamp in self.lamps)]
        counts = f"{len(self.mesh.positions)} {len(self.mesh.triangles)}"
        if self.mesh.normals is None:
            lines.append(f"flat_mesh {counts}")
            lines += [_row(p) for p in self.mesh.positions]
        else:
            lines.append(f"smooth_mesh {counts}")
            pairs = zip(self.mesh.positions, self.mesh.normals, strict=True)
            lines += [_row(p, n) for p, n in pairs]
        lines += [" ".join(str(i) for i in t) for t in self.mesh.triangles.tolist()]
        return "\n".join(lines) + "\n"


def _row(*groups: Any) -> str:
    return " ".join(repr(float(v)) for group in groups for v in group)


@dataclass(frozen=True)
class Orders:
    """``mean`` and its standard ``error``: (rows, columns, 6), the last axis as in ORDERS."""

    mean: NDArray[np.float64]
    error: NDArray[np.float64]
    data: dict[str, Any]


def from_json(data: dict[str, Any], regions: tuple[int, int]) -> Orders:
    shape = (regions[1], regions[0], len(ORDERS))
    mean, error = (
        np.array([r[k] for r in data["regions"]]).reshape(shape) for k in ("mean", "error")
    )
    return Orders(mean, error, data)


def trace(
    scene: OrderScene, paths: float, seed: int = 1, threads: int = 1, last_order: int = 0
) -> Orders:
    """Asks the tracer for ``paths`` paths in each region, to their end or to an order."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.txt"
        head = f"paths {int(paths)}\nseed {seed}\nthreads {threads}\nlast_order {last_order}\n"
        file.write_text(head + scene.text())
        output = subprocess.run([TRACER, file], check=True, capture_output=True, text=True).stdout
    return from_json(json.loads(output), scene.regions)


# ---- The scenes of the stored references ---------------------------------------------------------

RADII = [0.3, 2.0, 10.0]
LAMP = Rectangle((-1.6, 1.4, 2.8), (2.4, 2.4), 10.0)
FRONT = Camera((0, 0, 5), (0, 0, -1), (0, 1, 0), (0.28, 0.28))
# Down on the slab, so that its sides are seen from the inside only.
ABOVE = Camera((0, 4, 4), (0, -1, -1), (0, 1, 0), (0.28, 0.2))
ALBEDO = 0.9


def reference_scene(shape: str, radius: float) -> OrderScene:
    """``radius`` is the optical one: of the sphere, of half the slab's thickness."""
    half, mesh, g, camera = {
        "sphere": (1.0, lambda: icosphere(4), 0.0, FRONT),
        "slab": (0.4, lambda: box((-1.5, -0.4, -1.5), (1.5, 0.4, 1.5)), 0.3, ABOVE),
        "bumpy": (1.0, lambda: bumpy_sphere(4), 0.6, FRONT),
    }[shape]
    sigma_t = radius / half
    sigma_s = ALBEDO * sigma_t
    return OrderScene(mesh(), 1.5, sigma_s, sigma_t - sigma_s, g, camera, [LAMP])


def stored_orders(shape: str, radius: float) -> Orders:
    """The tracer's answer for a reference scene, from orders.json."""
    data = json.loads((REFERENCES / "orders.json").read_text())[f"{shape} {radius:g}"]
    return from_json(data, (2, 2))


# ---- The library's orders ------------------------------------------------------------------------

WALK = _ffi.AMB_SCATTER_WALK
SINGLE, DOUBLE, MULTIPLE = (
    _ffi.AMB_EFFECT_SINGLE_SCATTERING,
    _ffi.AMB_EFFECT_DOUBLE_SCATTERING,
    _ffi.AMB_EFFECT_MULTIPLE_SCATTERING,
)
PASSES = ["Single Scattering", "Double Scattering", "Multiple Scattering"]


def passes(scene: OrderScene, size: int, **params: Any) -> NDArray[np.float64]:
    """Means of the regions in the three passes of scattering, (rows, columns, 3).

    Defaults: walks, all reflections on both sides, the adjoint factor of shading normals (the
    tracer's paths start at the camera).
    """
    settings = {
        "effects": SINGLE | DOUBLE | MULTIPLE,
        "estimator": _ffi.AMB_ESTIMATOR_POINTS_COVARIANCE,
        "scatter_estimator": WALK,
        "light_bounces": 12,
        "camera_bounces": 64,
        "adjoint_normals": 1,
        "light_samples": 2**15,
        "samples": 1,
        "film_transparent": 1,
        "width": size,
        "height": size,
    } | params
    columns, rows = scene.regions
    with handles.Scene(library.load()) as handle:
        scene.build(handle)
        handle.commit()
        with handle.start(**settings) as job:
            job.wait()
            pixels = np.stack([job.read_pass(name)[::-1, :, 1] for name in PASSES], axis=-1)
            assert job.report()["nonfinite"] == 0
    parts = pixels.astype(np.float64).reshape(rows, size // rows, columns, size // columns, 3)
    return parts.mean(axis=(1, 3))


def library_orders(scene: OrderScene, size: int, runs: int, **params: Any) -> Orders:
    """Orders as the tracer has them, from ``runs`` pairs of renders with their own seeds: one with
    all orders, one up to three. Relative errors of an order are shared by all regions."""
    every = np.stack([passes(scene, size, seed=k, **params) for k in range(runs)])
    three = np.stack(
        [passes(scene, size, seed=runs + k, scatter_order_max=3, **params) for k in range(runs)]
    )
    both = np.concatenate([every, three])
    rows = {
        "1": both[..., 0],
        "2": both[..., 1],
        "3": three[..., 2],
        "4+": every[..., 2] - three[..., 2],
        "1+": every.sum(axis=-1),
    }
    mean, error = (np.zeros((*every.shape[1:3], len(ORDERS))) for _ in range(2))
    for name, values in rows.items():
        k = ORDERS.index(name)
        mean[..., k] = values.mean(axis=0)
        relative = np.sqrt(np.mean(values.var(axis=0, ddof=1) / len(values) / mean[..., k] ** 2))
        error[..., k] = relative * mean[..., k]
    return Orders(mean, error, {})


def whole(orders: Orders) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and error of all regions together, (6,)."""
    count = orders.mean.shape[0] * orders.mean.shape[1]
    square = np.sum(orders.error**2, axis=(0, 1))
    return orders.mean.mean(axis=(0, 1)), np.sqrt(square) / count


# ---- Flux ----------------------------------------------------------------------------------------

SCATTERED = SINGLE | DOUBLE | MULTIPLE
WORLD = _ffi.AMB_EFFECT_WORLD_LIGHT
SEEN = _ffi.AMB_EFFECT_BACKGROUND | _ffi.AMB_EFFECT_SURFACE_REFLECTION
ACROSS = 2.02


def _seen_along(direction: NDArray[np.float64]) -> Camera:
    """Sees the unit sphere whole."""
    x, y, z = direction.tolist()
    up = (0.0, 0.0, 1.0) if abs(z) < 0.9 else (1.0, 0.0, 0.0)
    return Camera((-4 * x, -4 * y, -4 * z), (x, y, z), up, (ACROSS, ACROSS), False)


def _ball(ior: float, albedo: float, g: float, camera: Camera, **light: Any) -> OrderScene:
    return OrderScene(icosphere(4), ior, albedo, 1 - albedo, g, camera, **light)


def scattered_flux(
    ior: float, albedo: float, g: float, seed: int, views: int, samples: int
) -> tuple[float, float]:
    """Watts that leave a sphere of optical radius 1 under a sun of 1 W/m^2 after they scattered,
    and those that interact with its medium. What is seen depends on the angle to the sun alone:
    Gauss-Legendre over its cosine."""
    nodes, weights = np.polynomial.legendre.leggauss(views)
    sun, out, interacting = Sun((0.0, 0.0, -1.0), 0.0, 1.0), 0.0, 0.0
    for k, (c, weight) in enumerate(zip(nodes, weights, strict=True)):
        turn = 2.4 * k + seed
        d = np.array([*(np.sqrt(1 - c * c) * np.array([np.cos(turn), np.sin(turn)])), c])
        scene = _ball(ior, albedo, g, _seen_along(d), lamps=[sun])
        settings: dict[str, Any] = {
            "effects": SCATTERED,
            "estimator": _ffi.AMB_ESTIMATOR_POINTS_COVARIANCE,
            "scatter_estimator": WALK,
            "light_samples": 2**15,
            "kernel_size": 1.0,
            "light_bounces": 12,
            "camera_bounces": 64,
        }
        image = render(
            scene.build, 24, name="Combined", seed=seed * views + k, samples=samples, **settings
        )
        seen = float(image.pixels[..., 1].astype(np.float64).mean())
        out += seen * ACROSS**2 * 2 * np.pi * float(weight)
        interacting += float(image.report["light"]["flux_interacting"][1]) / views
    return out, interacting


def absorbed_flux(ior: float, albedo: float, g: float, seed: int, samples: int) -> float:
    """Watts of the same sun that the same sphere absorbs, by reciprocity: what the sun would miss
    if it looked at the sphere in a world of radiance 1."""
    scene = _ball(ior, albedo, g, _seen_along(np.array([0.0, 0.0, -1.0])), world=1.0)
    settings: dict[str, Any] = {
        "effects": SCATTERED | WORLD | SEEN,
        "camera_bounces": 64,
        "film_transparent": 0,
        "scatter_estimator": WALK,
    }
    image = render(scene.build, 24, name="Combined", seed=seed, samples=samples, **settings)
    return float((1 - image.pixels[..., 1].astype(np.float64)).mean()) * ACROSS**2


@dataclass(frozen=True)
class Balance:
    """Parts of the watts that interact, and the standard error of their sum."""

    out: float
    absorbed: float
    error: float


def balance(
    ior: float, albedo: float, g: float, runs: int, views: int = 8, samples: int = 2
) -> Balance:
    fluxes = np.array([scattered_flux(ior, albedo, g, k, views, samples) for k in range(runs)])
    taken = np.array([absorbed_flux(ior, albedo, g, k, 32 * samples) for k in range(runs)])
    spread = np.hypot(fluxes[:, 0].std(ddof=1), taken.std(ddof=1)) / np.sqrt(runs)
    out, interacting = fluxes.mean(axis=0)
    return Balance(out / interacting, taken.mean() / interacting, spread / interacting)
