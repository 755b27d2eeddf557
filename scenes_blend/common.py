# SPDX-License-Identifier: GPL-3.0-or-later
"""What the scene scripts share: shapes, media, lights, cameras. Plain bpy, Blender 3.4 to 5.2.

A scene script makes one .blend:

    ./amberlight blender -b --factory-startup --python scenes_blend/build_sphere.py -- OUT.blend

without `-- OUT.blend` it writes the .blend of the same name beside itself.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import bpy
from mathutils import Matrix, Vector

Point = tuple[float, float, float]
Color = tuple[float, float, float]
Triangle = tuple[int, int, int]
Shape = tuple[list[Point], list[tuple[int, ...]]]

# The paper's bumpy sphere (BmpS in its table 3), 1 / unit of the scene.
BUMPY_SIGMA_S: Color = (0.21007479, 0.20985741, 0.21021159)
BUMPY_SIGMA_A: Color = (0.0098988121, 0.10012399, 0.24977001)
BUMPY_G = 0.9
BUMPY_IOR = 1.5

# Settings for the paths of the paper's images: what light does that leaves an object and enters
# it again, or another, is not among them.
PAPER_PATHS = {"adjoint_normals": False, "effects": "MANUAL", "use_transmitted_light": False}


# ---- Shapes --------------------------------------------------------------------------------------


def normalized(p: Point) -> Point:
    length = math.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
    return (p[0] / length, p[1] / length, p[2] / length)


def icosphere(level: int) -> tuple[list[Point], list[Triangle]]:
    """Unit sphere: an icosahedron whose triangles are split in four `level` times, so that it has
    10 * 4^level + 2 vertices and 20 * 4^level triangles."""
    t = (1 + math.sqrt(5)) / 2
    vertices = [
        normalized(p)
        for p in [
            (-1, t, 0), (1, t, 0), (-1, -t, 0), (1, -t, 0),
            (0, -1, t), (0, 1, t), (0, -1, -t), (0, 1, -t),
            (t, 0, -1), (t, 0, 1), (-t, 0, -1), (-t, 0, 1),
        ]
    ]  # fmt: skip
    triangles: list[Triangle] = [
        (0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11),
        (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6), (7, 1, 8),
        (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9),
        (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1),
    ]  # fmt: skip
    for _ in range(level):
        midpoints: dict[tuple[int, int], int] = {}

        def midpoint(i: int, j: int, known: dict[tuple[int, int], int] = midpoints) -> int:
            edge = (min(i, j), max(i, j))
            if edge not in known:
                a, b = vertices[i], vertices[j]
                vertices.append(normalized((a[0] + b[0], a[1] + b[1], a[2] + b[2])))
                known[edge] = len(vertices) - 1
            return known[edge]

        split: list[Triangle] = []
        for a, b, c in triangles:
            ab, bc, ca = midpoint(a, b), midpoint(b, c), midpoint(c, a)
            split += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        triangles = split
    return vertices, triangles


def read_obj(path: Path) -> Shape:
    """Vertices, turned from y up to z up, and polygons of an OBJ, each polygon once. Its normals
    are left: Blender makes smooth ones of its own."""
    vertices: list[Point] = []
    polygons: list[tuple[int, ...]] = []
    for line in path.read_text().splitlines():
        kind, *words = line.split() or [""]
        if kind == "v":
            vertices.append(y_up([float(word) for word in words[:3]]))
        elif kind == "f":
            polygons.append(tuple(int(word.split("/")[0]) - 1 for word in words))
    return vertices, list({frozenset(polygon): polygon for polygon in polygons}.values())


def y_up(p: Sequence[float]) -> Point:
    """A point given with y up, as in the paper's scenes, in Blender's z up."""
    return (p[0], -p[2], p[1])


def add_object(
    name: str, shape: Shape, material: bpy.types.Material, smooth: bool = True
) -> bpy.types.Object:
    """Mesh object of counter-clockwise polygons."""
    vertices, polygons = shape
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], polygons)
    mesh.polygons.foreach_set("use_smooth", [smooth] * len(mesh.polygons))
    mesh.materials.append(material)
    mesh.update()
    if mesh.validate():
        raise ValueError(f"{name}: not a valid mesh")
    return link(bpy.data.objects.new(name, mesh))


def add_remesh(item: bpy.types.Object, voxel_size: float, smoothings: int) -> None:
    """One closed surface around everything that overlaps, without the steps of its voxels."""
    remesh = item.modifiers.new("Remesh", "REMESH")
    remesh.mode = "VOXEL"
    remesh.voxel_size = voxel_size
    remesh.use_smooth_shade = True
    smooth = item.modifiers.new("Smooth", "SMOOTH")
    smooth.factor = 0.5
    smooth.iterations = smoothings


def add_subdivision(item: bpy.types.Object, levels: int) -> None:
    """Smooths when rendering: the file keeps the coarse mesh and stays small."""
    modifier = item.modifiers.new("Subdivision", "SUBSURF")
    modifier.levels = modifier.render_levels = levels


def link(item: bpy.types.Object) -> bpy.types.Object:
    bpy.context.scene.collection.objects.link(item)
    return item


def tube(curve: Callable[[float], Point], radius: float, around: int, along: int) -> Shape:
    """Closed tube about a closed curve with parameter in [0, 1)."""
    points = [Vector(curve(i / along)) for i in range(along)]
    vertices: list[Point] = []
    for i, point in enumerate(points):
        tangent = (points[(i + 1) % along] - points[i - 1]).normalized()
        # The frame is taken from the curve's centre, so it closes by itself.
        side = tangent.cross(point).normalized()
        out = side.cross(tangent)
        for j in range(around):
            angle = 2 * math.pi * j / around
            offset = (math.cos(angle) * out + math.sin(angle) * side) * radius
            vertices.append(tuple(point + offset))
    polygons = []
    for i in range(along):
        for j in range(around):
            here, there = i * around, (i + 1) % along * around
            k = (j + 1) % around
            polygons.append((here + j, here + k, there + k, there + j))
    return vertices, polygons


def add_lathed(
    name: str,
    profile: Sequence[tuple[float, float]],
    material: bpy.types.Material,
    around: int,
) -> bpy.types.Object:
    """Closed surface of revolution about z. The profile is (radius, z) along the outside, from the
    axis below to the axis above; the file keeps it and a modifier turns it."""
    vertices = [(radius, 0.0, z) for radius, z in profile]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [(i, i + 1) for i in range(len(vertices) - 1)], [])
    mesh.materials.append(material)
    item = link(bpy.data.objects.new(name, mesh))
    screw = item.modifiers.new("Lathe", "SCREW")
    screw.steps = screw.render_steps = around
    screw.use_merge_vertices = True
    screw.merge_threshold = 1e-5
    screw.use_smooth_shade = True
    screw.use_normal_flip = True  # outwards, for a profile that goes up along the outside
    return item


def sweep() -> Shape:
    """Ground that bends up into a backdrop: a profile in y-z, drawn out along x."""
    radius, front, back, height, half_width = 2.5, -12.0, 4.5, 9.0, 14.0
    profile = [(front, 0.0), (back - radius, 0.0)]
    for i in range(1, 17):
        angle = 0.5 * math.pi * i / 16
        profile.append(
            (back - radius + radius * math.sin(angle), radius - radius * math.cos(angle))
        )
    profile.append((back, height))
    vertices = [(x, y, z) for y, z in profile for x in (-half_width, half_width)]
    faces = [(2 * i, 2 * i + 1, 2 * i + 3, 2 * i + 2) for i in range(len(profile) - 1)]
    return vertices, faces


# ---- Materials -----------------------------------------------------------------------------------


def new_material(name: str) -> tuple[bpy.types.Material, bpy.types.NodeTree, bpy.types.Node]:
    """Material with an empty node tree, the tree and its output."""
    material = bpy.data.materials.new(name)
    if not material.use_nodes:  # Blender 5 always has nodes and warns when asked for them
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    return material, tree, tree.nodes.new("ShaderNodeOutputMaterial")


def diffuse(name: str, color: Color) -> bpy.types.Material:
    material, tree, output = new_material(name)
    shader = tree.nodes.new("ShaderNodeBsdfDiffuse")
    shader.inputs["Color"].default_value = (*color, 1)
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return material


def clear_glass(name: str, ior: float) -> bpy.types.Material:
    """Smooth glass around nothing."""
    return new_glass(name, ior)[0]


def new_glass(
    name: str, ior: float
) -> tuple[bpy.types.Material, bpy.types.NodeTree, bpy.types.Node]:
    """Material whose surface is smooth glass, its tree and its output."""
    material, tree, output = new_material(name)
    glass = tree.nodes.new("ShaderNodeBsdfGlass")
    glass.inputs["Color"].default_value = (1, 1, 1, 1)
    glass.inputs["Roughness"].default_value = 0
    glass.inputs["IOR"].default_value = ior
    glass.location = (-200, 200)
    tree.links.new(glass.outputs[0], output.inputs["Surface"])
    return material, tree, output


def translucent(
    name: str, sigma_s: Color, sigma_a: Color, g: float, ior: float
) -> bpy.types.Material:
    """Smooth glass around a medium, in nodes that Cycles understands too.

    Cycles: Volume Scatter has sigma_s = density * color, Volume Absorption has
    sigma_a = density * (1 - color). With the largest coefficient as density every colour is in
    [0, 1].
    """
    material, tree, output = new_glass(name, ior)
    new, connect = tree.nodes.new, tree.links.new

    density = max(sigma_s)
    scatter = new("ShaderNodeVolumeScatter")
    scatter.inputs["Color"].default_value = (*(s / density for s in sigma_s), 1)
    scatter.inputs["Density"].default_value = density
    scatter.inputs["Anisotropy"].default_value = g

    density = max(sigma_a)
    absorption = new("ShaderNodeVolumeAbsorption")
    absorption.inputs["Color"].default_value = (*(1 - a / density for a in sigma_a), 1)
    absorption.inputs["Density"].default_value = density

    both = new("ShaderNodeAddShader")
    connect(scatter.outputs[0], both.inputs[0])
    connect(absorption.outputs[0], both.inputs[1])
    connect(both.outputs[0], output.inputs["Volume"])

    places = {scatter: (-400, 0), absorption: (-400, -200), both: (-200, -60)}
    for node, place in places.items():
        node.location = place
    return material


def paper_resin(
    name: str, albedo: Color, mean_free_path: Color, g: float, ior: float = 1.5
) -> bpy.types.Material:
    """A row of the paper's table 3: albedo, 1 / sigma_t in units of the scene, g. The paper prints
    no index of refraction; 1.5 is that of the case that SmallUPBP rendered."""
    sigma_t = [1 / length for length in mean_free_path]
    sigma_s = tuple(a * t for a, t in zip(albedo, sigma_t, strict=True))
    sigma_a = tuple((1 - a) * t for a, t in zip(albedo, sigma_t, strict=True))
    return translucent(name, sigma_s, sigma_a, g, ior)


def bunny_resin() -> bpy.types.Material:
    return paper_resin("Bunny resin", (0.165, 0.115, 0.073), (8.231, 4.751, 2.269), g=0.9)


def buddha_resin() -> bpy.types.Material:
    return paper_resin("Buddha resin", (0.24, 0.48, 0.96), (2.0, 2.0, 2.0), g=0.8)


def bumpy_resin() -> bpy.types.Material:
    return translucent("Bumpy resin", BUMPY_SIGMA_S, BUMPY_SIGMA_A, BUMPY_G, BUMPY_IOR)


# ---- Lights, camera, scene -----------------------------------------------------------------------


def aim(item: bpy.types.Object, position: Sequence[float], target: Sequence[float]) -> None:
    """Places a camera or lamp so that it looks at `target`, upright."""
    direction = Vector(target) - Vector(position)
    rotation = direction.to_track_quat("-Z", "Y").to_matrix().to_4x4()
    item.matrix_world = Matrix.Translation(position) @ rotation


def add_point_light(name: str, position: Sequence[float], intensity: float) -> bpy.types.Object:
    """Point light of radius 0; intensity in W/sr, of which Blender wants 4 pi times as watts."""
    lamp = bpy.data.lights.new(name, "POINT")
    lamp.energy = 4 * math.pi * intensity
    lamp.shadow_soft_size = 0
    item = link(bpy.data.objects.new(name, lamp))
    item.location = position
    return item


def add_spot_light(
    name: str, position: Sequence[float], target: Sequence[float], intensity: float, angle: float
) -> bpy.types.Object:
    """Spot light of radius 0 with a soft edge; W/sr on its axis, full angle in degrees."""
    lamp = bpy.data.lights.new(name, "SPOT")
    lamp.energy = 4 * math.pi * intensity
    lamp.spot_size = math.radians(angle)
    lamp.spot_blend = 0.5
    lamp.shadow_soft_size = 0
    item = link(bpy.data.objects.new(name, lamp))
    aim(item, position, target)
    return item


def add_camera(
    position: Sequence[float], target: Sequence[float], horizontal_angle: float
) -> bpy.types.Object:
    """Perspective camera; horizontal_angle in degrees, of an image that is not taller than wide."""
    camera = bpy.data.cameras.new("Camera")
    camera.sensor_fit = "HORIZONTAL"
    camera.angle = math.radians(horizontal_angle)
    item = link(bpy.data.objects.new("Camera", camera))
    aim(item, position, target)
    bpy.context.scene.camera = item
    return item


def set_world(color: Color) -> None:
    """Uniform surroundings of this radiance."""
    world = bpy.data.worlds.new("World")
    if not world.use_nodes:
        world.use_nodes = True
    tree = world.node_tree
    tree.nodes.clear()
    background = tree.nodes.new("ShaderNodeBackground")
    background.inputs["Color"].default_value = (*color, 1)
    background.inputs["Strength"].default_value = 1
    output = tree.nodes.new("ShaderNodeOutputWorld")
    tree.links.new(background.outputs[0], output.inputs["Surface"])
    world.color = color
    bpy.context.scene.world = world


def start(resolution: tuple[int, int], **settings: object) -> bpy.types.Scene:
    """An empty scene for our engine; `settings` go to scene.amberlight."""
    for blocks in (
        bpy.data.objects, bpy.data.meshes, bpy.data.materials, bpy.data.lights,
        bpy.data.cameras, bpy.data.worlds,
    ):  # fmt: skip
        bpy.data.batch_remove(list(blocks))
    scene = bpy.context.scene
    scene.render.engine = "AMBERLIGHT"
    scene.render.resolution_x, scene.render.resolution_y = resolution
    scene.render.resolution_percentage = 100
    for name, value in settings.items():
        if not hasattr(scene.amberlight, name):
            raise AttributeError(f"scene.amberlight has no setting {name}")
        setattr(scene.amberlight, name, value)
    return scene


def set_view(scene: bpy.types.Scene, transform: str, exposure: float) -> None:
    """How the PNG is made of the radiance; the EXR does not see it."""
    scene.view_settings.view_transform = transform
    scene.view_settings.exposure = exposure


def arguments() -> list[str]:
    """What stands after `--` on Blender's command line."""
    return sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []


def paths_given(usage: str) -> list[Path]:
    """As many paths as `usage` has words; ends Blender where there are not."""
    given = arguments()
    if len(given) != len(usage.split()):
        raise SystemExit(f"after --: {usage}")
    return [Path(path) for path in given]


def save(default_name: str) -> None:
    """Writes the .blend: the argument after `--`, else `default_name` beside the scripts."""
    given = arguments()
    save_as(Path(given[0]) if given else Path(__file__).parent / default_name)


def save_as(path: Path) -> None:
    bpy.context.preferences.filepaths.save_version = 0  # no .blend1 beside it
    bpy.ops.wm.save_as_mainfile(filepath=str(path.resolve()), compress=True, check_existing=False)
