# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the world: bake its nodes, and forget what was baked."""

from __future__ import annotations

from typing import Any

import bpy

from .binding.errors import AmberlightError
from .world_bake import bake, clear


def shown_world(context: Any) -> Any:
    """The world of the editor, which may be pinned, or of the scene where there is no editor."""
    return getattr(context, "world", None) or context.scene.world


class AMBERLIGHT_OT_bake_world(bpy.types.Operator):
    bl_idname = "amberlight.bake_world"
    bl_label = "Bake World"
    bl_description = (
        "Let Cycles evaluate the nodes of the world at this frame, in all directions, into an "
        "image that is rendered in their place and saved with the file"
    )
    bl_options = {"UNDO"}

    @classmethod
    def poll(cls, context: Any) -> bool:
        return shown_world(context) is not None

    def execute(self, context: Any) -> set[str]:
        try:
            if bpy.app.is_job_running("RENDER"):
                raise AmberlightError("a render is running: bake the world when it has ended")
            bake(context.scene, shown_world(context))
        except AmberlightError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class AMBERLIGHT_OT_clear_baked_world(bpy.types.Operator):
    bl_idname = "amberlight.clear_baked_world"
    bl_label = "Clear"
    bl_description = "Forget the image that was baked of the world"
    bl_options = {"UNDO"}

    @classmethod
    def poll(cls, context: Any) -> bool:
        world = shown_world(context)
        return world is not None and world.amberlight.image is not None

    def execute(self, context: Any) -> set[str]:
        clear(shown_world(context))
        return {"FINISHED"}


CLASSES = (AMBERLIGHT_OT_bake_world, AMBERLIGHT_OT_clear_baked_world)


def register() -> None:
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
