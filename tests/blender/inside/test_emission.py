# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes that emit light: lamps of the library, and as bright as in Cycles."""

import json

import bpy
import numpy as np
import pytest


def add_nodes(thing, kind, volume=False, **values):
    material = bpy.data.materials.new(thing.name)
    if bpy.app.version < (5, 0):
        material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    node = nodes.new(kind)
    for name, value in values.items():
        node.inputs[name].default_value = value
    output = nodes.new("ShaderNodeOutputMaterial")
    place = output.inputs["Volume" if volume else "Surface"]
    material.node_tree.links.new(node.outputs[0], place)
    thing.data.materials.append(material)


@pytest.fixture
def small(scene, camera):
    scene.render.resolution_x, scene.render.resolution_y = 24, 16
    scene.amberlight.light_samples = 2**17
    camera.data.lens = 24
    return scene


@pytest.fixture
def panel_and_ring(small):
    """Over a floor, beside a ball of fog that light enters straight."""
    bpy.ops.mesh.primitive_plane_add(size=12, location=(0, 2, -1))
    add_nodes(bpy.context.object, "ShaderNodeBsdfDiffuse", Color=(0.8, 0.8, 0.8, 1))
    bpy.ops.mesh.primitive_plane_add(size=0.5, location=(-1.5, 0, 1.5), rotation=(0, 0.6, 0))
    bpy.context.object.name = "Panel"
    add_nodes(bpy.context.object, "ShaderNodeEmission", Color=(1, 0.6, 0.3, 1), Strength=40)
    bpy.ops.mesh.primitive_torus_add(
        location=(1.4, -0.4, 0.2), major_radius=0.3, minor_radius=0.04, rotation=(0.5, 0.3, 0)
    )
    bpy.context.object.name = "Ring"
    add_nodes(bpy.context.object, "ShaderNodeEmission", Color=(0.2, 0.5, 1, 1), Strength=10)
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=4, radius=0.7, location=(0, 0, 0))
    fog = {"Color": (0.7, 0.7, 0.7, 1), "Density": 1.0, "Anisotropy": 0.3}
    add_nodes(bpy.context.object, "ShaderNodeVolumeScatter", volume=True, **fog)
    return small


def test_the_report_names_them(panel_and_ring, real_library, render_to, tmp_path):
    panel_and_ring.amberlight.report_path = str(tmp_path / "report.json")
    panel_and_ring.amberlight.samples = 1
    render_to()
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["light"]["mesh_lamps"] == ["Panel", "Ring"]


def test_a_principled_surface_that_glows_is_a_lamp(small, real_library, render_to, tmp_path):
    bpy.ops.mesh.primitive_plane_add(size=12, location=(0, 2, -1))
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.2, location=(0, 0, 1))
    bpy.context.object.name = "Bulb"
    color = "Emission" if bpy.app.version < (4, 0) else "Emission Color"
    values = {color: (1, 1, 1, 1), "Emission Strength": 5.0}
    add_nodes(bpy.context.object, "ShaderNodeBsdfPrincipled", **values)
    small.amberlight.report_path = str(tmp_path / "report.json")
    small.amberlight.samples = 1
    render_to()
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["light"]["mesh_lamps"] == ["Bulb"]


def test_they_light_floor_and_fog_as_in_cycles(panel_and_ring, real_library, render_to):
    scene = panel_and_ring
    if "cycles" not in dir(scene):
        pytest.skip("no Cycles")
    # Photons take the fog's shadow on the floor for black.
    scene.amberlight.scatter_estimator = "WALK"
    seen = {}
    for engine in ("CYCLES", "AMBERLIGHT"):
        scene.render.engine = engine
        scene.amberlight.samples = scene.cycles.samples = 1000
        scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
        scene.cycles.pixel_filter_type = "BOX"
        scene.cycles.max_bounces = scene.cycles.diffuse_bounces = 32
        scene.cycles.volume_bounces = 32
        scene.cycles.sample_clamp_indirect = 0
        channels = render_to(engine)
        seen[engine] = np.stack([channels[f"ViewLayer.Combined.{c}"] for c in "RGB"], axis=-1)
    ours, cycles = seen["AMBERLIGHT"], seen["CYCLES"]
    # Where the camera sees what shines there are but edges to compare.
    floor, fog = (slice(0, 6), slice(0, 24)), (slice(6, 9), slice(10, 14))
    assert cycles[floor].max() < 0.5 and cycles[fog].min() > 0.01  # nothing of what shines
    for place, noise in ((floor, 0.01), (fog, 0.05)):
        means = [image[place].mean(axis=(0, 1)) for image in (ours, cycles)]
        assert means[0] == pytest.approx(means[1], rel=noise)
    assert ours[floor] == pytest.approx(cycles[floor], rel=0.3, abs=0.01)
