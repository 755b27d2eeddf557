# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluated depsgraph -> SceneData. Runs on the main thread, inside a render or viewport callback;
everything is copied, so the result outlives it."""

from __future__ import annotations

from typing import Any

import bpy

from . import conventions as conv
from .export_log import ExportLog
from .extract_camera import matrix_rows, read_camera
from .extract_light import read_light
from .extract_material import Textures, read_material
from .extract_mesh import is_changed_by_reading, read_mesh
from .extract_world import read_world
from .scene_data import ObjectData, SceneData

CONVERTIBLE = {"CURVE", "SURFACE", "FONT", "META"}
# What an object may be hidden from in Cycles, and a light.
VISIBILITY_OF_LIGHT = (
    "visible_diffuse",
    "visible_glossy",
    "visible_transmission",
    "visible_volume_scatter",
)
VISIBILITY = ("visible_camera", "visible_shadow", *VISIBILITY_OF_LIGHT)
UNSUPPORTED = {"VOLUME", "POINTCLOUD", "CURVES", "GPENCIL", "GREASEPENCIL"}


def extract_scene(
    depsgraph: Any, log: ExportLog, *, with_camera: bool = True, camera: Any = None
) -> SceneData:
    """All that is rendered of the depsgraph's view layer, seen from `camera` or the scene's own."""
    exporter = _Exporter(depsgraph, log)
    scene = depsgraph.scene_eval
    if with_camera:
        camera = camera or scene.camera
        exporter.data.camera = read_camera(
            camera.evaluated_get(depsgraph) if camera else None, scene.render, log
        )
    exporter.objects()
    data = exporter.data
    data.world, data.world_image = read_world(
        scene.world, exporter.version, log, scene.frame_current
    )
    return exporter.data


class _Exporter:
    def __init__(self, depsgraph: Any, log: ExportLog) -> None:
        self.depsgraph = depsgraph
        self.log = log
        self.version: conv.Version = tuple(bpy.app.version)
        self.data = SceneData()
        # Pointers are only compared while the depsgraph is evaluated, which keeps them alive.
        self.mesh_ids: dict[tuple[int, bool, str | None], int | None] = {}
        self.material_ids: dict[int, int] = {}
        self.textures: Textures = {}
        self.shapes: dict[tuple[int, int], tuple[int, tuple[int, ...]] | None] = {}
        self.material_override = depsgraph.view_layer_eval.material_override

    def objects(self) -> None:
        # Blender hands over the mesh of a curve, text or surface as an instance of its own, and
        # that of a metaball or not, depending on version: convert only those without one.
        convertible: list[tuple[Any, Any]] = []
        shown: set[int] = set()
        for instance in self.depsgraph.object_instances:
            placed = instance.object
            visible = instance.show_self or instance.is_instance
            if not visible and placed.type != "LIGHT":
                continue
            # The iterator reuses its instance: nothing of it may be kept.
            matrix = instance.matrix_world.copy()
            if placed.type == "LIGHT":
                where = f'light "{placed.name}"'
                self.check_lamp(placed, where)
                light = read_light(placed.data, matrix, where, self.version, self.log)
                if light:
                    self.data.lights.append(light)
            elif placed.type == "MESH":
                self.mesh_object(placed, matrix)
                shown.add(placed.original.as_pointer())
            elif placed.type in CONVERTIBLE:
                convertible.append((placed, matrix))
            elif placed.type in UNSUPPORTED:
                kind = placed.type.lower().replace("_", " ")
                self.log.warn(f'object "{placed.name}"', f"objects of type {kind} are left out")
        for placed, matrix in convertible:
            if placed.original.as_pointer() not in shown:
                self.mesh_object(placed, matrix)

    def mesh_object(self, placed: Any, matrix: Any) -> None:
        where = f'object "{placed.name}"'
        if not abs(matrix.to_3x3().determinant()) > 0.0:
            self.log.warn(where, "an object scaled to zero is left out")
            return
        # Instances are many, their shapes few; geometry nodes give one object several.
        key = (placed.original.as_pointer(), placed.data.as_pointer() if placed.data else 0)
        if key not in self.shapes:
            self.shapes[key] = self.shape(placed, where)
        shape = self.shapes[key]
        if shape:
            self.data.objects.append(
                ObjectData(placed.name, shape[0], matrix_rows(matrix), shape[1])
            )

    def shape(self, placed: Any, where: str) -> tuple[int, tuple[int, ...]] | None:
        """Mesh and materials of an object; None if there is nothing to see."""
        self.check_object(placed, where)
        slots = self.slots(placed)
        materials = tuple(self.material(slot, where) for slot in slots)
        mesh = self.mesh(placed, len(slots) > 1, self.uv_map(materials, where))
        return None if mesh is None else (mesh, materials)

    def uv_map(self, materials: tuple[int, ...], where: str) -> str | None:
        """Name of the coordinates by which an object's textures are placed; None: it has none."""
        textures = [self.data.materials[index].texture for index in materials]
        names = sorted({texture.uv_map for texture in textures if texture})
        if len(names) > 1:
            self.log.warn(where, f'all its textures are placed by the UV map "{names[-1]}"')
        return names[-1] if names else None

    def check_linking(self, placed: Any, where: str) -> None:
        """Light linking exists since 4.0."""
        linking = getattr(placed, "light_linking", None)
        if linking and (linking.receiver_collection or linking.blocker_collection):
            self.log.warn(where, "light linking is ignored")

    def check_lamp(self, placed: Any, where: str) -> None:
        self.check_linking(placed, where)
        if not all(getattr(placed, name) for name in VISIBILITY_OF_LIGHT):
            self.log.warn(where, "the ray visibility of lights is ignored")
        if not getattr(getattr(placed.data, "cycles", None), "cast_shadow", True):
            self.log.warn(where, "a light without shadows casts them")

    def check_object(self, placed: Any, where: str) -> None:
        self.check_linking(placed, where)
        for system in placed.particle_systems:
            if system.settings.type == "HAIR" and system.settings.render_type == "PATH":
                self.log.warn(where, f'the hair of "{system.name}" is left out')
        # An object's own setting, or that of its collections in the view layer.
        layer, own = self.depsgraph.view_layer, placed.original
        if own.holdout_get(view_layer=layer) or placed.is_shadow_catcher:
            self.log.warn(where, "holdout and shadow catcher are ignored")
        is_seen = all(getattr(placed, name) for name in VISIBILITY)
        if not is_seen or own.indirect_only_get(view_layer=layer):
            self.log.warn(where, "the ray visibility of objects is ignored")

    def slots(self, placed: Any) -> list[Any]:
        """The material of each slot; geometry nodes may give a mesh materials of its own, for
        which the object has no slot."""
        if self.material_override:
            return [self.material_override]
        slots = [slot.material for slot in placed.material_slots]
        own = list(getattr(placed.data, "materials", ()))
        slots += own[len(slots) :]
        return slots or [None]

    def mesh(self, placed: Any, has_slots: bool, uv_map: str | None) -> int | None:
        """Index of the object's mesh, shared by all that show the same data; None if empty."""
        # What is converted depends on the object (modifiers, families of metaballs).
        source = placed.data if placed.type == "MESH" else placed.original
        key = (source.as_pointer(), has_slots, uv_map)
        if key not in self.mesh_ids:
            self.mesh_ids[key] = self.read_mesh(placed, has_slots, uv_map)
        return self.mesh_ids[key]

    def read_mesh(self, placed: Any, has_slots: bool, uv_map: str | None) -> int | None:
        name = placed.data.name if placed.data else placed.name
        # A mesh is read in place; a copy is made only where reading would change it, where the
        # object is being edited, or where there is no mesh yet.
        mesh = placed.data
        copy = placed.type != "MESH" or placed.mode == "EDIT" or is_changed_by_reading(mesh)
        if copy:
            mesh = placed.to_mesh()
        try:
            data = read_mesh(mesh, name, has_slots, uv_map) if mesh else None
            if data and uv_map is not None and data.uvs is None:
                what = f'the UV map "{uv_map}"' if uv_map else "a UV map"
                self.log.warn(
                    f'object "{placed.name}"', f"lacks {what}, its textures are one colour"
                )
        finally:
            if copy:
                placed.to_mesh_clear()
        if data is None:
            return None
        self.data.meshes.append(data)
        return len(self.data.meshes) - 1

    def material(self, material: Any, where: str) -> int:
        key = material.original.as_pointer() if material else 0
        if key not in self.material_ids:
            self.material_ids[key] = len(self.data.materials)
            self.data.materials.append(
                read_material(material, where, self.version, self.log, self.textures)
            )
        return self.material_ids[key]
