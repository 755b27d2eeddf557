# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluated meshes -> MeshData, by the fast path of each Blender version.

The buffers' element types decide about speed: Blender copies a whole array at once only if its
own type is asked for (float32, uint32 for indices of the older layout, bool); anything else goes
through Python item by item, up to 60 times slower.
"""

from __future__ import annotations

from typing import Any

from ..binding.handles import import_numpy
from .scene_data import MeshData


def normal_domain(mesh: Any) -> str:
    """FACE (flat), POINT or CORNER: where the shading normals live."""
    domain = getattr(mesh, "normals_domain", None)
    if domain is not None:
        return str(domain)
    np = import_numpy()
    # Before 4.1 custom normals and sharp edges counted only under auto smooth.
    if mesh.use_auto_smooth and mesh.has_custom_normals:
        return "CORNER"
    smooth = _get(np, mesh.polygons, "use_smooth", bool, len(mesh.polygons))
    if not smooth.any():
        return "FACE"
    return "CORNER" if mesh.use_auto_smooth or not smooth.all() else "POINT"


def is_changed_by_reading(mesh: Any) -> bool:
    """True if read_mesh stores split normals in the mesh, as was needed before 4.1."""
    return not hasattr(mesh, "corner_normals") and normal_domain(mesh) == "CORNER"


def find_uvs(mesh: Any, uv_map: str) -> Any:
    """The UV layer of a name ("": the one to render with), or None."""
    layers = mesh.uv_layers
    if uv_map:
        return layers.get(uv_map)
    return next((layer for layer in layers if layer.active_render), None)


def read_mesh(mesh: Any, name: str, has_slots: bool, uv_map: str | None) -> MeshData | None:
    """`mesh`: bpy Mesh whose caches may be filled; `has_slots`: several materials are used;
    `uv_map`: coordinates of its textures, see find_uvs; None: it shows none. None without faces."""
    np = import_numpy()
    # Blender makes the triangles when they are first asked for; before 3.6 only on demand.
    mesh.calc_loop_triangles()
    triangle_count = len(mesh.loop_triangles)
    if not triangle_count:
        return None
    positions = _positions(np, mesh)
    domain = normal_domain(mesh)
    loops = None
    layer = find_uvs(mesh, uv_map) if uv_map is not None else None
    if domain == "CORNER" or hasattr(mesh, "corner_normals") or layer is not None:
        loops = _get(np, mesh.loop_triangles, "loops", np.uint32, 3 * triangle_count)
    triangles = _triangles(np, mesh, loops, triangle_count)
    normals = None
    if domain == "POINT":
        normals = _get(np, mesh.vertex_normals, "vector", np.float32, 3 * len(mesh.vertices))
        normals = normals.reshape(-1, 3)
    elif domain == "CORNER":
        normals = np.take(_corner_normals(np, mesh), loops, axis=0).reshape(-1, 3, 3)
    slots = _slots(np, mesh, triangle_count) if has_slots else None
    uvs = None
    if layer is not None:
        uvs = np.take(_corner_uvs(np, mesh, layer), loops, axis=0).reshape(-1, 3, 2)
    return MeshData(name, positions.reshape(-1, 3), triangles.reshape(-1, 3), normals, slots, uvs)


def _get(np: Any, collection: Any, attribute: str, dtype: Any, count: int) -> Any:
    values = np.empty(count, dtype)
    collection.foreach_get(attribute, values)
    return values


def _positions(np: Any, mesh: Any) -> Any:
    attribute = mesh.attributes.get("position")
    if attribute is not None:
        return _get(np, attribute.data, "vector", np.float32, 3 * len(mesh.vertices))
    return _get(np, mesh.vertices, "co", np.float32, 3 * len(mesh.vertices))


def _triangles(np: Any, mesh: Any, loops: Any, triangle_count: int) -> Any:
    """(3 m,) uint32 vertex indices."""
    if loops is None:
        return _get(np, mesh.loop_triangles, "vertices", np.uint32, 3 * triangle_count)
    corner_vertex = mesh.attributes.get(".corner_vert")
    if corner_vertex is not None:
        vertices = _get(np, corner_vertex.data, "value", np.int32, len(mesh.loops))
        return vertices.view(np.uint32)[loops]
    return _get(np, mesh.loops, "vertex_index", np.uint32, len(mesh.loops))[loops]


def _corner_normals(np: Any, mesh: Any) -> Any:
    """(corner_count, 3) float32."""
    count = 3 * len(mesh.loops)
    if hasattr(mesh, "corner_normals"):
        return _get(np, mesh.corner_normals, "vector", np.float32, count).reshape(-1, 3)
    mesh.calc_normals_split()
    return _get(np, mesh.loops, "normal", np.float32, count).reshape(-1, 3)


def _corner_uvs(np: Any, mesh: Any, layer: Any) -> Any:
    """(corner_count, 2) float32."""
    vectors = getattr(layer, "uv", None)  # since 3.5
    data, name = (layer.data, "uv") if vectors is None else (vectors, "vector")
    return _get(np, data, name, np.float32, 2 * len(mesh.loops)).reshape(-1, 2)


def _slots(np: Any, mesh: Any, triangle_count: int) -> Any:
    """(m,) uint32 material slot of each triangle; None if all are 0."""
    if "position" in mesh.attributes:
        attribute = mesh.attributes.get("material_index")
        if attribute is None:
            return None
        faces = _get(np, attribute.data, "value", np.int32, len(mesh.polygons)).view(np.uint32)
    else:
        faces = _get(np, mesh.polygons, "material_index", np.uint32, len(mesh.polygons))
    if not faces.any():
        return None
    polygons = getattr(mesh, "loop_triangle_polygons", None)
    if polygons is not None:
        index = _get(np, polygons, "value", np.int32, triangle_count)
    else:
        index = _get(np, mesh.loop_triangles, "polygon_index", np.uint32, triangle_count)
    return faces[index]
