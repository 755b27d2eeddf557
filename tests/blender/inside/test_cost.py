# SPDX-License-Identifier: GPL-3.0-or-later
"""The cost report in Blender: what it exports, what the operators leave, applied rows."""

import json

import bpy
import numpy as np
import pytest
from amberlight import operators_cost
from amberlight.cost import exr
from amberlight.engine import export_for_render


@pytest.fixture
def small(scene, camera):
    scene.render.resolution_x, scene.render.resolution_y = 24, 16
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=3)
    bpy.ops.object.shade_smooth()
    bpy.ops.amberlight.new_translucent_material(preset="RESIN")
    bpy.ops.object.light_add(type="SPOT", location=(0, 0, 5))
    bpy.context.object.data.shadow_soft_size = 0
    return scene


@pytest.fixture
def quick(small, tmp_path):
    wanted = small.amberlight_cost
    wanted.size, wanted.samples, wanted.repeats = 12, 1, 1
    wanted.time_limit = 2.5
    wanted.directory = str(tmp_path / "cost")
    return small


def state():
    return bpy.context.window_manager.amberlight_cost


# ---- Export --------------------------------------------------------------------------------------


def test_export_is_what_a_render_sees(small):
    """Modifiers and visibility have other settings in the viewport."""
    ball = bpy.data.objects["Icosphere"]
    modifier = ball.modifiers.new("Subdivision", "SUBSURF")
    modifier.levels, modifier.render_levels = 0, 1
    bpy.ops.mesh.primitive_plane_add()
    bpy.context.object.hide_render = True
    small.render.use_border = True
    exported = export_for_render(small, "ViewLayer")
    assert [item.name for item in exported.data.objects] == ["Icosphere"]
    faces = len(ball.data.polygons)
    assert len(exported.data.meshes[0].triangles) == faces * 3 * 2
    assert (exported.frame.width, exported.frame.height) == (24, 16)
    assert exported.frame.crop is None and small.render.use_border


def test_export_keeps_the_picture_of_an_earlier_render(small, fake_library, tmp_path):
    assert bpy.ops.render.render() == {"FINISHED"}
    result = next(image for image in bpy.data.images if image.type == "RENDER_RESULT")

    def saved(name):
        small.render.image_settings.file_format = "OPEN_EXR"
        result.save_render(str(tmp_path / name))
        return (tmp_path / name).read_bytes()

    before = saved("before.exr")
    export_for_render(small, "ViewLayer")
    assert saved("after.exr") == before
    # And the engine renders again.
    assert bpy.ops.render.render() == {"FINISHED"}


def test_export_says_why_not(small):
    small.camera = None
    with pytest.raises(RuntimeError, match="no camera"):
        export_for_render(small, "ViewLayer")
    small.camera = bpy.data.objects["Camera"]
    small.camera.data.type = "PANO"
    with pytest.raises(RuntimeError, match="perspective and orthographic"):
        export_for_render(small, "ViewLayer")
    small.camera.data.type = "PERSP"
    assert export_for_render(small, "ViewLayer").data.camera


# ---- Operators -----------------------------------------------------------------------------------


def test_measure_with_the_stand_in(quick, fake_library, tmp_path):
    assert bpy.ops.amberlight.measure_cost() == {"FINISHED"}
    files = {path.name for path in (tmp_path / "cost").iterdir()}
    assert {"cost.csv", "cost.md", "cost_reference.exr"} <= files
    assert not state().is_running
    names = [row.estimator for row in state().rows]
    assert {"POINTS_FIXED", "POINTS_COVARIANCE"} <= set(names)
    assert names == sorted(names, key=names.index), "rows of an estimator stand together"
    if "cost.png" in files:
        assert any(image.filepath.endswith("cost.png") for image in bpy.data.images)


def test_measure_the_real_library(quick, real_library, tmp_path):
    quick.amberlight_cost.time_limit = 12.0
    assert bpy.ops.amberlight.measure_cost() == {"FINISHED"}
    text = (tmp_path / "cost" / "cost.md").read_text()
    assert "reference: TUBES, refinement" in text
    tubes = {row.tube_refinement: row.error for row in state().rows if row.estimator == "TUBES"}
    # Nothing up to 0 cuts so smooth a mesh more; a slow machine may not come any further in time.
    coarse = tubes[min(tubes)]
    assert coarse > 0 and all(0 < error < coarse for level, error in tubes.items() if level > 0)
    points = [row for row in state().rows if row.estimator != "TUBES"]
    assert len(points) >= 6 and all(0 < row.error < 1 and row.total > 0 for row in points)
    # Both files have the image that was measured, of the size that was wanted.
    for name in ("reference", "points_fixed"):
        channels = exr.read(tmp_path / "cost" / f"cost_{name}.exr")
        green = channels["Single Scattering.G"]
        assert green.shape == (8, 12) and green.max() > 0


def test_reference_from_the_engines_own_files(quick, real_library, tmp_path):
    """What `./amberlight render` writes can be the reference: the EXR of the C library."""
    quick.render.resolution_percentage = 50
    quick.amberlight.exr_path = str(tmp_path / "own.exr")
    quick.amberlight.estimator = "TUBES"
    quick.amberlight.samples = 1
    # The reflections that the sweep has too: those set.
    quick.amberlight.effects = "MANUAL"
    bpy.ops.render.render()
    wanted = quick.amberlight_cost
    wanted.reference = str(tmp_path / "own.exr")
    wanted.time_limit = 8.0
    assert bpy.ops.amberlight.measure_cost() == {"FINISHED"}
    # The same rays, the same estimator: the row is the reference, bit for bit.
    rows = [row for row in state().rows if row.estimator == "TUBES" and row.tube_refinement == 0]
    assert rows and all(row.error == 0 for row in rows)
    csv = (tmp_path / "cost" / "cost.csv").read_text().splitlines()
    names = csv[0].split(",")
    rows = [dict(zip(names, line.split(","), strict=True)) for line in csv[1:]]
    tubes = next(r for r in rows if r["estimator"] == "TUBES" and r["tube_refinement"] == "0")
    assert float(tubes["rel_rmse"]) == 0.0


def remove(name):
    return lambda scene: bpy.data.objects.remove(bpy.data.objects[name])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda scene: setattr(scene, "camera", None), "no camera"),
        (lambda scene: setattr(scene.amberlight_cost, "reference", "/no.npy"), "cannot be read"),
        (remove("Spot"), "nothing to measure: no lamp"),
        (remove("Icosphere"), "no translucent object is in view"),
    ],
)
def test_measure_fails_in_words(quick, real_library, tmp_path, change, words):
    change(quick)
    with pytest.raises(RuntimeError, match=words):
        bpy.ops.amberlight.measure_cost()
    assert not state().is_running and not (tmp_path / "cost").exists()


def test_measure_is_offered_for_our_engine_only(quick):
    assert operators_cost.AMBERLIGHT_OT_measure_cost.poll(bpy.context)
    quick.render.engine = "CYCLES"
    assert not operators_cost.AMBERLIGHT_OT_measure_cost.poll(bpy.context)


def test_unsaved_files_write_beside_nothing(scene):
    assert str(operators_cost.output_folder(scene)).startswith(bpy.app.tempdir.rstrip("/"))


# ---- Rows ----------------------------------------------------------------------------------------


def add_rows():
    state().rows.clear()
    for values in (
        {"estimator": "POINTS_FIXED", "light_samples": 32768, "kernel_size": 0.25},
        {"estimator": "TUBES", "tube_refinement": 3},
    ):
        row = state().rows.add()
        for name, value in values.items():
            setattr(row, name, value)


def test_apply_row(scene):
    add_rows()
    ours = scene.amberlight
    ours.tube_refinement, ours.accuracy = 1, 0.05
    assert bpy.ops.amberlight.apply_cost_row(index=0) == {"FINISHED"}
    applied = (ours.estimator, ours.light_samples, ours.kernel_size, ours.tube_refinement)
    assert applied == ("POINTS_FIXED", 32768, 0.25, 1)
    # A target would choose the refinement and the samples itself.
    assert ours.accuracy == 0
    # Without an index it is the active row; what tubes do not use stays.
    state().active = 1
    assert bpy.ops.amberlight.apply_cost_row() == {"FINISHED"}
    applied = (ours.estimator, ours.light_samples, ours.kernel_size, ours.tube_refinement)
    assert applied == ("TUBES", 32768, 0.25, 3)
    with pytest.raises(RuntimeError, match="there is no row 2"):
        bpy.ops.amberlight.apply_cost_row(index=2)
    state().rows.clear()
    assert not operators_cost.AMBERLIGHT_OT_apply_cost_row.poll(bpy.context)


def test_applied_row_can_be_undone(scene):
    bpy.context.preferences.edit.use_global_undo = True
    bpy.ops.ed.undo_push(message="before")
    add_rows()
    bpy.ops.amberlight.apply_cost_row(index=0)
    bpy.ops.ed.undo_push(message="applied")
    assert bpy.context.scene.amberlight.estimator == "POINTS_FIXED"
    bpy.ops.ed.undo()
    assert bpy.context.scene.amberlight.estimator == "AUTO"
    # The rows are not a part of the file, so that undo leaves them.
    assert len(state().rows) == 2
    assert "UNDO" in operators_cost.AMBERLIGHT_OT_apply_cost_row.bl_options


def test_request_renders_what_the_scene_renders(small, real_library, tmp_path):
    """The settings of the scene but for those that are swept."""
    ours = small.amberlight
    ours.light_bounces, ours.adjoint_normals, ours.seed, ours.samples = 2, False, 9, 77
    ours.accuracy = 0.02
    exported = export_for_render(small, "ViewLayer")
    small.amberlight_cost.size = 12
    request = operators_cost.cost_request(small, exported, "name", tmp_path)
    params = request.params
    assert (params["light_bounces"], params["adjoint_normals"], params["seed"]) == (2, 0, 9)
    assert (params["width"], params["height"], params["samples"]) == (12, 8, 4)
    assert params["accuracy"] == 0
    assert request.options.time_limit == 300.0
    np.save(tmp_path / "a.npy", np.ones((16, 24, 3)))
    small.amberlight_cost.reference = str(tmp_path / "a.npy")
    request = operators_cost.cost_request(small, exported, "name", tmp_path)
    assert (request.params["width"], request.params["height"]) == (24, 16)
    assert json.dumps(request.params)
