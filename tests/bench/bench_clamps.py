#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""What bounds in the code do to pictures: each is moved, the library is built again beside this
checkout, and the same render with the same random numbers is compared.

    python3 tests/bench/bench_clamps.py [NAME ...]

Prints for each bound what it is, what it was moved to, how far the mean of the picture moved, how
far it would if pixels changed at random as much as they did, and the root of the mean squared
change of pixels over the mean. Bounds on time, on memory and against rounding at the ends of a
range (cosines, probabilities) are not in the table.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Clamp:
    """`old` is replaced by `new` in `file`; `scenes` are those of `measure`."""

    name: str
    file: str
    old: str
    new: str
    scenes: tuple[str, ...]
    meaning: str


POINTS = ("points", "fixed")
# The same with eight times as many samples of the light, or 32 times as many of the camera.
MORE_POINTS = ("points x8",)
MORE_CAUSTICS = ("caustics fine",)
GLOW = ("glow", "glow near")
MORE_GLOW = ("glow near x64",)
CLAMPS = (
    Clamp("cosine behind a boundary, footprints", "optics/tangent.h",
          "fmaxf(cos_t, 1e-3f)", "fmaxf(cos_t, 1e-4f)", (*POINTS, "caustics"),
          "derivative of refraction beside the critical angle"),
    Clamp("cosine behind a boundary, covariance", "optics/covariance.h",
          "COVARIANCE_COS_TRANSMITTED_MIN 1e-3", "COVARIANCE_COS_TRANSMITTED_MIN 1e-4",
          ("points",), "the same for frequencies"),
    Clamp("extent of sources that have none", "optics/covariance.c",
          "EXTENT_RATIO_MIN = 1e-4", "EXTENT_RATIO_MIN = 3e-4", ("points",),
          "a point or a sun, relative to the extent that it has"),
    Clamp("grazing light, rays", "light/light_trace.c",
          "GRAZING_COS = 1e-4f", "GRAZING_COS = 1e-5f", (*POINTS, "caustics"),
          "light that meets a surface at less ends"),
    Clamp("grazing light, tubes", "field/tubes/tube_reflect.c",
          "GRAZING_COS = 1e-4f", "GRAZING_COS = 1e-5f", ("tubes",), "the same"),
    Clamp("least flux of a branch", "light/light_trace.c",
          "FLUX_MIN = 1e-6f", "FLUX_MIN = 1e-8f", ("points",), "share of the ray's flux"),
    Clamp("least flux of a branch, tubes", "field/tubes/tube_reflect.c",
          "FLUX_MIN = 1e-6f", "FLUX_MIN = 1e-8f", ("tubes",), "the same"),
    Clamp("optical depth of beams", "light/light_trace.c",
          "OPTICAL_DEPTH_MAX = 18.4f", "OPTICAL_DEPTH_MAX = 25.0f", ("dense",),
          "exp(-18.4) of the light is left there"),
    Clamp("slope of kernels' ends", "field/points/points.c",
          "SLOPE_MAX = 4.0f", "SLOPE_MAX = 16.0f", POINTS,
          "how far kernels reach past the boundary that cuts their rays"),
    Clamp("cross-section of kernels", "field/points/points.c",
          "AREA_MAX = 4.0f", "AREA_MAX = 16.0f", (*POINTS, *MORE_POINTS),
          "in units of the mean: wider ones blur, narrower ones show noise"),
    Clamp("reach of tubes", "field/tubes/tube_cut.c",
          "LIMIT_MAX = 4.0f", "LIMIT_MAX = 16.0f", ("tubes",), "in radii of the object"),
    Clamp("angle to a wall's tangent plane", "field/tubes/tube_reflect.c",
          "PLANE_COS_MIN = 0.1f", "PLANE_COS_MIN = 0.01f", ("tubes",),
          "where reflected tubes are cut by a jump"),
    Clamp("turned normals, exact connections", "field/specular/specular_face.c",
          "GRAZING_COS = 1e-3", "GRAZING_COS = 1e-4", ("specular",),
          "normals that interpolation turned away from the light"),
    Clamp("grazing search, exact connections", "field/specular/specular_face.c",
          "COS_T_MIN = 1e-6", "COS_T_MIN = 1e-7", ("specular",),
          "Snell's derivative in the search for solutions"),
    Clamp("eccentricity of caustic kernels", "field/caustics/caustics.c",
          "ECCENTRICITY_MAX = 128.0f", "ECCENTRICITY_MAX = 512.0f", ("caustics", *MORE_CAUSTICS),
          "length to width"),
    Clamp("least axis of caustic kernels", "field/caustics/caustics.c",
          "AXIS_MIN = 0.005f", "AXIS_MIN = 0.0025f", ("caustics",),
          "in units of the typical one"),
    Clamp("largest axis of caustic kernels", "field/caustics/caustics.c",
          "AXIS_MAX = 32.0f", "AXIS_MAX = 64.0f", ("caustics",), "in units of the typical one"),
    Clamp("height of caustic kernels", "field/caustics/caustic_tree.c",
          "HEIGHT_MAX = 0.5f", "HEIGHT_MAX = 1.0f", ("caustics",),
          "how far off its plane a photon counts"),
    Clamp("optical depth of photons", "field/scatter/scatter_cells.c",
          "DEPTH_MAX = 9.0f", "DEPTH_MAX = 12.0f", ("photons",),
          "exp(-9) of the light from there is left"),
    Clamp("sharpest kernel of a lobe", "field/scatter/lobe.c",
          "SHARPEST = 0.98", "SHARPEST = 0.99", ("sharp photons", "photons"),
          "Poisson's kernel beside its zeros"),
    Clamp("least of a lobe", "field/scatter/lobe.c",
          "FLOOR = 1e-3", "FLOOR = 1e-4", ("sharp photons",), "lobes of few degrees stay positive"),
    Clamp("growth of cells beside a lamp", "light/light_trace.c",
          "GROWTH_MAX = 16.0f", "GROWTH_MAX = 64.0f", ("near x64",),
          "how much a light's cell may grow along its beam"),
    Clamp("least flux on its way to surfaces", "light/light_trace.c",
          "FLUX_MIN_LANDING = 1e-4f", "FLUX_MIN_LANDING = 1e-5f", ("caustics",),
          "share of the ray's flux"),
    Clamp("faces whose photons mix", "field/caustics/caustic_tree.h",
          "CAUSTIC_NORMAL_COS_MIN 0.5f", "CAUSTIC_NORMAL_COS_MIN 0.25f", ("caustics",),
          "cosine between their normals"),
    Clamp("halvings of a piece", "field/specular/specular_gather.c",
          "HALVINGS_MAX = 1 << 10", "HALVINGS_MAX = 1 << 12", ("specular", "dense specular"),
          "where a curve takes more, rounding decides"),
    Clamp("halvings for turns", "field/specular/specular_gather.c",
          "TURN_HALVINGS_MAX = 512", "TURN_HALVINGS_MAX = 2048", ("specular", "dense specular"),
          "places where light and view turn over"),
    Clamp("cosine of the lens", "scene/camera.c",
          "COS_AXIS_MIN = 1e-12", "COS_AXIS_MIN = 1e-9", ("lens",),
          "clipping planes of rays along the lens"),
    Clamp("least width of glow", "field/caustics/glow.c",
          "WIDTH_MIN = 0.01f", "WIDTH_MIN = 0.005f", (*GLOW, *MORE_GLOW),
          "light that turned near by, in units of what the density says"),
    Clamp("least width of glow at edges", "field/caustics/glow.c",
          "EDGE_WIDTH_MIN = 0.2f", "EDGE_WIDTH_MIN = 0.1f", (*GLOW, *MORE_GLOW),
          "in the same units"),
    Clamp("points of glow", "field/caustics/glow.c",
          "POINT = 1e-6f", "POINT = 1e-7f", GLOW, "narrower kernels are none"),
    Clamp("faces where glow goes on", "field/caustics/glow.c",
          "PROBE_COS_MIN = 0.5f", "PROBE_COS_MIN = 0.25f", ("glow",), "cosine between normals"),
    Clamp("faces whose photons are neighbours", "field/caustics/neighbours.c",
          "NORMAL_COS_MIN = 0.5f", "NORMAL_COS_MIN = 0.25f", GLOW, "cosine between normals"),
    Clamp("grazing glow", "field/scatter/photon_walk.c",
          "GRAZING_COS = 1e-4f", "GRAZING_COS = 1e-5f", ("glow",),
          "photons that land at less are left out"),
    Clamp("walks far from their object", "camera/scatter_walk.c",
          "LOST_RADII = 1.01f", "LOST_RADII = 16.0f", ("walk",), "holes of meshes"),
    Clamp("directions laid into a face", "scene/boundary.c",
          "LAID_COSINE = 1e-3f", "LAID_COSINE = 1e-4f", ("rims",),
          "how far those that an interpolated normal turned behind it point off it"),
    Clamp("grazing normals, tubes", "field/tubes/tube_patch.h",
          "TUBE_GRAZING_COS 1e-3f", "TUBE_GRAZING_COS 1e-4f", ("tubes", "soft tubes"),
          "normals that interpolation turned away from the light"),
    Clamp("least softness of tubes", "field/tubes/tube_soft.h",
          "SOFT_MIN = 1e-3f", "SOFT_MIN = 1e-4f", ("tubes", "soft tubes"),
          "less of a tube's width is averaged over by a chord"),
)  # fmt: skip


# ---- The renders, in a process with one library --------------------------------------------------


def measure(scene: str) -> np.ndarray:
    sys.path.insert(0, str(Path(__file__).resolve().parent))
    sys.path.insert(0, str(ROOT / "tests/images"))
    import bench_caustics
    import bench_glow
    from api import (
        BuildScene,
        Medium,
        _ffi,
        add_body,
        add_point,
        handles,
        look,
        render,
        rgb,
        set_perspective,
    )  # fmt: skip
    from bumpy import EYE, FOV, UP, bumpy
    from meshes import box, bumpy_sphere, icosphere
    from ref_bumpy import bumpy_scene
    from test_caustics import add_floor, look_down

    settings = {"samples": 4, "seed": 1, "threads": 1}
    scene, _, more_samples = scene.partition(" x")
    times = int(more_samples or 1)
    if scene.startswith("caustics"):
        settings["samples"] = 128 if scene == "caustics fine" else 4
        return render(
            lambda handle: bench_caustics.build(handle, "bumpy"), 32, "Surface",
            effects=_ffi.AMB_EFFECT_CAUSTICS, light_samples=times * 2**17, **settings,
        ).pixels  # fmt: skip

    later = _ffi.AMB_EFFECT_DOUBLE_SCATTERING | _ffi.AMB_EFFECT_MULTIPLE_SCATTERING

    def rims(handle: handles.Scene) -> None:
        """A furnace: a coarse smooth ball that absorbs nothing, all that it shows is 1."""
        add_body(handle, icosphere(1), Medium(1.5, 1.0, 0.0))
        handle.set_world([1.0, 1.0, 1.0])
        set_perspective(handle, (0.0, 0.0, EYE), (0.0, 0.0, -1.0), UP, FOV)

    def on_floor(handle: handles.Scene) -> None:
        add_body(handle, box((-1, -0.7, 0.002), (1, 0.7, 1.2)), Medium(1.0, 0.45, 0.05))
        add_point(handle, (1.5, 0.5, 4.0), 100.0)
        add_floor(handle)
        look_down(handle, 6.0, 0.1)

    if scene == "rims":
        everything = later | _ffi.AMB_EFFECT_SINGLE_SCATTERING | _ffi.AMB_EFFECT_WORLD_LIGHT
        everything |= _ffi.AMB_EFFECT_SURFACE_REFLECTION | _ffi.AMB_EFFECT_BACKGROUND
        return render(
            rims, 32, "Combined", effects=everything, camera_bounces=64, film_transparent=0,
            scatter_estimator=1, **(settings | {"samples": 64}),
        ).pixels[..., :3]  # fmt: skip
    if scene.startswith("glow"):
        return render(
            on_floor if scene == "glow near" else lambda handle: bench_glow.build(handle, "middle"),
            32, effects=bench_glow.EFFECTS,
            light_bounces=4, light_samples=times * 2**15, scatter_estimator=1,
            **(settings | {"samples": 64}),
        ).pixels  # fmt: skip

    case = bumpy_scene(bumpy_sphere(4))

    def thick(g: float = 0.0, lamp_share: float = 1.0) -> BuildScene:
        """A dense body, its lamp at this share of its distance."""

        def build(handle: handles.Scene) -> None:
            add_body(handle, case.mesh, Medium(1.5, 20.0, 1.0, g))
            add_point(handle, lamp_share * np.asarray(case.light), case.intensity)
            set_perspective(handle, (0.0, 0.0, EYE), (0.0, 0.0, -1.0), UP, FOV)

        return build

    def lens(handle: handles.Scene) -> None:
        bumpy(4)(handle)
        half = np.tan(FOV / 2)
        handle.set_camera(
            _ffi.AMB_CAMERA_PERSPECTIVE, look((0.0, 0.0, EYE), (0.0, 0.0, -1.0), UP).tolist(),
            window=(-half, half, -half, half), clip_start=1e-3, clip_end=1e3, lens_radius=0.1,
            focus_distance=EYE,
        )  # fmt: skip

    def soft(handle: handles.Scene) -> None:
        """The lamp a twentieth of its distance wide."""
        light = np.asarray(case.light)
        handle.add_light(
            _ffi.AMB_LIGHT_POINT, "lamp", color=rgb(case.intensity), position=rgb(light),
            radius=float(np.linalg.norm(light)) / 40,
        )  # fmt: skip
        medium = Medium(case.n, case.sigma_s, case.sigma_t - case.sigma_s, case.g)
        add_body(handle, case.mesh, medium)
        set_perspective(handle, (0.0, 0.0, EYE), (0.0, 0.0, -1.0), UP, FOV)

    photons = {"scatter_estimator": 2, "effects": later}
    # A hundredth of the radius above the surface.
    distance = float(np.linalg.norm(case.light))
    near = 1.01 * (case.mesh.positions @ case.light).max() / distance**2
    scenes = {
        "points": (bumpy(4), _ffi.AMB_ESTIMATOR_POINTS_COVARIANCE, {"light_bounces": 1}),
        "fixed": (bumpy(4), _ffi.AMB_ESTIMATOR_POINTS_FIXED, {"light_bounces": 1}),
        "lens": (lens, _ffi.AMB_ESTIMATOR_POINTS_FIXED, {}),
        "near": (thick(lamp_share=near), _ffi.AMB_ESTIMATOR_POINTS_COVARIANCE, {}),
        "dense": (thick(), _ffi.AMB_ESTIMATOR_POINTS_FIXED, {}),
        "tubes": (bumpy(4), _ffi.AMB_ESTIMATOR_TUBES, {"light_bounces": 1}),
        "specular": (bumpy(3), _ffi.AMB_ESTIMATOR_SPECULAR, {}),
        "dense specular": (thick(), _ffi.AMB_ESTIMATOR_SPECULAR, {}),
        "photons": (thick(), _ffi.AMB_ESTIMATOR_TUBES, photons),
        "sharp photons": (thick(0.99), _ffi.AMB_ESTIMATOR_TUBES, photons),
        "soft tubes": (soft, _ffi.AMB_ESTIMATOR_TUBES, {"light_bounces": 1}),
        "walk": (thick(), _ffi.AMB_ESTIMATOR_TUBES, {"scatter_estimator": 1, "effects": later}),
    }
    build, estimator, more = scenes[scene]
    name = "Multiple Scattering" if "effects" in more else "Single Scattering"
    size = 16 if scene in ("specular", "dense specular", "walk") else 32
    return render(
        build, size, name, estimator=estimator, light_samples=times * 2**15, **(settings | more)
    ).pixels


# ---- Libraries -----------------------------------------------------------------------------------


def compile_library(folder: Path) -> Path:
    build = folder / "build"
    if not build.is_dir():
        options = ["-G", "Ninja", "-DCMAKE_BUILD_TYPE=Release", "-DAMB_BUILD_TESTS=OFF"]
        command = ["cmake", "-S", str(folder), "-B", str(build), *options]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    subprocess.run(["cmake", "--build", str(build)], check=True, stdout=subprocess.DEVNULL)
    return build / "lib/libamberlight.so"


def picture(library: Path, scene: str, folder: Path) -> np.ndarray:
    path = folder / "picture.npy"
    environment = {**os.environ, "AMBERLIGHT_LIBRARY": str(library)}
    command = [sys.executable, __file__, "--measure", scene, str(path)]
    subprocess.run(command, check=True, env=environment)
    return np.load(path).astype(np.float64)


def main() -> None:
    if sys.argv[1:2] == ["--measure"]:
        np.save(sys.argv[3], measure(sys.argv[2]))
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for part in ("native", "CMakeLists.txt"):
            source, target = ROOT / part, folder / part
            shutil.copytree(source, target) if source.is_dir() else shutil.copy(source, target)
        library = compile_library(folder)
        usual: dict[str, np.ndarray] = {}
        print("| bound | where | moved to | render | mean | noise of it | pixels |")
        print("|---|---|---|---|---|---|---|")
        for clamp in CLAMPS:
            if sys.argv[1:] and clamp.name not in sys.argv[1:]:
                continue
            for scene in clamp.scenes:
                if scene not in usual:
                    usual[scene] = picture(library, scene, folder)
            path = folder / "native/src" / clamp.file
            text = path.read_text()
            assert text.count(clamp.old) == 1, f"{clamp.old} is not in {clamp.file} once"
            path.write_text(text.replace(clamp.old, clamp.new))
            compile_library(folder)
            for scene in clamp.scenes:
                moved, before = picture(library, scene, folder), usual[scene]
                mean = moved.mean() / before.mean() - 1
                change = np.sqrt(np.mean((moved - before) ** 2)) / before.mean()
                noise = (moved - before).std() / before.mean() / np.sqrt(before.shape[0] ** 2)
                value = clamp.new.split("= ")[-1].split(", ")[-1].split(" ")[-1]
                if "<<" in clamp.new:
                    value = clamp.new.split("= ")[-1]
                print(
                    f"| {clamp.name}: {clamp.meaning} | `{clamp.file}`: `{clamp.old}` | "
                    f"`{value}` | {scene} | {mean:.1e} | {noise:.0e} | {change:.1e} |",
                    flush=True,
                )
            path.write_text(text)
            compile_library(folder)


if __name__ == "__main__":
    main()
