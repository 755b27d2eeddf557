# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that nobody means well with: each is saved, opened and rendered, and gives a picture or one
clear sentence. With AMB_TEST_LONG in the environment they are larger: hundred thousand instances,
thousands of groups in groups.
"""

import math
import os
import re
from pathlib import Path

import bpy
import numpy as np
import pytest
from amberlight import engine, report
from mathutils import Matrix

LONG = "AMB_TEST_LONG" in os.environ
OLD = bpy.app.version < (4, 0)
PICTURE = ""
TRIANGLE = [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)]

pytestmark = pytest.mark.usefixtures("real_library")


@pytest.fixture
def outcome(scene, camera, tmp_path, monkeypatch):
    """Saves, opens and renders: PICTURE, or the one sentence that Blender shows."""
    write = engine.write_pixels
    passes = []

    def write_checked(target, pixels):
        assert np.isfinite(pixels).all(), f"pass {target.name} has values that are not finite"
        passes.append(target.name)
        write(target, pixels)

    monkeypatch.setattr(engine, "write_pixels", write_checked)
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.render.resolution_x, scene.render.resolution_y = 8, 6
    scene.amberlight.samples, scene.amberlight.light_samples = 1, 200
    scene.amberlight.exr_path = str(tmp_path / "picture.exr")
    scene.amberlight.report_path = str(tmp_path / "report.json")

    def run(change=lambda data: data):
        """`change`: what is done to the bytes of the file."""
        path = tmp_path / "hostile.blend"
        # Blender 5 packs files unless told not to.
        bpy.ops.wm.save_as_mainfile(filepath=str(path), check_existing=False, compress=False)
        path.write_bytes(change(path.read_bytes()))
        bpy.ops.wm.open_mainfile(filepath=str(path))
        report.LAST.clear()
        try:
            bpy.ops.render.render()
        except RuntimeError as error:
            (line,) = {line for line in str(error).splitlines() if line.startswith("Error: ")}
            assert line.startswith("Error: Amberlight: ") and "internal error" not in line
            assert not Path(tmp_path, "picture.exr").exists()
            return line.removeprefix("Error: Amberlight: ")
        assert "Combined" in passes and report.LAST
        assert Path(tmp_path, "picture.exr").exists() and Path(tmp_path, "report.json").exists()
        return PICTURE

    return run


@pytest.fixture
def ball(scene, camera):
    """Something to see, and a sun."""
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=2)
    ball = bpy.context.object
    bpy.ops.amberlight.new_translucent_material(preset="RESIN")
    bpy.ops.object.light_add(type="SUN", location=(0, 0, 5))
    return ball


@pytest.fixture
def tree(ball):
    """The nodes of the ball's material, empty but for the output."""
    tree = ball.active_material.node_tree
    tree.nodes.clear()
    tree.nodes.new("ShaderNodeOutputMaterial")
    return tree


def add_node(tree, kind, into=None, socket=0):
    """A node whose first output goes into an input of `into`."""
    node = tree.nodes.new(f"ShaderNode{kind}")
    if into is not None:
        tree.links.new(node.outputs[0], into.inputs[socket])
    return node


def new_group(name):
    """A group of a shader, and its output node."""
    group = bpy.data.node_groups.new(name, "ShaderNodeTree")
    if OLD:
        group.outputs.new("NodeSocketShader", "Shader")
    else:
        group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    return group, group.nodes.new("NodeGroupOutput")


def use_group(tree, group, into):
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    tree.links.new(node.outputs[0], into.inputs[0])
    return node


# ---- Nodes ---------------------------------------------------------------------------------------


def test_groups_in_groups(tree, outcome):
    inner, end = new_group("Innermost")
    add_node(inner, "BsdfGlass", end)
    for k in range(2000 if LONG else 50):
        group, end = new_group(f"Group {k}")
        use_group(group, inner, end)
        inner = group
    use_group(tree, inner, tree.nodes[0])
    assert outcome() == PICTURE


def test_groups_within_themselves(tree, outcome):
    """Blender itself takes no group into what it contains."""
    (a, end_a), (b, end_b) = new_group("A"), new_group("B")
    use_group(a, b, end_a)
    add_node(b, "BsdfGlass", end_b)
    inner = b.nodes.new("ShaderNodeGroup")
    inner.node_tree = a
    assert inner.node_tree is None
    use_group(tree, a, tree.nodes[0])
    assert outcome() == PICTURE


def test_chain_of_nodes(tree, outcome):
    at = tree.nodes[0]
    for _ in range(1500 if LONG else 400):
        at = add_node(tree, "AddShader", at)
    add_node(tree, "BsdfGlass", at)
    assert outcome().endswith("its nodes are too many in a row")


def test_many_nodes(tree, outcome):
    """A sum of many media."""
    level = [(tree.nodes[0], 1)]
    for _ in range(10 if LONG else 8):
        nodes = [add_node(tree, "AddShader", node, socket) for node, socket in level]
        level = [(node, socket) for node in nodes for socket in range(2)]
    for node, socket in level:
        add_node(tree, "VolumeScatter", node, socket).inputs["Density"].default_value = 0.001
    assert outcome() == PICTURE


def test_rings(tree, outcome):
    """Shaders, numbers and reroutes that are linked to themselves. Which links of a ring are valid
    is for Blender to say, 4.3 leaves others than 3.4: a picture, or nodes without end."""
    a = add_node(tree, "AddShader", tree.nodes[0])
    b = add_node(tree, "AddShader", a)
    tree.links.new(a.outputs[0], b.inputs[0])
    tree.links.new(b.outputs[0], b.inputs[1])
    glass = add_node(tree, "BsdfGlass", a, 1)
    number = add_node(tree, "Math", glass, "IOR")
    other = add_node(tree, "Math", number)
    tree.links.new(number.outputs[0], other.inputs[0])
    route = tree.nodes.new("NodeReroute")
    tree.links.new(route.outputs[0], route.inputs[0])
    tree.links.new(route.outputs[0], glass.inputs["Color"])
    said = outcome()
    assert said == PICTURE or said.endswith("its nodes are too many in a row"), said


# ---- Names ---------------------------------------------------------------------------------------

NAMES = (
    "a\nb\r\tc", "\x01\x1b[31m", "%s%n{0}\\", "\U0001f9c1" * 15, "x" * 63, "é" * 31, "\"'</>",
    "../../" * 10, " ", "\u202egnirts",
)  # fmt: skip


def name_all(scene, ball, name):
    """Everything of the scene, and what the export has something to say about."""
    tree = ball.active_material.node_tree
    texture = tree.nodes.new("ShaderNodeTexNoise")
    for node in list(tree.nodes):
        for socket in node.inputs:
            if socket.name in {"Color", "IOR"}:
                tree.links.new(texture.outputs[0], socket)
    owners = (scene, scene.view_layers[0], scene.camera, scene.camera.data, *bpy.data.lights)
    for owner in (*owners, ball, ball.data, ball.active_material, *tree.nodes):
        owner.name = name


@pytest.mark.parametrize("name", NAMES, ids=range(len(NAMES)))
def test_names(scene, ball, outcome, name):
    name_all(scene, ball, name)
    assert outcome() == PICTURE


@pytest.mark.parametrize("raw", [b"\xff\xfe", b"\xc3", b"\xed\xb3\xa4", b"\x80"], ids=ascii)
def test_names_that_are_no_text(scene, ball, outcome, raw):
    """Bytes that UTF-8 has not, as damaged files hold them."""
    name = b"HOSTILE_NAME"
    name_all(scene, ball, name.decode())
    said = outcome(lambda data: data.replace(name, (raw * 12)[:12]))
    assert said.endswith('" is not UTF-8, rename what has it')


# ---- Many, none, empty ---------------------------------------------------------------------------


def test_many_instances(ball, add_mesh, outcome):
    n = 316 if LONG else 32
    points = [(x / n, 0.0, y / n) for x in range(n) for y in range(n)]
    ball.parent = add_mesh("Points", points, [])
    ball.scale = (0.3 / n, 0.3 / n, 0.3 / n)
    ball.parent.instance_type = "VERTS"
    assert outcome() == PICTURE


@pytest.mark.parametrize("what", ["objects", "meshes", "lamps"])
def test_many(scene, ball, outcome, what):
    for k in range(10000 if LONG else 300):
        data = ball.data
        if what == "meshes":
            data = bpy.data.meshes.new("Mesh")
            data.from_pydata(TRIANGLE[0], [], TRIANGLE[1])
            data.materials.append(ball.active_material.copy())
        elif what == "lamps":
            data = bpy.data.lights.new("Lamp", "POINT")
        thing = bpy.data.objects.new("Thing", data)
        thing.location = (k % 32 / 8, k / 1000, 3)
        thing.scale = (0.01, 0.01, 0.01)
        scene.collection.objects.link(thing)
    assert outcome() == PICTURE


def test_chain_of_parents(scene, ball, outcome):
    parent = ball
    for _ in range(3000 if LONG else 200):
        child = bpy.data.objects.new("Empty", None)
        scene.collection.objects.link(child)
        child.parent = parent
        parent = child
    twin = bpy.data.objects.new("Twin", ball.data)
    scene.collection.objects.link(twin)
    twin.parent = parent
    assert outcome() == PICTURE


def test_collections_in_collections(scene, ball, outcome):
    inner = bpy.data.collections.new("Innermost")
    inner.objects.link(ball)
    for k in range(100 if LONG else 20):
        outer = bpy.data.collections.new("Collection")
        for side in range(2 if k < 6 else 1):
            empty = bpy.data.objects.new("Empty", None)
            empty.instance_type, empty.instance_collection = "COLLECTION", inner
            empty.location = (0.01 * side, 0, 0)
            outer.objects.link(empty)
        inner = outer
    empty = bpy.data.objects.new("Empty", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", inner
    scene.collection.objects.link(empty)
    assert outcome() == PICTURE


def test_many_slots(ball, outcome):
    for k in range(30000 if LONG else 300):
        ball.data.materials.append(None if k % 2 else ball.active_material)
    ball.data.polygons[0].material_index = 299
    ball.data.polygons[1].material_index = 30001
    assert outcome() == PICTURE


def test_nothing(outcome):
    assert outcome() == PICTURE


def test_empty_meshes(add_mesh, outcome):
    add_mesh("Empty", [], [])
    add_mesh("Points", [(0, 0, 0)] * 5, [])
    add_mesh("Degenerate", [(0, 0, 0)] * 5, [(0, 1, 2), (2, 3, 4)])
    assert outcome() == PICTURE


def test_broken_faces(ball, outcome):
    ball.data.loops[3].vertex_index = ball.data.loops[4].vertex_index
    assert outcome() == PICTURE


# ---- Values --------------------------------------------------------------------------------------

VALUES = (math.nan, math.inf, -math.inf, 3e38, 1e-42)


def set_vertex(scene, ball, value):
    ball.data.vertices[3].co.x = value


def set_vertices(scene, ball, value):
    for vertex in ball.data.vertices:
        vertex.co = (value, value, value)


def set_location(scene, ball, value):
    ball.location.y = value


def set_scale(scene, ball, value):
    ball.scale.x = value


def set_matrix(scene, ball, value):
    ball.matrix_world = Matrix(((value,) * 4,) * 4)


def set_camera(scene, ball, value):
    scene.camera.location.x = value


def set_lens(scene, ball, value):
    scene.camera.data.lens = value


def set_lamp(scene, ball, value):
    scene.objects["Sun"].rotation_euler.x = value


def set_angle(scene, ball, value):
    bpy.data.lights[0].angle = value


def set_energy(scene, ball, value):
    bpy.data.lights[0].energy = value


def set_medium(scene, ball, value):
    for node in ball.active_material.node_tree.nodes:
        if "Density" in node.inputs:
            node.inputs["Density"].default_value = value


def set_kernel(scene, ball, value):
    scene.amberlight.kernel_size = value


SETTERS = (
    set_vertex, set_vertices, set_location, set_scale, set_matrix, set_camera, set_lens, set_lamp,
    set_angle, set_energy, set_medium, set_kernel,
)  # fmt: skip


@pytest.mark.parametrize("value", VALUES, ids=str)
@pytest.mark.parametrize("setter", SETTERS, ids=lambda setter: setter.__name__)
def test_values(scene, ball, outcome, setter, value):
    """Refused by name and value where they are not numbers, or beyond what is taken."""
    setter(scene, ball, value)
    said = outcome()
    assert said == PICTURE or re.search(r"is -?(nan|inf|not finite|\d)|lies farther than", said)


SCALES = (
    (-1, -1, -1), (-1, 1, 1), (0, 0, 0), (1, 0, 1), (1e-30, 1, 1), (1e-20, 1e-20, 1e-20),
    (1e20, 1e20, 1e20), (1e8, 1e-8, 1),
)  # fmt: skip


@pytest.mark.parametrize("scale", SCALES, ids=str)
def test_scales(ball, outcome, scale):
    ball.scale = scale
    said = outcome()
    assert said == PICTURE or re.search(
        'the transform of "Icosphere" is not invertible$|of "Icosphere" lies farther than', said
    )


@pytest.mark.parametrize("size", [(65536, 65536), (65536, 4096)], ids=str)
def test_sizes_beyond_memory(scene, ball, outcome, size):
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.amberlight.memory_limit = 256
    assert re.search(r"no memory for an image of \d+ x \d+ pixels", outcome())


@pytest.mark.parametrize("size", [(65536, 4), (4, 65536)] if LONG else [(8192, 4), (4, 8192)])
def test_long_pictures(scene, outcome, size):
    scene.render.resolution_x, scene.render.resolution_y = size
    assert outcome() == PICTURE


@pytest.mark.parametrize("kind", ["missing", "one pixel", "nan", "large"])
def test_images(scene, ball, outcome, kind):
    scene.world = bpy.data.worlds.new("World")
    scene.world.use_nodes = True
    tree = scene.world.node_tree
    large = (16384, 8192) if LONG else (1024, 512)
    size = {"one pixel": (1, 1), "large": large}.get(kind, (8, 4))
    image = bpy.data.images.new("Sky", *size, float_buffer=kind == "nan")
    if kind == "missing":
        image.source, image.filepath = "FILE", "/nowhere/at all.exr"
    elif kind == "nan":
        image.pixels = [math.nan] * (8 * 4 * 4)
    if kind != "missing":
        image.pack()
    add_node(tree, "TexEnvironment", tree.nodes["Background"]).image = image
    assert outcome() == PICTURE
