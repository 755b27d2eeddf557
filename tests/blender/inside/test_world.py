# SPDX-License-Identifier: GPL-3.0-or-later
"""Images of the world: what is read from the nodes, and Cycles' orientation."""

import math

import bpy
import numpy as np
import pytest
from images import packed_image


@pytest.fixture
def world(scene):
    """A world of nodes whose Background shows an Environment Texture."""
    world = bpy.data.worlds.new("Sky")
    scene.world = world
    if bpy.app.version < (5, 0):
        world.use_nodes = True
    return Sky(world)


class Sky:
    def __init__(self, world):
        self.tree = world.node_tree
        self.tree.nodes.clear()
        self.output = self.tree.nodes.new("ShaderNodeOutputWorld")
        self.background = self.tree.nodes.new("ShaderNodeBackground")
        self.texture = self.tree.nodes.new("ShaderNodeTexEnvironment")
        self.link(self.background, self.output, "Surface")
        self.link(self.texture, self.background, "Color")

    def link(self, a, b, name, output=0):
        self.tree.links.new(a.outputs[output], b.inputs[name])

    def image(self, values, *, is_float=True):
        self.texture.image = packed_image("Sky", values, is_float=is_float)
        return self.texture.image

    def turn(self, kind, rotation):
        mapping = self.tree.nodes.new("ShaderNodeMapping")
        mapping.vector_type = kind
        mapping.inputs["Rotation"].default_value = rotation
        place = self.tree.nodes.new("ShaderNodeTexCoord")
        self.link(place, mapping, "Vector", "Generated")
        self.link(mapping, self.texture, "Vector")
        return mapping


def random_image(width=16, height=8):
    return np.random.default_rng(5).uniform(0.1, 2.0, (height, width, 3)).astype(np.float32)


def test_an_image_is_read(world, export):
    values = random_image()
    world.image(values)
    world.background.inputs["Strength"].default_value = 2.5
    data, lines = export()
    assert lines == []
    np.testing.assert_allclose(data.world_image.radiance, 2.5 * values, rtol=1e-6)
    np.testing.assert_allclose(data.world_image.to_world, np.eye(3))
    assert data.world_image.radiance.dtype == np.float32


def test_bytes_are_converted(world, export):
    image = world.image(np.full((2, 4, 3), 0.5, np.float32), is_float=False)
    assert not image.is_float
    byte = round(0.5 * 255) / 255
    data, lines = export()
    assert lines == []
    linear = ((byte + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(data.world_image.radiance, linear, rtol=1e-5)
    image.colorspace_settings.name = "Non-Color"
    np.testing.assert_allclose(export()[0].world_image.radiance, byte, rtol=1e-5)


def test_a_colour_multiplies(world, export):
    values = random_image()
    world.image(values)
    if bpy.app.version < (3, 4):
        pytest.skip("no Mix node for colours")
    mix = world.tree.nodes.new("ShaderNodeMix")
    mix.data_type, mix.blend_type = "RGBA", "MULTIPLY"
    colors = [s for s in mix.inputs if s.type == "RGBA"]
    next(s for s in mix.inputs if s.type == "VALUE" and s.enabled).default_value = 1.0
    colors[1].default_value = (0.5, 1.0, 2.0, 1.0)
    world.tree.links.new(world.texture.outputs[0], colors[0])
    output = next(s for s in mix.outputs if s.type == "RGBA")
    world.tree.links.new(output, world.background.inputs["Color"])
    data, lines = export()
    assert lines == []
    expected = values * np.array([0.5, 1.0, 2.0])
    np.testing.assert_allclose(data.world_image.radiance, expected, rtol=1e-6)


def test_what_is_not_understood_is_named(world, export):
    values = random_image()
    world.image(values)
    world.texture.projection = "MIRROR_BALL"
    data, lines = export()
    assert data.world_image is None
    assert data.world == pytest.approx(tuple(values.mean(axis=(0, 1))), rel=1e-5)
    assert "mirror ball" in lines[0]
    world.texture.projection = "EQUIRECTANGULAR"
    mapping = world.turn("POINT", (0, 0, 0))
    mapping.inputs["Scale"].default_value = (1, 2, 1)
    mapping.inputs["Location"].default_value = (0, 0, 1)
    assert [line.split(": ")[0] for line in export()[1]] == [
        "its scale is ignored",
        "its location is ignored",
        "Bake World (World properties) lets Cycles evaluate nodes that are not understood",
    ]
    world.texture.image = None
    data, lines = export()
    assert data.world == (0, 0, 0) and data.world_image is None
    assert "no image" in lines[0]


@pytest.mark.parametrize(
    ("kind", "rotation"),
    [
        (None, None),
        ("POINT", (0, 0, 1.0)),
        ("TEXTURE", (0.3, -0.4, 2.0)),
        ("POINT", (0.5, 0.7, -1)),
    ],
)
def test_cycles_sees_the_same(scene, world, camera, render_to, real_library, kind, rotation):
    """Into each octant, with another colour in each pixel of a small image."""
    if not hasattr(scene, "cycles"):
        pytest.skip("this Blender has no Cycles")
    values = random_image()
    # Around the poles Cycles goes on from the top row to the bottom one, and we do not.
    values[0] = values[-1] = 1.0
    world.image(values)
    if kind:
        world.turn(kind, rotation)
    camera.data.angle = math.radians(35)
    scene.render.resolution_x = scene.render.resolution_y = 8
    scene.amberlight.samples = 16
    scene.cycles.samples = 16
    scene.cycles.use_denoising = False
    scene.cycles.pixel_filter_type = "BOX"
    seen = {}
    for engine in ("CYCLES", "AMBERLIGHT"):
        scene.render.engine = engine
        views = []
        for octant in range(8):
            turn = math.radians(45 + 90 * (octant % 4))
            camera.rotation_euler = (math.radians(60 if octant < 4 else 120), 0, turn)
            channels = render_to(f"{engine}{octant}")
            views.append([channels[f"ViewLayer.Combined.{c}"] for c in "RGB"])
        seen[engine] = np.array(views)
    # Sampling inside the pixels differs; a wrong turn would be wrong by half.
    difference = np.abs(seen["CYCLES"] - seen["AMBERLIGHT"])
    assert difference.max() < 0.1
    assert difference.mean() < 0.02
    assert seen["CYCLES"].std() > 0.2


def test_priority_is_exported(scene, add_mesh, export):
    thing = add_mesh("Thing", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    material = bpy.data.materials.new("Glass")
    if bpy.app.version < (5, 0):
        material.use_nodes = True
    thing.data.materials.append(material)
    assert export()[0].materials[0].priority == 0
    material.amberlight.priority = -3
    assert export()[0].materials[0].priority == -3


@pytest.mark.parametrize("kelvin", [900, 1500, 1900, 3000, 5000, 6500, 9000, 20000])
def test_black_bodies_have_the_colour_of_cycles(scene, world, camera, render_to, export, kelvin):
    if not hasattr(scene, "cycles"):
        pytest.skip("this Blender has no Cycles")
    node = world.tree.nodes.new("ShaderNodeBlackbody")
    node.inputs["Temperature"].default_value = kelvin
    world.link(node, world.background, "Color")
    data, lines = export()
    assert lines == []
    scene.render.engine = "CYCLES"
    scene.render.resolution_x = scene.render.resolution_y = 4
    scene.cycles.samples = 1
    scene.cycles.use_denoising = False
    channels = render_to("cycles")
    seen = np.array([channels[f"ViewLayer.Combined.{c}"].mean() for c in "RGB"])
    bar = 0.03 if kelvin >= 1500 else 0.1
    assert np.abs(np.array(data.world) - seen).max() < bar * seen.max()


def test_the_camera_sees_the_world_that_lights(world, export):
    """A world of one colour for the camera and another for all else: the usual mix."""
    kinds = world.tree.nodes.new("ShaderNodeLightPath")
    mix = world.tree.nodes.new("ShaderNodeMixShader")
    shown = world.tree.nodes.new("ShaderNodeBackground")
    world.tree.links.remove(world.background.inputs["Color"].links[0])
    world.background.inputs["Color"].default_value = (0.25, 0.5, 1.0, 1.0)
    world.tree.links.new(kinds.outputs["Is Camera Ray"], mix.inputs[0])
    world.tree.links.new(world.background.outputs[0], mix.inputs[1])
    world.tree.links.new(shown.outputs[0], mix.inputs[2])
    world.link(mix, world.output, "Surface")
    data, lines = export()
    assert data.world == (0.25, 0.5, 1.0)
    assert lines == [
        'kinds of rays are not told apart, it is 0 for all: world "Sky", node "Light Path"'
    ]


@pytest.mark.parametrize("rays", ["camera", "diffuse", "glossy", "transmission", "scatter"])
def test_a_hidden_world_is_named(scene, world, export, rays):
    if not hasattr(scene.world, "cycles_visibility"):
        pytest.skip("no Cycles, or a newer place of these")
    world.tree.links.remove(world.background.inputs["Color"].links[0])
    setattr(scene.world.cycles_visibility, rays, False)
    assert export()[1] == ['the ray visibility of the world is ignored: world "Sky"']
