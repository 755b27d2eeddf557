# SPDX-License-Identifier: GPL-3.0-or-later
"""Images on opaque surfaces: what is read from the nodes, and Cycles' placement."""

import math

import bpy
import numpy as np
import pytest
from images import packed_image


@pytest.fixture
def floor(scene, add_mesh):
    """A square whose material shows an image by its UV map, two triangles of a fan."""
    thing = add_mesh("Floor", [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [(0, 1, 2, 3)])
    layer = thing.data.uv_layers.new(name="Map")
    for loop, uv in zip(layer.data, [(0, 0), (1, 0), (1, 1), (0, 1)], strict=True):
        loop.uv = uv
    material = bpy.data.materials.new("Checks")
    if bpy.app.version < (5, 0):
        material.use_nodes = True
    thing.data.materials.append(material)
    return Floor(thing, material.node_tree)


class Floor:
    def __init__(self, thing, tree):
        self.thing, self.tree = thing, tree
        tree.nodes.clear()
        self.output = tree.nodes.new("ShaderNodeOutputMaterial")
        self.surface = tree.nodes.new("ShaderNodeBsdfDiffuse")
        self.texture = tree.nodes.new("ShaderNodeTexImage")
        self.link(self.surface, self.output, "Surface")
        self.link(self.texture, self.surface, "Color")

    def link(self, a, b, name, output=0):
        self.tree.links.new(a.outputs[output], b.inputs[name])

    def image(self, values, *, is_float=True):
        self.texture.image = packed_image("Checks", values, is_float=is_float)
        return self.texture.image

    def place(self, kind, **values):
        """A Mapping node between the UV map and the image."""
        mapping = self.tree.nodes.new("ShaderNodeMapping")
        mapping.vector_type = kind
        for name, value in values.items():
            mapping.inputs[name].default_value = value
        place = self.tree.nodes.new("ShaderNodeTexCoord")
        self.link(place, mapping, "Vector", "UV")
        self.link(mapping, self.texture, "Vector")


def random_image(width=5, height=4):
    return np.random.default_rng(3).uniform(0.05, 0.95, (height, width, 3)).astype(np.float32)


def test_an_image_and_its_coordinates_are_read(floor, export):
    values = random_image()
    floor.image(values)
    data, lines = export()
    assert lines == []
    material, mesh = data.materials[0], data.meshes[0]
    assert material.albedo == (1, 1, 1)
    np.testing.assert_array_equal(material.texture.texture.color, values)
    assert material.texture.to_texture == (1, 0, 0, 0, 1, 0)
    assert mesh.uvs.shape == (2, 3, 2) and mesh.uvs.dtype == np.float32
    # As corners lie in space.
    np.testing.assert_allclose(mesh.uvs, mesh.positions[mesh.triangles][..., :2] / 2 + 0.5)


def test_meshes_without_textures_have_no_coordinates(floor, export):
    floor.tree.links.remove(floor.surface.inputs["Color"].links[0])
    data, lines = export()
    assert lines == [] and data.meshes[0].uvs is None and data.materials[0].texture is None


def test_bytes_are_converted_and_shared(floor, export):
    floor.image(np.full((2, 4, 3), 0.5, np.float32), is_float=False)
    twin = floor.thing.data.materials[0].copy()
    floor.thing.data.materials.append(twin)
    data, lines = export()
    assert lines == []
    linear = ((round(0.5 * 255) / 255 + 0.055) / 1.055) ** 2.4
    first, second = (material.texture.texture for material in data.materials)
    np.testing.assert_allclose(first.color, linear, rtol=1e-5)
    assert first is second


def test_a_mix_is_one_image(floor, export):
    values = random_image()
    floor.image(values)
    mix = floor.tree.nodes.new("ShaderNodeMixShader")
    other = floor.tree.nodes.new("ShaderNodeBsdfDiffuse")
    other.inputs["Color"].default_value = (0.2, 0.4, 0.6, 1)
    mix.inputs[0].default_value = 0.25
    floor.tree.links.new(floor.surface.outputs[0], mix.inputs[1])
    floor.tree.links.new(other.outputs[0], mix.inputs[2])
    floor.link(mix, floor.output, "Surface")
    data, lines = export()
    assert lines == []
    color = data.materials[0].texture.texture.color * np.array(data.materials[0].albedo)
    np.testing.assert_allclose(color, 0.75 * values + 0.25 * np.array([0.2, 0.4, 0.6]), rtol=1e-5)


def test_what_cannot_be_placed_is_its_mean(floor, export):
    values = random_image()
    floor.image(values)
    place = floor.tree.nodes.new("ShaderNodeTexCoord")
    floor.link(place, floor.texture, "Vector", "Generated")
    data, lines = export()
    assert data.materials[0].texture is None
    np.testing.assert_allclose(data.materials[0].albedo, values.mean(axis=(0, 1)), rtol=1e-5)
    assert len(lines) == 1 and "UV map" in lines[0] and "Image Texture" in lines[0]


def test_what_is_missing_is_said(floor, export):
    floor.image(random_image())
    floor.thing.data.uv_layers.remove(floor.thing.data.uv_layers[0])
    data, lines = export()
    assert data.meshes[0].uvs is None
    assert len(lines) == 1 and "UV map" in lines[0] and "Floor" in lines[0]
    floor.texture.image = None
    assert export()[0].materials[0].texture is None


@pytest.mark.parametrize(
    ("extension", "interpolation", "mapping"),
    [
        ("REPEAT", "Linear", None),
        ("CLIP", "Closest", ("POINT", {"Scale": (1.5, 0.7, 1), "Location": (-0.2, 0.1, 0.3)})),
        ("EXTEND", "Linear", ("POINT", {"Scale": (2, 1, 3), "Rotation": (0.3, -0.4, 0.8)})),
        (
            "REPEAT",
            "Closest",
            (
                "TEXTURE",
                {
                    "Scale": (0.6, 0.9, 1),
                    "Rotation": (0.2, 0.5, -1.1),
                    "Location": (0.3, -0.2, 0.4),
                },
            ),
        ),
        ("REPEAT", "Linear", ("VECTOR", {"Scale": (1, 2, 1), "Rotation": (0, 0, 0.5)})),
    ],
)
def test_cycles_sees_the_same(
    scene, floor, camera, render_to, real_library, extension, interpolation, mapping
):
    """A sheet lit by a sun from above, by pixels as wide as a tenth of the image's."""
    if not hasattr(scene, "cycles"):
        pytest.skip("this Blender has no Cycles")
    floor.image(random_image())
    floor.texture.extension, floor.texture.interpolation = extension, interpolation
    if mapping:
        floor.place(mapping[0], **mapping[1])
    sun = bpy.data.lights.new("Sun", "SUN")
    sun.energy, sun.angle = math.pi, 0.0
    scene.collection.objects.link(bpy.data.objects.new("Sun", sun))
    camera.location, camera.rotation_euler = (0, 0, 5), (0, 0, 0)
    camera.data.type, camera.data.ortho_scale = "ORTHO", 2
    scene.render.resolution_x = scene.render.resolution_y = 40
    scene.amberlight.samples = scene.cycles.samples = 16
    scene.cycles.use_denoising = False
    scene.cycles.pixel_filter_type = "BOX"
    seen = {}
    for engine in ("CYCLES", "AMBERLIGHT"):
        scene.render.engine = engine
        channels = render_to(engine)
        seen[engine] = np.array([channels[f"ViewLayer.Combined.{c}"] for c in "RGB"])
    # Sampling inside the pixels differs where pixels of the image have edges.
    difference = np.abs(seen["CYCLES"] - seen["AMBERLIGHT"])
    assert np.median(difference) < 2e-3
    assert difference.mean() < 0.02
    assert seen["CYCLES"].std() > 0.1
