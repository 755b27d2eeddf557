# SPDX-License-Identifier: GPL-3.0-or-later
"""Run inside Blender: describe .blend files as JSON, for test_scenes.py.

blender -b --python describe_scenes.py -- OUT.json FILE.blend ...
"""

import json
import sys
from pathlib import Path

import bmesh
import bpy


def rounded(values):
    return [round(float(v), 5) for v in values]


def describe_modifier(modifier):
    names = ("render_levels", "voxel_size", "factor", "iterations", "render_steps")
    values = {name: getattr(modifier, name, None) for name in names}
    return [modifier.type, {k: round(float(v), 5) for k, v in values.items() if v is not None}]


def describe_solid(item):
    """Edges that are not shared by two polygons, and the volume inside, with modifiers applied."""
    solid = bmesh.new()
    solid.from_mesh(item.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh())
    open_edges = sum(1 for edge in solid.edges if len(edge.link_faces) != 2)
    return {"open_edges": open_edges, "volume": round(solid.calc_volume(signed=True), 4)}


def describe_object(item):
    about = {"type": item.type, "matrix": [rounded(row) for row in item.matrix_world]}
    if item.type == "MESH":
        mesh = item.data
        about["vertices"] = len(mesh.vertices)
        about["polygons"] = len(mesh.polygons)
        about["box"] = [rounded(corner) for corner in (item.bound_box[0], item.bound_box[6])]
        about["smooth"] = all(polygon.use_smooth for polygon in mesh.polygons)
        about["materials"] = [material.name for material in mesh.materials]
        about["modifiers"] = [describe_modifier(m) for m in item.modifiers]
        about |= describe_solid(item)
    elif item.type == "LIGHT":
        lamp = item.data
        about["light"] = [lamp.type, round(lamp.energy, 3), round(lamp.shadow_soft_size, 5)]
        about["color"] = rounded(lamp.color)
    elif item.type == "CAMERA":
        about["camera"] = [item.data.type, item.data.sensor_fit, *rounded([item.data.angle])]
    return about


def describe_nodes(tree):
    """Values of the inputs that nothing is linked to, by node type and name."""
    values = {}
    for node in tree.nodes:
        for socket in node.inputs:
            if socket.is_linked or not hasattr(socket, "default_value"):
                continue
            value = socket.default_value
            is_array = hasattr(value, "__len__") and not isinstance(value, str)
            values[f"{node.bl_idname}/{socket.identifier}"] = (
                rounded(value) if is_array else value if isinstance(value, str) else float(value)
            )
    return values


def describe_settings(scene):
    """Settings of the engine that differ from their defaults."""
    group = scene.amberlight
    return {
        p.identifier: getattr(group, p.identifier)
        for p in group.bl_rna.properties
        if not p.is_readonly and p.type in {"BOOLEAN", "INT", "FLOAT", "STRING", "ENUM"}
        if getattr(group, p.identifier) != p.default
    }


def describe(path):
    bpy.ops.wm.open_mainfile(filepath=path)
    scene = bpy.context.scene
    return {
        "engine": scene.render.engine,
        "resolution": [scene.render.resolution_x, scene.render.resolution_y],
        "view": [scene.view_settings.view_transform, round(scene.view_settings.exposure, 4)],
        "settings": describe_settings(scene),
        "objects": {item.name: describe_object(item) for item in scene.objects},
        "materials": {m.name: describe_nodes(m.node_tree) for m in bpy.data.materials},
        "priorities": {m.name: m.amberlight.priority for m in bpy.data.materials},
        "world": describe_nodes(scene.world.node_tree),
        "external": sorted(bpy.utils.blend_paths()),
    }


out, *blends = sys.argv[sys.argv.index("--") + 1 :]
Path(out).write_text(json.dumps({path: describe(path) for path in blends}, indent=1))
