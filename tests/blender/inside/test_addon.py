# SPDX-License-Identifier: GPL-3.0-or-later
"""Registration and settings."""

from ctypes import byref

import addon_utils
import bpy
from amberlight.binding import _ffi, library
from amberlight.render_job import Frame, Settings, render_params

SETTINGS = {
    "estimator": "AUTO", "samples": 16, "accuracy": 0.0, "light_samples": 1_000_000,
    "kernel_size": 4.0, "tube_refinement": 0, "effects": "AUTO", "use_single_scattering": True,
    "use_double_scattering": False, "use_multiple_scattering": False,
    "use_world_light": False, "use_surface_reflection": True, "use_background": True,
    "use_transmitted_light": True, "use_caustics": True, "use_interreflection": True,
    "use_lamp_images": True, "light_bounces": 0, "camera_bounces": 0,
    "adjoint_normals": True, "seed": 0,
    "scatter_estimator": "AUTO", "scatter_order_max": 0, "memory_limit": 0,
    "report_path": "", "exr_path": "",
}  # fmt: skip


def panels():
    return {
        panel.__name__
        for panel in bpy.types.Panel.__subclasses__()
        if "AMBERLIGHT" in getattr(panel, "COMPAT_ENGINES", ())
    }


def test_register_twice(scene):
    before = panels()
    for _ in range(2):
        addon_utils.disable("amberlight")
        assert not hasattr(bpy.types.Scene, "amberlight")
        assert not {name for name in panels() if not name.startswith("AMBERLIGHT")}
        addon_utils.enable("amberlight")
        assert panels() == before
    scene.render.engine = "AMBERLIGHT"
    assert scene.amberlight.samples == 16


def test_settings(scene):
    names = {p.identifier for p in scene.amberlight.bl_rna.properties}
    assert names == {"rna_type", "name", *SETTINGS}
    assert {name: getattr(scene.amberlight, name) for name in SETTINGS} == SETTINGS


def test_defaults_are_the_librarys(real_library):
    params = _ffi.AmbRenderParams()
    library.load().amb_render_params_init(byref(params))
    for name, value in render_params(Settings(effects="MANUAL"), Frame(0, 0)).items():
        if name not in {"width", "height"}:
            assert getattr(params, name) == value, name


def test_estimators(scene):
    items = scene.amberlight.bl_rna.properties["estimator"].enum_items.keys()
    assert items == ["AUTO", "POINTS_FIXED", "POINTS_COVARIANCE", "TUBES", "SPECULAR"]


def test_panels_of_the_standard_places():
    want = {"DATA_PT_camera_dof", "DATA_PT_lens", "EEVEE_MATERIAL_PT_context_material"}
    want |= {"RENDER_PT_format", "RENDER_PT_output", "RENDER_PT_color_management"}
    have = {n.replace("_dimensions", "_format") for n in panels()}
    assert want <= have


def test_new_translucent_material(add_mesh, export):
    thing = add_mesh("Tri", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    bpy.context.view_layer.objects.active = thing
    assert bpy.ops.amberlight.new_translucent_material(preset="RESIN") == {"FINISHED"}
    data, lines = export()
    material = data.materials[data.objects[0].materials[0]]
    assert lines == [] and material.is_dielectric and material.ior == 1.5
    from pytest import approx

    assert material.medium.sigma_a == approx((0.01, 0.1, 0.25))
    assert material.medium.lobes[0].sigma_s == approx((0.25, 0.25, 0.25))
    assert material.medium.lobes[0].g == approx(0.9)


def test_explain_effects(scene, camera, add_mesh, real_library):
    """The plan of the scene as text: nothing is rendered."""
    scene.render.engine = "AMBERLIGHT"
    add_mesh("Tri", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    assert bpy.ops.amberlight.explain_effects() == {"FINISHED"}
    text = bpy.data.texts["Amberlight Effects"].as_string()
    assert text.startswith("effects chosen by share")
    assert "single scattering: skipped, no medium scatters" in text
    assert "background through objects: skipped, no translucent object" in text
