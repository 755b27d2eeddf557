# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators: a translucent material to start from, and the plan of a render."""

from typing import Any

import bpy
from bpy.props import EnumProperty

from . import report as reports
from .binding import library
from .binding.errors import AmberlightError
from .binding.handles import Scene, import_numpy
from .engine import export_for_render, say
from .export.conventions import scaled
from .export.scene_data import RGB
from .export.upload import upload
from .render_job import render_params

# name: (label, ior, sigma_s, sigma_a in 1/m, g): starting points to look at, not measurements.
PRESETS: dict[str, tuple[str, float, RGB, RGB, float]] = {
    "RESIN": ("Clear resin", 1.5, (0.25, 0.25, 0.25), (0.01, 0.1, 0.25), 0.9),
    "AMBER": ("Amber", 1.54, (0.3, 0.25, 0.2), (0.05, 0.5, 2.0), 0.7),
    "JADE": ("Jade", 1.66, (2.0, 2.5, 2.0), (0.6, 0.1, 0.5), 0.5),
    "WAX": ("Wax", 1.44, (3.0, 2.9, 2.6), (0.02, 0.05, 0.15), 0.6),
    "OIL": ("Oil", 1.47, (0.05, 0.05, 0.04), (0.01, 0.03, 0.6), 0.9),
}


def add_medium_nodes(tree: Any, sigma_s: RGB, sigma_a: RGB, g: float) -> Any:
    """Nodes of a medium that every engine reads alike; returns the Add Shader that joins them.

    Scatter: colour sigma_s / m, density m = the largest component, and no absorption by itself.
    Absorption: colour 1 - sigma_a / k, density k = the largest component.
    """
    scatter = tree.nodes.new("ShaderNodeVolumeScatter")
    density = max(*sigma_s, 1e-9)
    scatter.inputs["Color"].default_value = (*scaled(sigma_s, 1.0 / density), 1.0)
    scatter.inputs["Density"].default_value = density
    scatter.inputs["Anisotropy"].default_value = g
    absorption = tree.nodes.new("ShaderNodeVolumeAbsorption")
    density = max(*sigma_a, 1e-9)
    color = [1.0 - c / density for c in sigma_a]
    absorption.inputs["Color"].default_value = (*color, 1.0)
    absorption.inputs["Density"].default_value = density
    both = tree.nodes.new("ShaderNodeAddShader")
    tree.links.new(scatter.outputs[0], both.inputs[0])
    tree.links.new(absorption.outputs[0], both.inputs[1])
    scatter.location, absorption.location, both.location = (-220, -150), (-220, -330), (0, -200)
    return both


def new_translucent_material(preset: str) -> bpy.types.Material:
    label, ior, sigma_s, sigma_a, g = PRESETS[preset]
    material = bpy.data.materials.new(label)
    if bpy.app.version < (5, 0):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    glass = tree.nodes.new("ShaderNodeBsdfGlass")
    glass.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    glass.inputs["Roughness"].default_value = 0.0
    glass.inputs["IOR"].default_value = ior
    medium = add_medium_nodes(tree, sigma_s, sigma_a, g)
    tree.links.new(glass.outputs[0], output.inputs["Surface"])
    tree.links.new(medium.outputs[0], output.inputs["Volume"])
    glass.location, output.location = (0, 100), (220, 0)
    return material


def active_object(context: Any) -> Any:
    """The object of the editor, or the active one where there is no editor, as in a timer."""
    return getattr(context, "object", None) or context.view_layer.objects.active


class AMBERLIGHT_OT_new_translucent_material(bpy.types.Operator):
    bl_idname = "amberlight.new_translucent_material"
    bl_label = "New Translucent Material"
    bl_description = "Give the active object a glass boundary around a scattering medium"
    bl_options = {"REGISTER", "UNDO"}

    preset: EnumProperty(
        name="Medium",
        description="The medium to start from",
        items=[(key, value[0], f"IOR {value[1]:g}") for key, value in PRESETS.items()],
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        active = active_object(context)
        return active is not None and hasattr(active.data, "materials")

    def execute(self, context: Any) -> set[str]:
        active = active_object(context)
        material = new_translucent_material(self.preset)
        if active.material_slots:
            active.material_slots[active.active_material_index].material = material
        else:
            active.data.materials.append(material)
        return {"FINISHED"}


EXPLANATION = "Amberlight Effects"
POPUP_LINES = 30


def explain(scene: Any, layer: str) -> list[str]:
    """What a render of the scene would simulate, and why, as lines."""
    import_numpy()
    exported = export_for_render(scene, layer)
    with Scene(library.load()) as built:
        upload(exported.data, built)
        built.commit()
        plan = built.explain(**render_params(exported.settings, exported.frame))
    return exported.messages.lines() + reports.plan_lines(plan)


class AMBERLIGHT_OT_explain_effects(bpy.types.Operator):
    bl_idname = "amberlight.explain_effects"
    bl_label = "Explain Effects"
    bl_description = (
        "Say which effects a render would simulate, their predicted share of the picture, and why, "
        "without rendering; the whole text is left in a text block"
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        return context.engine == "AMBERLIGHT" if hasattr(context, "engine") else True

    def execute(self, context: Any) -> set[str]:
        try:
            lines = explain(context.scene, context.view_layer.name)
        except (AmberlightError, RuntimeError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        text = bpy.data.texts.get(EXPLANATION) or bpy.data.texts.new(EXPLANATION)
        text.clear()
        text.write("\n".join(lines) + "\n")
        if bpy.app.background:
            for line in lines:
                say(line)
        else:

            def draw(menu: Any, _: Any) -> None:
                for line in lines[:POPUP_LINES]:
                    menu.layout.label(text=line)

            context.window_manager.popup_menu(draw, title="Explain Effects")
        return {"FINISHED"}


CLASSES = (AMBERLIGHT_OT_new_translucent_material, AMBERLIGHT_OT_explain_effects)


def register() -> None:
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
