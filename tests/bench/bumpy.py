# SPDX-License-Identifier: GPL-3.0-or-later
"""What the benchmarks of the bumpy sphere share: its scene, views of it, their camera rays, the
references along these rays, and the cost of stages.

The reference is ref_bumpy.py at sixteen tubes a triangle (its own error is about 0.1 %), minutes
of work kept under build/bench.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "images"))

from api import (  # noqa: E402
    ROOT,
    BuildScene,
    Image,
    Medium,
    _ffi,
    add_body,
    add_point,
    handles,
    look,
    render,
    set_perspective,
)
from meshes import bumpy_sphere  # noqa: E402
from ref_bumpy import LightTubes, Surface, bumpy_scene, trace  # noqa: E402

SIZE, SAMPLES, SEED, REFINEMENT = 256, 4, 0, 2
REFINEMENT_OF_LIBRARY = 4
EYE, FOV = 5.0, np.radians(30.0)
CAMERA_STAGE = 2  # RNG_STAGE_CAMERA
ASIDE = np.radians(5.0)  # of the aligned views: on the line itself each view ray is a light ray


@dataclass(frozen=True)
class View:
    """Where the camera is; it looks at the origin, with y up."""

    name: str
    eye: tuple[float, float, float]

    @property
    def forward(self) -> NDArray[np.float64]:
        return -np.asarray(self.eye) / np.linalg.norm(self.eye)


def _aligned(name: str, side: float) -> View:
    """On the light's side of the object (+1) or beyond it (-1), ASIDE from the line to it."""
    to_light = bumpy_scene(bumpy_sphere(0)).light
    axis = side * to_light / np.linalg.norm(to_light)
    across = np.cross(axis, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    eye = EYE * (np.cos(ASIDE) * axis + np.sin(ASIDE) * across)
    return View(name, (eye[0], eye[1], eye[2]))


SIDE_LIT = View("side-lit", (0.0, 0.0, EYE))
FRONT_LIT = _aligned("front-lit", 1.0)
BACK_LIT = _aligned("back-lit", -1.0)
UP = (0.0, 1.0, 0.0)


# ---- Camera rays --------------------------------------------------------------------------------


def _mix(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """rng_mix of base/rng.h."""
    x = x ^ (x >> np.uint64(30))
    x = x * np.uint64(0xBF58476D1CE4E5B9)
    x = x ^ (x >> np.uint64(27))
    x = x * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


def _unit(bits: NDArray[np.uint64]) -> NDArray[np.float32]:
    return (bits >> np.uint64(40)).astype(np.float32) * np.float32(2.0**-24)


def camera_rays(view: View) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The library's own rays, (SIZE^2 SAMPLES, 3), and their pixels counted from the top left.

    A copy of camera_sample's jitter; warn_if_stale() tells when it is one no longer.
    """
    golden = np.uint64(0x9E3779B97F4A7C15)
    pixel = np.arange(SIZE * SIZE, dtype=np.uint64)
    with np.errstate(over="ignore"):
        stream = _mix(np.array([SEED << 32 | CAMERA_STAGE], dtype=np.uint64) + golden)
        key = _mix(stream ^ _mix(pixel + golden))
        shift = [_unit(_mix(key + np.uint64(k + 1) * golden)) for k in range(2)]
        index = np.arange(SAMPLES, dtype=np.uint64)
        steps = (0xC13FA9A902A6328F, 0x91E10DA5C79E7B1D)
        point = [_unit(index * np.uint64(step)) for step in steps]
    u, v = (p[None, :] + s[:, None] for p, s in zip(point, shift, strict=True))
    x = ((pixel % SIZE)[:, None] + u % 1) / SIZE * 2 - 1
    y = ((pixel // SIZE)[:, None] + v % 1) / SIZE * 2 - 1
    half = np.tan(FOV / 2)
    d = np.stack([x * half, y * half, -np.ones_like(x)], axis=-1).reshape(-1, 3)
    d = d @ look(view.eye, view.forward, UP)[:3, :3].T
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    row, column = np.divmod(pixel.astype(np.int64), SIZE)
    return d, np.repeat((SIZE - 1 - row) * SIZE + column, SAMPLES)


# ---- Renders ------------------------------------------------------------------------------------


def warn_if_stale(traced: Image, cover: NDArray[np.float64]) -> None:
    if (
        np.abs(traced.cover - cover).max() > 0.5 / SAMPLES + 1e-6
        or np.mean(np.abs(traced.cover - cover) > 1e-6) > 1e-3
    ):
        print("warning: camera_rays() no longer copies the library's rays; errors below include")
        print("         the sampling of pixels")


def bumpy(level: int = 5, view: View = SIDE_LIT) -> BuildScene:
    """The case with 20 * 4^level triangles."""
    scene = bumpy_scene(bumpy_sphere(level))
    medium = Medium(scene.n, scene.sigma_s, scene.sigma_t - scene.sigma_s, scene.g)

    def build(handle: handles.Scene) -> None:
        add_body(handle, scene.mesh, medium)
        add_point(handle, scene.light, scene.intensity)
        set_perspective(handle, view.eye, view.forward, UP, FOV)

    return build


def stage_cpu(image: Image, names: Iterable[str] | None = None) -> float:
    """CPU seconds of the named stages, or of all."""
    stages = image.report["stages"]
    return sum(s["cpu_s"] for s in stages if names is None or s["name"] in names)


def measure(
    build: BuildScene,
    estimator: str,
    light_samples: int,
    kernel: float,
    threads: int,
    refinement: int = 0,
) -> Image:
    return render(
        build,
        SIZE,
        estimator=getattr(_ffi, f"AMB_ESTIMATOR_{estimator}"),
        light_samples=light_samples,
        kernel_size=kernel,
        tube_refinement=refinement,
        samples=SAMPLES,
        seed=SEED,
        threads=threads,
    )


def rays_alone(build: BuildScene, threads: int) -> Image:
    """The same camera rays to the boundary, refracted and on to the far side, without a gather."""
    return render(build, SIZE, effects=0, samples=SAMPLES, seed=SEED, threads=threads)


# ---- References ---------------------------------------------------------------------------------


def reference(view: View, threads: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Image (SIZE, SIZE, 3) and coverage along the library's camera rays.

    Side-lit by ref_bumpy.py, which shares nothing with the library. Along the light that takes far
    longer, and the library's own finest tubes stand in: they and the points that they judge have
    no estimator in common, and the tables compare the means.
    """
    if view != SIDE_LIT:
        image = measure(bumpy(5, view), "TUBES", 1, 1.0, threads, REFINEMENT_OF_LIBRARY)
        return image.pixels.astype(np.float64), image.cover.astype(np.float64)
    cache = ROOT / f"build/bench/bumpy_{SIZE}_{SAMPLES}_{SEED}_{REFINEMENT}.npy"
    if not cache.is_file():
        print("rendering the reference, some minutes ...", file=sys.stderr)
        scene = bumpy_scene(bumpy_sphere(5))
        direction, pixel = camera_rays(view)
        origin = np.tile(np.asarray(view.eye), (len(direction), 1))
        value, seen = trace(LightTubes(scene, Surface(scene.mesh), REFINEMENT), origin, direction)
        columns = np.column_stack([value, seen])
        sums = [np.bincount(pixel, column, minlength=SIZE * SIZE) for column in columns.T]
        cache.parent.mkdir(parents=True, exist_ok=True)
        np.save(cache, np.stack(sums, axis=1).reshape(SIZE, SIZE, 4) / SAMPLES)
    stored = np.load(cache)
    return stored[..., :3], stored[..., 3]
