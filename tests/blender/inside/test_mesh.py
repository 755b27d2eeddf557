# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes and instances: exact values for shapes that can be checked by hand."""

import math

import bpy
import numpy as np
import pytest
from mathutils import Matrix

QUAD = [(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0)]
ROOF = [(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 2, 2), (2, 2, 2)]


def triangles_of(mesh):
    """Corner positions, sorted: the same whatever the split of a quad."""
    return sorted(map(tuple, mesh.positions[mesh.triangles].reshape(-1, 9).tolist()))


def test_flat_triangle(add_mesh, export):
    add_mesh("Tri", [(0, 0, 1), (1, 0, 1), (0, 1, 1)], [(0, 1, 2)])
    data, lines = export()
    (mesh,), (placed,) = data.meshes, data.objects
    assert lines == []
    assert mesh.positions.dtype == np.float32 and mesh.triangles.dtype == np.uint32
    assert mesh.positions.tolist() == [[0, 0, 1], [1, 0, 1], [0, 1, 1]]
    assert mesh.triangles.tolist() == [[0, 1, 2]]
    assert mesh.normals is None and mesh.slots is None
    assert (placed.name, placed.mesh, placed.materials) == ("Tri", 0, (0,))
    assert np.array_equal(placed.to_world, np.eye(4))
    assert data.materials[0].albedo == pytest.approx((0.8, 0.8, 0.8))


def test_smooth_normals_live_on_vertices(add_mesh, export):
    add_mesh("Roof", ROOF, [(0, 1, 2, 3), (3, 2, 5, 4)], smooth=True)
    mesh = export()[0].meshes[0]
    assert mesh.normals.shape == (6, 3)
    assert mesh.normals[0] == pytest.approx((0, 0, 1), abs=1e-6)
    h = 0.5**0.5
    assert mesh.normals[2] == pytest.approx((0, -h, h), abs=1e-6)
    # Wound so that the geometric normal agrees.
    a, b, c = mesh.positions[mesh.triangles[0]]
    assert np.cross(b - a, c - a) @ mesh.normals[0] > 0


def test_mixed_faces_have_corner_normals(add_mesh, export):
    roof = add_mesh("Roof", ROOF, [(0, 1, 2, 3), (3, 2, 5, 4)], smooth=True)
    roof.data.polygons[1].use_smooth = False
    mesh = export()[0].meshes[0]
    assert mesh.normals.shape == (4, 3, 3)
    flat = {tuple(np.round(n, 5)) for n in mesh.normals[2:].reshape(-1, 3)}
    assert flat == {(0.0, -1.0, 0.0)}
    assert mesh.normals[0][0] == pytest.approx((0, 0, 1), abs=1e-6)


def keep_sharp_edges(mesh):
    """Before 4.1 sharp edges count only with auto smooth."""
    if hasattr(mesh, "use_auto_smooth"):
        mesh.use_auto_smooth, mesh.auto_smooth_angle = True, math.pi


def test_sharp_edge(add_mesh, export):
    """Level, slope, level: sharp where the slope begins, smooth where it ends."""
    points = [(x, y, z) for x, z in ((0, 0), (1, 0), (2, 1), (3, 1)) for y in (0, 1)]
    faces = [(i, i + 2, i + 3, i + 1) for i in (0, 2, 4)]
    data = add_mesh("Step", points, faces, smooth=True).data
    keep_sharp_edges(data)
    for edge in data.edges:
        edge.use_edge_sharp = set(edge.vertices) == {2, 3}
    mesh = export()[0].meshes[0]
    slope = np.array((-1, 0, 1)) / math.sqrt(2)
    end = (slope + (0, 0, 1)) / np.linalg.norm(slope + (0, 0, 1))
    for triangle, normals in zip(mesh.triangles, mesh.normals, strict=True):
        is_slope = set(triangle) <= {2, 3, 4, 5}
        for vertex, normal in zip(triangle, normals, strict=True):
            want = end if vertex in {4, 5} else slope if is_slope else (0, 0, 1)
            assert normal == pytest.approx(want, abs=1e-3)
    # Reading did not change the scene: the same again.
    again = export()[0].meshes[0]
    assert np.array_equal(again.normals, mesh.normals)


def test_all_edges_sharp(add_mesh, export):
    """A cube that is smooth but for its edges: the normals of its faces, or none at all."""
    bpy.ops.mesh.primitive_cube_add()
    bpy.ops.object.shade_smooth()
    cube = bpy.context.object
    keep_sharp_edges(cube.data)
    for edge in cube.data.edges:
        edge.use_edge_sharp = True
    mesh = export()[0].meshes[0]
    # Blender 4.1 and later notice that such a mesh is flat.
    assert (mesh.normals is None) == (bpy.app.version >= (4, 1))
    if mesh.normals is not None:
        corners = mesh.positions[mesh.triangles]
        faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        faces /= np.linalg.norm(faces, axis=1, keepdims=True)
        assert np.abs(mesh.normals - faces[:, None]).max() < 1e-3


def test_modifiers_are_applied(add_mesh, export):
    quad = add_mesh("Quad", QUAD, [(0, 1, 2, 3)])
    array = quad.modifiers.new("Array", "ARRAY")
    array.count = 3
    assert len(export()[0].meshes[0].triangles) == 6


def test_slots(add_mesh, export):
    roof = add_mesh("Roof", ROOF, [(0, 1, 2, 3), (3, 2, 5, 4)])
    names = ["A", "B"]
    for name in names:
        roof.data.materials.append(bpy.data.materials.new(name))
    roof.data.polygons[1].material_index = 1
    data, _ = export()
    assert data.meshes[0].slots.tolist() == [0, 0, 1, 1]
    assert [data.materials[i].name for i in data.objects[0].materials] == names


def test_materials_of_objects_share_a_mesh(add_mesh, export, scene):
    quad = add_mesh("Quad", QUAD, [(0, 1, 2, 3)])
    quad.data.materials.append(bpy.data.materials.new("Data"))
    twin = quad.copy()
    scene.collection.objects.link(twin)
    twin.material_slots[0].link = "OBJECT"
    twin.material_slots[0].material = bpy.data.materials.new("Object")
    data, _ = export()
    assert len(data.meshes) == 1 and [o.mesh for o in data.objects] == [0, 0]
    assert [data.materials[o.materials[0]].name for o in data.objects] == ["Data", "Object"]


def test_material_override(add_mesh, export):
    roof = add_mesh("Roof", ROOF, [(0, 1, 2, 3), (3, 2, 5, 4)])
    roof.data.materials.append(bpy.data.materials.new("Own"))
    bpy.context.view_layer.material_override = bpy.data.materials.new("Clay")
    data, lines = export()
    assert lines == [] and [m.name for m in data.materials] == ["Clay"]


def test_collection_instances(add_mesh, export, scene):
    quad = add_mesh("Quad", QUAD, [(0, 1, 2, 3)])
    quad.location = (0, 0, 1)
    scene.collection.objects.unlink(quad)
    group = bpy.data.collections.new("Group")
    group.objects.link(quad)
    for x in (1, 2):
        empty = bpy.data.objects.new("Empty", None)
        empty.instance_type, empty.instance_collection = "COLLECTION", group
        empty.location = (x, 0, 0)
        scene.collection.objects.link(empty)
    data, _ = export()
    assert len(data.meshes) == 1
    places = sorted(tuple(row[3] for row in o.to_world[:3]) for o in data.objects)
    assert places == [(1, 0, 1), (2, 0, 1)]


def test_vertex_instances_hide_their_instancer(add_mesh, export):
    points = add_mesh("Points", QUAD, [(0, 1, 2, 3)])
    child = add_mesh("Child", QUAD, [(0, 1, 2, 3)])
    child.parent = points
    points.instance_type = "VERTS"
    points.show_instancer_for_render = points.show_instancer_for_viewport = False
    data, _ = export()
    # Which also shows the original child is Blender's decision.
    assert {o.name for o in data.objects} == {"Child"}
    assert {o.mesh for o in data.objects} == {0}
    assert len({o.to_world for o in data.objects}) == 4


def test_mirror_keeps_its_matrix(add_mesh, export):
    add_mesh("Quad", QUAD, [(0, 1, 2, 3)]).matrix_world = Matrix.Diagonal((-1, 1, 1, 1))
    assert export()[0].objects[0].to_world[0][0] == -1


def test_zero_scale_is_left_out_and_named(add_mesh, export):
    add_mesh("Quad", QUAD, [(0, 1, 2, 3)]).scale = (1, 0, 1)
    data, lines = export()
    assert data.objects == []
    assert lines == ['an object scaled to zero is left out: object "Quad"']


def test_extreme_scales_are_kept(add_mesh, export):
    for size in (1e-4, 1e4):
        add_mesh("Quad", QUAD, [(0, 1, 2, 3)]).scale = (size, size, size)
    assert len(export()[0].objects) == 2


def test_empty_meshes(add_mesh, export):
    add_mesh("Empty", [], [])
    add_mesh("Points", QUAD, [])
    data, lines = export()
    assert data.objects == [] and lines == []


def test_hidden_from_render(add_mesh, camera, fake_library, scene, monkeypatch):
    """A final render sees what the render's own visibility says."""
    from amberlight import engine

    add_mesh("Seen", QUAD, [(0, 1, 2, 3)]).hide_viewport = True
    add_mesh("Hidden", QUAD, [(0, 1, 2, 3)]).hide_render = True
    names = []
    real = engine.extract_scene

    def spy(*args, **kwargs):
        data = real(*args, **kwargs)
        names.extend(o.name for o in data.objects)
        return data

    monkeypatch.setattr(engine, "extract_scene", spy)
    bpy.ops.render.render()
    assert names == ["Seen"]


@pytest.mark.parametrize("kind", ["curve", "text", "surface", "metaball"])
def test_converted_objects(kind, export):
    if kind == "curve":
        bpy.ops.curve.primitive_bezier_circle_add()
        bpy.context.object.data.bevel_depth = 0.1
    elif kind == "text":
        bpy.ops.object.text_add()
    elif kind == "surface":
        bpy.ops.surface.primitive_nurbs_surface_sphere_add()
    else:
        bpy.ops.object.metaball_add()
    material = bpy.data.materials.new("Jelly")
    bpy.context.object.data.materials.append(material)
    data, lines = export()
    assert lines == []
    (placed,) = data.objects
    assert len(data.meshes[placed.mesh].triangles) > 10
    assert data.materials[placed.materials[0]].name == "Jelly"


def test_unsupported_objects_are_named(export):
    bpy.ops.object.volume_add()
    data, lines = export()
    assert data.objects == []
    assert lines == ['objects of type volume are left out: object "Volume"']


def test_hair_is_named(add_mesh, export):
    quad = add_mesh("Quad", QUAD, [(0, 1, 2, 3)])
    quad.modifiers.new("Fur", "PARTICLE_SYSTEM").particle_system.settings.type = "HAIR"
    assert any('object "Quad"' in line and "hair" in line for line in export()[1])


def test_nothing_of_blender_is_kept(add_mesh, export):
    """The result outlives the scene."""
    add_mesh("Quad", QUAD, [(0, 1, 2, 3)])
    data, _ = export()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert triangles_of(data.meshes[0]) and data.objects[0].name == "Quad"


@pytest.mark.parametrize(
    "rays", ["camera", "shadow", "diffuse", "glossy", "transmission", "volume_scatter"]
)
def test_hidden_objects_are_named(add_mesh, export, rays):
    thing = add_mesh("Thing", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    setattr(thing, f"visible_{rays}", False)
    assert export()[1] == ['the ray visibility of objects is ignored: object "Thing"']


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("holdout", "holdout and shadow catcher are ignored"),
        ("indirect_only", "the ray visibility of objects is ignored"),
    ],
)
def test_what_a_collection_hides_is_named(add_mesh, export, scene, option, message):
    thing = add_mesh("Thing", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    inner = bpy.data.collections.new("Inner")
    scene.collection.children.link(inner)
    inner.objects.link(thing)
    scene.collection.objects.unlink(thing)
    layer = bpy.context.view_layer.layer_collection.children["Inner"]
    setattr(layer, option, True)
    assert export()[1] == [f'{message}: object "Thing"']
