# SPDX-License-Identifier: GPL-3.0-or-later
"""Worlds of any nodes, which Cycles bakes into an image: what it shows beside Cycles' own renders,
when it is out of date, and what goes wrong."""

import math
from pathlib import Path

import bpy
import numpy as np
import pytest
from images import packed_image

OLD = bpy.app.version < (5, 0)
KINDS = ("scenes", "worlds", "cameras", "objects", "meshes", "materials", "images", "node_groups")
STALE = 'what was baked of the world is out of date: Bake World (World properties): world "Sky"'


@pytest.fixture
def world(scene):
    if not hasattr(scene, "cycles"):
        pytest.skip("this Blender has no Cycles")
    world = bpy.data.worlds.new("Sky")
    scene.world = world
    if OLD:
        world.use_nodes = True
    world.amberlight.width = 64
    return world


class Nodes:
    """A Background of what `source` shows."""

    def __init__(self, world):
        self.tree = world.node_tree
        self.tree.nodes.clear()
        self.output = self.add("OutputWorld")
        self.background = self.add("Background")
        self.link(self.background, self.output, "Surface")

    def add(self, kind, **values):
        node = self.tree.nodes.new(f"ShaderNode{kind}")
        for name, value in values.items():
            setattr(node, name, value)
        return node

    def link(self, a, b, name, output=0):
        self.tree.links.new(a.outputs[output], b.inputs[name])

    def show(self, source):
        self.link(source, self.background, "Color")


@pytest.fixture
def nodes(world):
    return Nodes(world)


@pytest.fixture
def sky(nodes):
    """The sky that this version of Blender begins with."""
    node = nodes.add("TexSky", sun_elevation=0.6, sun_rotation=1.0)
    nodes.show(node)
    return node


def state():
    from amberlight.world_bake import state_of

    bpy.context.view_layer.update()
    return state_of(bpy.context.scene.world, bpy.context.scene.frame_current)


def bake():
    assert bpy.ops.amberlight.bake_world() == {"FINISHED"}


def pixels(image):
    width, height = image.size
    return np.array(image.pixels[:], np.float32).reshape(height, width, -1)[..., :3]


def as_cycles_does(scene, samples):
    scene.render.engine = "CYCLES"
    settings = scene.cycles
    settings.samples = samples
    settings.use_denoising = settings.use_adaptive_sampling = False
    settings.pixel_filter_type = "BOX"
    settings.sample_clamp_direct = settings.sample_clamp_indirect = settings.blur_glossy = 0.0
    settings.max_bounces = settings.transmission_bounces = settings.volume_bounces = 64
    settings.diffuse_bounces = settings.glossy_bounces = 64


def rgb(channels):
    return np.stack([channels[f"ViewLayer.Combined.{c}"] for c in "RGB"], axis=-1)


# ---- Beside Cycles -------------------------------------------------------------------------------


def mixed_images(nodes):
    """Two images, one in other hues and one turned by an object, mixed by a gradient that a ramp
    colours: of all this we understand nothing. A volume that would hide it."""
    values = np.random.default_rng(5).uniform(0.1, 2.0, (8, 16, 3)).astype(np.float32)
    # Around the poles Cycles goes on from the top row to the bottom one, and we do not.
    values[0] = values[-1] = 1.0
    hues = nodes.add("HueSaturation", name="Hues")
    hues.inputs["Hue"].default_value = 0.7
    plain = nodes.add(
        "TexEnvironment", name="Plain", image=packed_image("A", values, is_float=True)
    )
    nodes.link(plain, hues, "Color")
    turned = nodes.add("TexEnvironment", image=packed_image("B", values[:, ::-1], is_float=True))
    empty = bpy.data.objects.new("Empty", None)
    empty.rotation_euler = (0.4, 0.2, 1.0)
    nodes.link(nodes.add("TexCoord", object=empty), turned, "Vector", output=3)
    gradient, mix = nodes.add("TexGradient"), nodes.add("MixRGB")
    ramp = nodes.add("ValToRGB", name="Ramp")
    nodes.link(nodes.add("TexCoord"), gradient, "Vector")
    nodes.link(gradient, ramp, 0)
    nodes.link(ramp, mix, 0)
    nodes.link(hues, mix, 1)
    nodes.link(turned, mix, 2)
    nodes.show(mix)
    nodes.link(nodes.add("VolumeScatter"), nodes.output, "Volume")
    return empty


def test_nodes_that_we_do_not_understand(
    scene, world, nodes, camera, render_to, real_library, export
):
    empty = mixed_images(nodes)
    scene.collection.objects.link(empty)
    assert [line.split(": ")[0] for line in export()[1]] == [
        "the volume of the world is ignored",
        'input "Color" is not a constant, its own value is used',
        "Bake World (World properties) lets Cycles evaluate nodes that are not understood",
    ]
    world.amberlight.width = 256
    bake()
    assert [line.split(": ")[0] for line in export()[1]] == ["the volume of the world is ignored"]
    camera.data.angle = math.radians(80)
    scene.render.resolution_x = scene.render.resolution_y = 16
    scene.amberlight.samples = 16
    volume = nodes.output.inputs["Volume"]
    nodes.tree.links.remove(volume.links[0])
    seen = {}
    for engine in ("AMBERLIGHT", "CYCLES"):
        if engine == "CYCLES":
            as_cycles_does(scene, 16)
        views = []
        for turn in range(3):
            camera.rotation_euler = (math.radians((60, 90, 130)[turn]), 0, 0.5 + 2 * turn)
            views.append(rgb(render_to(f"{engine}{turn}")))
        seen[engine] = np.array(views)
    difference = np.abs(seen["CYCLES"] - seen["AMBERLIGHT"])
    assert difference.max() < 0.1
    assert difference.mean() < 0.02
    assert seen["CYCLES"].std() > 0.2


# The sun's angle in radians (0: the default, half a degree), whether there is a ball of amber, and
# the bar.
SUNS = {"true": (0.0, False, 0.005), "wide": (0.35, True, 0.015)}


@pytest.mark.parametrize("sun", SUNS)
def test_a_sky_lights_as_in_cycles(scene, world, nodes, sky, camera, render_to, real_library, sun):
    angle, has_ball, bar = SUNS[sun]
    if angle:
        # Paths that come to the sun through the ball find it by chance.
        sky.sun_size, sky.sun_intensity = angle, 0.01
    nodes.background.inputs["Strength"].default_value = 0.05
    world.amberlight.width = 256 if angle else 2048
    bpy.ops.mesh.primitive_plane_add(size=8)
    material = bpy.data.materials.new("Floor")
    if OLD:
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    floor, output = (
        tree.nodes.new(f"ShaderNode{kind}") for kind in ("BsdfDiffuse", "OutputMaterial")
    )
    tree.links.new(floor.outputs[0], output.inputs["Surface"])
    bpy.context.object.data.materials.append(material)
    if has_ball:
        bpy.ops.mesh.primitive_uv_sphere_add(location=(0, 0, 1.05))
        bpy.ops.object.shade_smooth()
        bpy.ops.amberlight.new_translucent_material(preset="AMBER")
    camera.location, camera.rotation_euler = (0, -7, 3.2), (math.radians(72), 0, 0)
    scene.render.resolution_x, scene.render.resolution_y = 48, 32
    scene.amberlight.samples = 64
    # Bakes the sky by itself: nobody could press a button.
    ours = rgb(render_to("ours"))
    assert state() == "CURRENT"
    as_cycles_does(scene, 512)
    theirs = rgb(render_to("theirs"))
    assert ours.mean() == pytest.approx(theirs.mean(), rel=bar)


def test_light_is_asked_and_not_the_camera(world, nodes):
    mix, shown = nodes.add("MixShader"), nodes.add("Background")
    for node, color in ((nodes.background, (0.25, 0.5, 1, 1)), (shown, (9, 9, 9, 1))):
        node.inputs["Color"].default_value = color
    nodes.link(nodes.add("LightPath"), mix, 0)
    nodes.link(nodes.background, mix, 1)
    nodes.link(shown, mix, 2)
    nodes.link(mix, nodes.output, "Surface")
    bake()
    found = pixels(world.amberlight.image)
    np.testing.assert_allclose(found, np.broadcast_to((0.25, 0.5, 1), found.shape), rtol=1e-5)


# ---- In and out of date --------------------------------------------------------------------------


def test_states(scene, world, nodes, sky, export):
    nodes.tree.links.remove(nodes.background.inputs["Color"].links[0])
    assert state() == "NOT_NEEDED"
    nodes.show(sky)
    assert state() == "MISSING"
    before = {kind: len(getattr(bpy.data, kind)) for kind in KINDS}
    bake()
    assert state() == "CURRENT"
    image = world.amberlight.image
    assert (image.name, tuple(image.size)) == ("Sky Baked", (64, 32))
    data, lines = export()
    assert lines == []
    np.testing.assert_array_equal(data.world_image.radiance, pixels(image))
    # Nothing else stays, and a second one takes the place of the first.
    bake()
    after = {kind: len(getattr(bpy.data, kind)) for kind in KINDS}
    render_result = any(image.type == "RENDER_RESULT" for image in bpy.data.images)
    assert world.amberlight.image.name == "Sky Baked"
    assert after == {**before, "images": before["images"] + 1 + render_result}
    sky.sun_elevation += 0.1
    assert state() == "STALE"
    data, lines = export()
    assert lines == [STALE]
    assert data.world_image is not None
    assert bpy.ops.amberlight.clear_baked_world() == {"FINISHED"}
    assert state() == "MISSING" and "Sky Baked" not in bpy.data.images


def mute(nodes):
    nodes.tree.nodes["Hues"].mute = True


def bend(nodes):
    ramp = nodes.tree.nodes["Ramp"].color_ramp
    ramp.elements[0].position = 0.3


def unlink(nodes):
    nodes.tree.links.remove(nodes.tree.nodes["Ramp"].inputs[0].links[0])


def saturate(nodes):
    nodes.tree.nodes["Hues"].inputs["Saturation"].default_value = 0.5


def turn(nodes):
    bpy.data.objects["Empty"].rotation_euler.x += 0.1


def replace(nodes):
    nodes.tree.nodes["Plain"].image = bpy.data.images["B"]


@pytest.mark.parametrize("change", [mute, bend, unlink, saturate, turn, replace])
def test_changes_are_noticed(scene, nodes, change):
    scene.collection.objects.link(mixed_images(nodes))
    bake()
    assert state() == "CURRENT"
    change(nodes)
    assert state() == "STALE"


def test_what_does_not_show_is_no_change(scene, world, nodes):
    scene.collection.objects.link(mixed_images(nodes))
    bake()
    nodes.add("TexNoise")
    nodes.background.location = (100, 100)
    nodes.background.label = "Here"
    world.name = "Other"
    scene.frame_set(7)
    scene.view_settings.exposure = 3.0
    assert state() == "CURRENT"


def test_groups_are_looked_into(world, nodes):
    group = bpy.data.node_groups.new("Group", "ShaderNodeTree")
    if bpy.app.version < (4, 0):
        group.outputs.new("NodeSocketColor", "Color")
    else:
        group.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
    noise, end = group.nodes.new("ShaderNodeTexNoise"), group.nodes.new("NodeGroupOutput")
    group.links.new(noise.outputs["Color"], end.inputs[0])
    nodes.show(nodes.add("Group", node_tree=group))
    bake()
    assert state() == "CURRENT"
    noise.inputs["Scale"].default_value = 2.0
    assert state() == "STALE"


def test_it_is_saved(world, sky, tmp_path):
    bake()
    before = pixels(world.amberlight.image)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "sky.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "sky.blend"))
    assert state() == "CURRENT"
    np.testing.assert_array_equal(pixels(bpy.context.scene.world.amberlight.image), before)


def test_renders_without_a_window_bake(scene, world, nodes, sky, camera, fake_library, tmp_path):
    """Once, until the nodes say something else: at each frame of an animated world."""
    from amberlight import report

    scene.render.filepath = str(tmp_path / "frame")
    scene.render.resolution_x = scene.render.resolution_y = 8
    bpy.ops.render.render()
    first = world.amberlight.image
    bpy.ops.render.render()
    assert world.amberlight.image == first and state() == "CURRENT"
    strength = nodes.background.inputs["Strength"]
    for frame, value in ((1, 1.0), (3, 3.0)):
        strength.default_value = value
        strength.keyframe_insert("default_value", frame=frame)
    shown = []
    scene.frame_end = 3
    bpy.app.handlers.render_post.append(
        lambda scene, *_: shown.append((scene.name, pixels(world.amberlight.image)))
    )
    try:
        bpy.ops.render.render(animation=True)
    finally:
        bpy.app.handlers.render_post.pop()
    light = [image.mean() for name, image in shown if name == scene.name]
    assert np.array(light) / light[0] == pytest.approx([1.0, 2.0, 3.0], rel=0.01)
    assert "world" not in str(report.LAST[scene.name].warnings)


# ---- Failures ------------------------------------------------------------------------------------


def test_a_world_without_nodes(scene, world):
    if not OLD:
        pytest.skip("there is none")
    world.use_nodes = False
    with pytest.raises(RuntimeError, match='world "Sky" has no nodes to bake'):
        bpy.ops.amberlight.bake_world()


def test_without_cycles(scene, world, sky, camera, fake_library, capfd):
    bpy.ops.preferences.addon_disable(module="cycles")
    try:
        with pytest.raises(RuntimeError, match="Cycles Render Engine: enable it"):
            bpy.ops.amberlight.bake_world()
        # A render does what it can.
        bpy.ops.render.render()
    finally:
        bpy.ops.preferences.addon_enable(module="cycles")
    assert "Cycles Render Engine: enable it" in capfd.readouterr().out
    assert state() == "MISSING"
    assert not [scene for scene in bpy.data.scenes if "Bake" in scene.name]


def test_a_linked_world(scene, world, sky, camera, fake_library, tmp_path, capfd):
    path = str(tmp_path / "sky.blend")
    bpy.data.libraries.write(path, {world})
    with bpy.data.libraries.load(path, link=True) as (_, wanted):
        wanted.worlds = ["Sky"]
    scene.world = wanted.worlds[0]
    with pytest.raises(RuntimeError, match="make it local to bake it"):
        bpy.ops.amberlight.bake_world()
    bpy.ops.render.render()
    assert "make it local to bake it" in capfd.readouterr().out
    assert Path(path).is_file()
