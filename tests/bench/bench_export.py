# SPDX-License-Identifier: GPL-3.0-or-later
"""CPU seconds to export a mesh of a million triangles, printed; run inside Blender:

./amberlight blender -b --factory-startup --python tests/bench/bench_export.py
"""

import time

import bpy
from amberlight.export.export_log import ExportLog
from amberlight.export.extract import extract_scene

REPEATS = 5
SIDE = 708  # quads of a grid: 2 * 708^2 = 1 002 528 triangles


def make_grid():
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=SIDE, y_subdivisions=SIDE)
    return bpy.context.object


def shade(mesh, smooth):
    count = len(mesh.polygons)
    mesh.polygons.foreach_set("use_smooth", [smooth] * count)
    mesh.update()


def smooth(thing):
    shade(thing.data, True)


def flat(thing):
    shade(thing.data, False)


def modified(thing):
    shade(thing.data, True)
    thing.modifiers.new("Wave", "WAVE")


def two_materials(thing):
    shade(thing.data, True)
    for name in ("A", "B"):
        thing.data.materials.append(bpy.data.materials.new(name))
    indices = [i % 2 for i in range(len(thing.data.polygons))]
    thing.data.polygons.foreach_set("material_index", indices)


def sharp_edges(thing):
    shade(thing.data, True)
    if hasattr(thing.data, "use_auto_smooth"):
        thing.data.use_auto_smooth = True
    else:
        thing.data.edges[0].use_edge_sharp = True


def measure(prepare):
    """(CPU seconds of the first export, least of the repeats, triangles)."""
    prepare(make_grid())
    times = []
    for _ in range(REPEATS):
        # A change makes Blender evaluate anew, so that nothing is cached from the last time.
        bpy.context.object.data.update_tag()
        depsgraph = bpy.context.evaluated_depsgraph_get()
        start = time.process_time()
        data = extract_scene(depsgraph, ExportLog(), with_camera=False)
        times.append(time.process_time() - start)
    return times[0], min(times), len(data.meshes[0].triangles)


def main():
    print(f"Blender {bpy.app.version_string}: CPU seconds to export one mesh")
    print(f"{'mesh':15} {'triangles':>10} {'first':>7} {'least':>7}")
    for prepare in (flat, smooth, modified, two_materials, sharp_edges):
        first, least, triangles = measure(prepare)
        name = prepare.__name__.replace("_", " ")
        print(f"{name:15} {triangles:10} {first:7.3f} {least:7.3f}", flush=True)


main()
