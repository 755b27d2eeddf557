# SPDX-License-Identifier: GPL-3.0-or-later
"""Run inside Blender: render one .blend by Cycles and by Amberlight, for bench_cycles.py.

blender -b FILE.blend --python render_blend.py -- JOBS.json DONE.json

JOBS.json is a list of renders; of each, DONE.json has CPU seconds of the whole render (export,
building, rendering) and the pixels are in a .npy, row 0 = top, RGB and alpha.
"""

from __future__ import annotations

import json
import resource
import sys
from pathlib import Path

import bpy
import numpy as np


def cpu_seconds():
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def object_radius():
    """Half the longest diagonal among the boxes of the translucent objects, metres."""
    radii = []
    for item in bpy.context.scene.objects:
        if item.type == "MESH" and any(is_translucent(s.material) for s in item.material_slots):
            low, high = (item.matrix_world @ corner for corner in box(item))
            radii.append((high - low).length / 2 / 3**0.5)
    return max(radii)


def box(item):
    from mathutils import Vector

    evaluated = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return Vector(evaluated.bound_box[0]), Vector(evaluated.bound_box[6])


def is_translucent(material):
    return any(node.bl_idname == "ShaderNodeBsdfGlass" for node in material.node_tree.nodes)


def light_only_media(lamp):
    """A lamp with an extent is seen by Cycles through glass, a hundred times as bright as what we
    compare. It shines here only on paths that have scattered: when a path ends on a lamp its ray
    depth, which then counts the lamp too, exceeds those of its refractions and reflections by 2.
    """
    lamp.use_nodes = True
    tree = lamp.node_tree
    tree.nodes.clear()
    path = tree.nodes.new("ShaderNodeLightPath")
    depth = path.outputs["Ray Depth"]
    for name in ("Transmission Depth", "Glossy Depth"):
        difference = tree.nodes.new("ShaderNodeMath")
        difference.operation = "SUBTRACT"
        tree.links.new(depth, difference.inputs[0])
        tree.links.new(path.outputs[name], difference.inputs[1])
        depth = difference.outputs[0]
    has_scattered = tree.nodes.new("ShaderNodeMath")
    has_scattered.operation = "GREATER_THAN"
    has_scattered.inputs[1].default_value = 1.5
    emission = tree.nodes.new("ShaderNodeEmission")
    output = tree.nodes.new("ShaderNodeOutputLight")
    tree.links.new(depth, has_scattered.inputs[0])
    tree.links.new(has_scattered.outputs[0], emission.inputs["Strength"])
    tree.links.new(emission.outputs[0], output.inputs["Surface"])


def set_cycles(scene, job):
    """Single scattering and nothing else: one refraction in, one scattering, one refraction out.

    Cycles counts bounces after the one that each limit allows by itself: volume_bounces = 0 would
    end a path at the boundary after it scattered, 1 ends it after it scattered twice, inside,
    where no lamp is. The same holds for the refractions and, with 0, for internal reflections.
    """
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.samples = job["samples"]
    cycles.seed = job["seed"]
    cycles.blur_glossy = job["blur_glossy"]
    cycles.max_bounces = 8
    cycles.transmission_bounces = cycles.volume_bounces = 1
    cycles.glossy_bounces = cycles.diffuse_bounces = 0
    cycles.caustics_refractive = cycles.caustics_reflective = True
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0
    cycles.pixel_filter_type = "BOX"
    cycles.filter_width = 1.0
    for lamp in bpy.data.lights:
        if job["radius"] > 0:
            light_only_media(lamp)


def set_amberlight(scene, job):
    scene.render.engine = "AMBERLIGHT"
    settings = {
        "samples": job["samples"],
        "seed": job["seed"],
        "effects": "MANUAL",
        "use_surface_reflection": False,
        "use_background": False,
        "use_transmitted_light": False,
        "use_lamp_images": False,
        "light_bounces": 0,
        "camera_bounces": 0,
        "adjoint_normals": True,  # as a path tracer sees interpolated normals
    } | job["settings"]
    for name, value in settings.items():
        setattr(scene.amberlight, name, value)


def run(job):
    scene = bpy.context.scene
    {"CYCLES": set_cycles, "AMBERLIGHT": set_amberlight}[job["engine"]](scene, job)
    scene.render.resolution_x = scene.render.resolution_y = job["size"]
    scene.render.resolution_percentage = 100
    scene.render.film_transparent = True
    scene.render.threads_mode = "FIXED"
    scene.render.threads = job["threads"]
    scene.render.use_compositing = scene.render.use_sequencer = False
    if hasattr(scene.render.image_settings, "media_type"):
        scene.render.image_settings.media_type = "IMAGE"
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_mode = "RGBA"
    scene.render.image_settings.color_depth = "32"
    for lamp in bpy.data.lights:
        if lamp.type in {"POINT", "SPOT"}:
            lamp.shadow_soft_size = job["radius"]
    out = Path(job["out"])
    image = out.with_suffix(".exr")
    scene.render.filepath = str(image)
    start = cpu_seconds()
    bpy.ops.render.render(write_still=True)
    seconds = cpu_seconds() - start
    loaded = bpy.data.images.load(str(image))
    width, height = loaded.size
    pixels = np.empty(width * height * 4, np.float32)
    loaded.pixels.foreach_get(pixels)
    bpy.data.images.remove(loaded)
    image.unlink()
    np.save(out, pixels.reshape(height, width, 4)[::-1])
    return seconds


jobs_path, done_path = sys.argv[sys.argv.index("--") + 1 :]
done = {"object_radius": object_radius(), "version": bpy.app.version_string, "cpu_s": []}
for item in json.loads(Path(jobs_path).read_text()):
    done["cpu_s"].append(run(item))
Path(done_path).write_text(json.dumps(done))
