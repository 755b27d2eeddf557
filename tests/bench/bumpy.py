# SPDX-License-Identifier: GPL-3.0-or-later
"""What the benchmarks of the bumpy sphere share: its scene, views of it, references along the same
camera rays, and the cost of stages.

The reference is SPECULAR, whose own error is some 1e-4: a minute of work, kept under build/bench.
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
    render,
    set_perspective,
)
from meshes import Mesh, bumpy_sphere  # noqa: E402
from ref_bumpy import bumpy_scene  # noqa: E402

SIZE, SAMPLES, SEED = 256, 4, 0
EYE, FOV = 5.0, np.radians(30.0)
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


# ---- Renders ------------------------------------------------------------------------------------


def bumpy(level: int = 5, view: View = SIDE_LIT) -> BuildScene:
    """The case with 20 * 4^level triangles."""
    return lit_alike(bumpy_sphere(level), view)


def lit_alike(mesh: Mesh, view: View = SIDE_LIT) -> BuildScene:
    """Another mesh in place of the sphere."""
    scene = bumpy_scene(mesh)
    medium = Medium(scene.n, scene.sigma_s, scene.sigma_t - scene.sigma_s, scene.g)

    def build(handle: handles.Scene) -> None:
        add_body(handle, mesh, medium)
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


def reference(
    view: View = SIDE_LIT, threads: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Image (SIZE, SIZE, 3) and coverage, along the camera rays of every other render here."""
    cache = ROOT / f"build/bench/specular_{view.name}_{SIZE}_{SAMPLES}_{SEED}.npy"
    if not cache.is_file():
        print("rendering the reference ...", file=sys.stderr)
        image = measure(bumpy(5, view), "SPECULAR", 1, 1.0, threads)
        cache.parent.mkdir(parents=True, exist_ok=True)
        np.save(cache, np.concatenate([image.pixels, image.cover[..., None]], axis=2))
    stored = np.load(cache).astype(np.float64)
    return stored[..., :3], stored[..., 3]
