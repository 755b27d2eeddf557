# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures of the tests that run inside Blender."""

import math
import os
from pathlib import Path

import bpy
import pytest


@pytest.fixture(autouse=True)
def empty_scene():
    """Every test begins with a fresh, empty scene for our engine."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.render.engine = "AMBERLIGHT"
    return scene


@pytest.fixture(autouse=True)
def every_sample_is_a_number(empty_scene):
    """What the film refuses is a defect, in whichever test."""
    from amberlight import report

    yield
    lines = [line for summary in report.LAST.values() for line in summary.warnings]
    assert not [line for line in lines if "were not finite" in line]


@pytest.fixture
def scene(empty_scene):
    return empty_scene


@pytest.fixture
def fake_library(monkeypatch):
    """The stand-in: its pixels are x + 1000 y in every channel."""
    monkeypatch.setenv("AMBERLIGHT_LIBRARY", os.environ["AMBERLIGHT_FAKE_LIBRARY"])


@pytest.fixture
def real_library():
    from amberlight.binding import library

    if not library.library_path().is_file():
        pytest.skip("the library is not built")


@pytest.fixture
def export():
    """Exports the scene as it is now: (SceneData, lines of the log)."""
    from amberlight.export.export_log import ExportLog
    from amberlight.export.extract import extract_scene

    def run(with_camera=False):
        log = ExportLog()
        depsgraph = bpy.context.evaluated_depsgraph_get()
        return extract_scene(depsgraph, log, with_camera=with_camera), log.lines()

    return run


@pytest.fixture
def camera(scene):
    """An active camera at y = -5 that looks along +y."""
    data = bpy.data.cameras.new("Camera")
    camera = bpy.data.objects.new("Camera", data)
    camera.location = (0, -5, 0)
    camera.rotation_euler = (math.radians(90), 0, 0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    return camera


@pytest.fixture
def add_mesh(scene):
    """Makes an object of vertices and faces."""

    def add(name, vertices, faces, smooth=False):
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata(vertices, [], faces)
        mesh.polygons.foreach_set("use_smooth", [smooth] * len(faces))
        thing = bpy.data.objects.new(name, mesh)
        scene.collection.objects.link(thing)
        return thing

    return add


@pytest.fixture
def render_to(scene, tmp_path):
    """F12 with an OpenEXR file for the result; returns {channel: (height, width) float32}."""
    from exr import read_exr

    def render(name="image"):
        settings = scene.render.image_settings
        if hasattr(settings, "media_type"):
            settings.media_type = "MULTI_LAYER_IMAGE"
        settings.file_format = "OPEN_EXR_MULTILAYER"
        settings.color_depth = "32"
        settings.exr_codec = "NONE"
        # Blender 5 writes a part for each pass unless told to keep them together.
        if hasattr(settings, "use_exr_interleave"):
            settings.use_exr_interleave = True
        scene.render.filepath = str(tmp_path / name)
        assert bpy.ops.render.render(write_still=True) == {"FINISHED"}
        return read_exr(
            Path(scene.render.frame_path(frame=scene.frame_current)).parent / f"{name}.exr"
        )

    return render
