# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports a reference case into Blender, renders it with our engine and saves the pixels.

    blender -b --factory-startup --addons amberlight --python import_case.py -- \
        CASE_FOLDER OUT.npy SIZE [setting=value ...]

OUT.npy is (SIZE, SIZE, 4) float32, row 0 = top: radiance and alpha. The case is y up and becomes
z up. A point light of intensity I W/sr has 4 pi I watts in Blender.
"""

from __future__ import annotations

import json
import math
import os
import sys
import traceback
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

Y_UP_TO_Z_UP = Matrix.Rotation(math.radians(90), 4, "X")


def read_obj(path: Path) -> tuple[list[Any], list[Any], list[Any]]:
    """Vertices, triangles and vertex normals of an OBJ whose normals have the vertices' indices."""
    vertices, normals, triangles = [], [], []
    for line in path.read_text().splitlines():
        kind, *words = line.split() or [""]
        if kind == "v":
            vertices.append([float(w) for w in words])
        elif kind == "vn":
            normals.append([float(w) for w in words])
        elif kind == "f":
            triangles.append([int(w.split("/")[0]) - 1 for w in words])
    return vertices, triangles, normals


def add_mesh(folder: Path, case: dict[str, Any]) -> bpy.types.Object:
    """The object keeps the file's own coordinates; its transform turns it upright."""
    vertices, triangles, normals = read_obj(folder / case["geometry"]["obj"])
    mesh = bpy.data.meshes.new(case["name"])
    mesh.from_pydata(vertices, [], triangles)
    mesh.polygons.foreach_set("use_smooth", [True] * len(triangles))
    # Before 4.1 custom normals count only with auto smooth.
    if hasattr(mesh, "use_auto_smooth"):
        mesh.use_auto_smooth = True
    mesh.normals_split_custom_set_from_vertices(normals)
    item = bpy.data.objects.new(case["name"], mesh)
    item.matrix_world = Y_UP_TO_Z_UP
    bpy.context.scene.collection.objects.link(item)
    return item


def add_material(item: bpy.types.Object, case: dict[str, Any]) -> None:
    """Glass around Volume Scatter + Volume Absorption, as a user would build it."""
    medium = case["medium"]
    material = bpy.data.materials.new("medium")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    glass = tree.nodes.new("ShaderNodeBsdfGlass")
    glass.inputs["Color"].default_value = (1, 1, 1, 1)
    glass.inputs["Roughness"].default_value = 0
    boundary = case["boundary"]
    glass.inputs["IOR"].default_value = boundary["ior_inside"] / boundary["ior_outside"]
    tree.links.new(glass.outputs[0], output.inputs["Surface"])

    # sigma_s = density * colour; sigma_a = density * (1 - colour).
    scatter = tree.nodes.new("ShaderNodeVolumeScatter")
    density = max(medium["sigma_s"])
    scatter.inputs["Density"].default_value = density
    scatter.inputs["Color"].default_value = (*(s / density for s in medium["sigma_s"]), 1)
    scatter.inputs["Anisotropy"].default_value = medium["g"]
    absorb = tree.nodes.new("ShaderNodeVolumeAbsorption")
    density = max(medium["sigma_a"])
    absorb.inputs["Density"].default_value = density
    absorb.inputs["Color"].default_value = (*(1 - s / density for s in medium["sigma_a"]), 1)
    both = tree.nodes.new("ShaderNodeAddShader")
    tree.links.new(scatter.outputs[0], both.inputs[0])
    tree.links.new(absorb.outputs[0], both.inputs[1])
    tree.links.new(both.outputs[0], output.inputs["Volume"])
    item.data.materials.append(material)


def add_light(case: dict[str, Any]) -> None:
    light = case["light"]
    intensity = light["intensity_W_per_sr"]
    lamp = bpy.data.lights.new("light", "POINT")
    lamp.energy = 4 * math.pi * max(intensity)
    lamp.color = [value / max(intensity) for value in intensity]
    lamp.shadow_soft_size = 0
    item = bpy.data.objects.new("light", lamp)
    item.matrix_world = Y_UP_TO_Z_UP @ Matrix.Translation(light["position"])
    bpy.context.scene.collection.objects.link(item)


def add_camera(case: dict[str, Any]) -> None:
    data = case["camera"]
    camera = bpy.data.cameras.new("camera")
    camera.sensor_fit = "HORIZONTAL"
    camera.angle = math.radians(data["fov_deg"])
    item = bpy.data.objects.new("camera", camera)
    item.matrix_world = Y_UP_TO_Z_UP @ Matrix(data["camera_to_world_4x4_rowmajor"])
    bpy.context.scene.collection.objects.link(item)
    bpy.context.scene.camera = item


def set_render(size: int, settings: dict[str, str]) -> None:
    """Single scattering alone, first passes only, no adjoint factor; black, transparent world."""
    scene = bpy.context.scene
    render = scene.render
    render.engine = "AMBERLIGHT"
    render.resolution_x = render.resolution_y = size
    render.resolution_percentage = 100
    render.film_transparent = True
    render.use_compositing = render.use_sequencer = False
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_mode = "RGBA"
    render.image_settings.color_depth = "32"
    ours = scene.amberlight
    ours.effects = "MANUAL"
    ours.use_single_scattering = True
    ours.use_surface_reflection = ours.use_background = False
    ours.use_transmitted_light = False
    ours.light_bounces = ours.camera_bounces = 0
    ours.adjoint_normals = False
    for name, text in settings.items():
        current = getattr(ours, name)
        setattr(ours, name, type(current)(text))
    scene.world = bpy.data.worlds.new("black")
    scene.world.color = (0, 0, 0)


def main(folder: Path, out: Path, size: int, settings: dict[str, str]) -> None:
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    case = json.loads((folder / "case.json").read_text())
    add_material(add_mesh(folder, case), case)
    add_light(case)
    add_camera(case)
    set_render(size, settings)
    image = out.with_suffix(".exr")
    bpy.context.scene.render.filepath = str(image)
    bpy.ops.render.render(write_still=True)
    loaded = bpy.data.images.load(str(image))
    pixels = np.empty(size * size * 4, np.float32)
    loaded.pixels.foreach_get(pixels)
    # Blender's images begin at the bottom.
    np.save(out, pixels.reshape(size, size, 4)[::-1])


if __name__ == "__main__":
    try:
        case_folder, out_path, size_text, *pairs = sys.argv[sys.argv.index("--") + 1 :]
        chosen = dict(pair.split("=", 1) for pair in pairs)
        main(Path(case_folder), Path(out_path), int(size_text), chosen)
    except BaseException:
        traceback.print_exc()
        sys.stdout.flush()
        sys.stderr.flush()
        # A failed script does not by itself fail Blender.
        os._exit(1)
