# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels: our own, and Blender's that also make sense for this engine."""

from __future__ import annotations

from typing import Any

import bpy

from . import report as reports
from .binding.errors import AmberlightError
from .passes import PASSES
from .render_job import EFFECTS
from .world_bake import state_of

ENGINE = "AMBERLIGHT"

# Blender's panels for every engine (those with BLENDER_RENDER), without those that show what has
# no meaning here or that we replace.
EXCLUDED = {
    "DATA_PT_area",
    "DATA_PT_falloff_curve",
    "DATA_PT_light",
    "DATA_PT_spot",
    "NODE_DATA_PT_light",
    "NODE_DATA_PT_spot",
    "RENDER_PT_freestyle",
    "RENDER_PT_simplify",
    "VIEWLAYER_PT_filter",
}
# Panels that Blender keeps for some of its own engines but that fit as they are.
ADOPTED = (
    "DATA_PT_camera_dof",
    "DATA_PT_camera_dof_aperture",
    "EEVEE_MATERIAL_PT_context_material",
    "MATERIAL_PT_preview",
)


class _Panel:
    """Shown for this engine, in the properties editor."""

    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    COMPAT_ENGINES = {ENGINE}

    @classmethod
    def poll(cls, context: Any) -> bool:
        return context.engine in cls.COMPAT_ENGINES

    @staticmethod
    def column(layout: Any) -> Any:
        layout.use_property_split = True
        layout.use_property_decorate = False
        return layout.column()


# ---- Render --------------------------------------------------------------------------------------


class AMBERLIGHT_RENDER_PT_sampling(_Panel, bpy.types.Panel):
    bl_label = "Sampling"
    bl_context = "render"

    def draw(self, context: Any) -> None:
        settings = context.scene.amberlight
        col = self.column(self.layout)
        col.prop(settings, "accuracy")
        sub = col.column()
        sub.active = settings.accuracy == 0.0
        sub.prop(settings, "samples")
        col.prop(settings, "light_samples")
        col.prop(settings, "seed")


class AMBERLIGHT_RENDER_PT_estimator(_Panel, bpy.types.Panel):
    bl_label = "Estimator"
    bl_context = "render"

    def draw(self, context: Any) -> None:
        settings = context.scene.amberlight
        col = self.column(self.layout)
        col.prop(settings, "estimator")
        if settings.estimator in {"AUTO", "TUBES"}:
            col.prop(settings, "tube_refinement")
        if settings.estimator not in {"TUBES", "SPECULAR"}:
            col.prop(settings, "kernel_size")
        col.prop(settings, "adjoint_normals")


class AMBERLIGHT_RENDER_PT_effects(_Panel, bpy.types.Panel):
    bl_label = "Effects"
    bl_context = "render"

    def draw(self, context: Any) -> None:
        settings = context.scene.amberlight
        col = self.column(self.layout)
        col.row().prop(settings, "effects", expand=True)
        col.operator("amberlight.explain_effects")
        sub = col.column(heading="Simulate")
        sub.active = settings.effects == "MANUAL"
        for name in EFFECTS:
            sub.prop(settings, name)
        sub.prop(settings, "light_bounces")
        sub.prop(settings, "camera_bounces")
        col.separator()
        col.prop(settings, "scatter_estimator")
        col.prop(settings, "scatter_order_max")


class AMBERLIGHT_RENDER_PT_film(_Panel, bpy.types.Panel):
    bl_label = "Film"
    bl_context = "render"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: Any) -> None:
        col = self.column(self.layout)
        col.prop(context.scene.render, "film_transparent", text="Transparent")
        col.prop(context.scene.amberlight, "exr_path")
        col.prop(context.scene.amberlight, "report_path")


class AMBERLIGHT_RENDER_PT_performance(_Panel, bpy.types.Panel):
    bl_label = "Performance"
    bl_context = "render"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: Any) -> None:
        render = context.scene.render
        col = self.column(self.layout)
        col.prop(render, "threads_mode")
        sub = col.column()
        sub.enabled = render.threads_mode == "FIXED"
        sub.prop(render, "threads")


class AMBERLIGHT_RENDER_PT_last(_Panel, bpy.types.Panel):
    bl_label = "Last Render"
    bl_context = "render"

    @classmethod
    def poll(cls, context: Any) -> bool:
        return context.engine in cls.COMPAT_ENGINES and context.scene.name in reports.LAST

    def draw(self, context: Any) -> None:
        summary = reports.LAST[context.scene.name]
        col = self.layout.column(align=True)
        for line in summary.warnings:
            col.label(text=line, icon="ERROR")
        for line in summary.lines:
            col.label(text=line)


# ---- Light, world, material, view layer ----------------------------------------------------------


class AMBERLIGHT_LIGHT_PT_light(_Panel, bpy.types.Panel):
    bl_label = "Light"
    bl_context = "data"

    @classmethod
    def poll(cls, context: Any) -> bool:
        return context.light is not None and context.engine in cls.COMPAT_ENGINES

    def draw(self, context: Any) -> None:
        light = context.light
        self.layout.row().prop(light, "type", expand=True)
        col = self.column(self.layout)
        # Names that only newer versions of Blender have are left out in the older ones.
        for name in ("use_temperature", "temperature"):
            if hasattr(light, name):
                col.prop(light, name)
        col.prop(light, "color")
        col.prop(light, "energy", text="Strength" if light.type == "SUN" else "Power")
        for name in ("exposure", "normalize"):
            if hasattr(light, name):
                col.prop(light, name)
        col.separator()
        if light.type == "SUN":
            col.prop(light, "angle")
        elif light.type == "AREA":
            col.prop(light, "shape")
            col.prop(light, "size")
            if light.shape in {"RECTANGLE", "ELLIPSE"}:
                col.prop(light, "size_y")
        else:
            col.prop(light, "shadow_soft_size", text="Radius")
        if light.type == "SPOT":
            col.prop(light, "spot_size", text="Beam Size")
            col.prop(light, "spot_blend", text="Blend", slider=True)
            col.prop(light, "show_cone")


def draw_node_input(layout: Any, tree: Any, name: str) -> None:
    """The tree behind an input of the output node that is rendered: the one for Cycles."""
    output = tree.get_output_node("CYCLES") if tree else None
    socket = output.inputs.get(name) if output else None
    if socket:
        layout.template_node_view(tree, output, socket)
    else:
        layout.label(text="No output node")


def draw_use_nodes(layout: Any, owner: Any) -> bool:
    """True if nodes are used; since 5.0 they always are."""
    if bpy.app.version >= (5, 0):
        return True
    layout.prop(owner, "use_nodes", icon="NODETREE")
    layout.separator()
    return bool(owner.use_nodes)


class AMBERLIGHT_WORLD_PT_surface(_Panel, bpy.types.Panel):
    bl_label = "Surface"
    bl_context = "world"

    @classmethod
    def poll(cls, context: Any) -> bool:
        return context.world is not None and context.engine in cls.COMPAT_ENGINES

    def draw(self, context: Any) -> None:
        world = context.world
        if draw_use_nodes(self.layout, world):
            draw_node_input(self.column(self.layout), world.node_tree, "Surface")
        else:
            self.column(self.layout).prop(world, "color")


BAKE_TEXTS = {
    "NOT_NEEDED": ("Not needed: the nodes are rendered as they are", "CHECKMARK"),
    "MISSING": ("Not baked: some nodes are not understood", "ERROR"),
    "CURRENT": ("Baked", "CHECKMARK"),
    "STALE": ("Out of date: the nodes have changed", "ERROR"),
}


class AMBERLIGHT_WORLD_PT_bake(_Panel, bpy.types.Panel):
    bl_label = "Bake"
    bl_context = "world"

    @classmethod
    def poll(cls, context: Any) -> bool:
        return context.world is not None and context.engine in cls.COMPAT_ENGINES

    def draw(self, context: Any) -> None:
        world = context.world
        col = self.column(self.layout)
        try:
            text, icon = BAKE_TEXTS[state_of(world, context.scene.frame_current)]
        except AmberlightError as error:
            text, icon = str(error), "ERROR"
        col.label(text=text, icon=icon)
        col.prop(world.amberlight, "width")
        row = col.row(align=True)
        row.operator("amberlight.bake_world")
        row.operator("amberlight.clear_baked_world")


class _MaterialPanel(_Panel):
    bl_context = "material"

    @classmethod
    def poll(cls, context: Any) -> bool:
        material = context.material
        return (
            material is not None
            and not material.grease_pencil
            and context.engine in cls.COMPAT_ENGINES
        )


class AMBERLIGHT_MATERIAL_PT_surface(_MaterialPanel, bpy.types.Panel):
    bl_label = "Surface"

    def draw(self, context: Any) -> None:
        material = context.material
        if draw_use_nodes(self.layout, material):
            draw_node_input(self.column(self.layout), material.node_tree, "Surface")
        else:
            self.column(self.layout).prop(material, "diffuse_color", text="Base Color")


class AMBERLIGHT_MATERIAL_PT_volume(_MaterialPanel, bpy.types.Panel):
    bl_label = "Volume"

    def draw(self, context: Any) -> None:
        draw_node_input(self.column(self.layout), context.material.node_tree, "Volume")


class AMBERLIGHT_MATERIAL_PT_overlap(_MaterialPanel, bpy.types.Panel):
    bl_label = "Overlap"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: Any) -> None:
        self.column(self.layout).prop(context.material.amberlight, "priority")


class AMBERLIGHT_MATERIAL_PT_new(_Panel, bpy.types.Panel):
    bl_label = "Translucent"
    bl_context = "material"
    bl_options = {"HIDE_HEADER"}

    @classmethod
    def poll(cls, context: Any) -> bool:
        return context.object is not None and context.engine in cls.COMPAT_ENGINES

    def draw(self, context: Any) -> None:
        self.layout.operator_menu_enum("amberlight.new_translucent_material", "preset")


class AMBERLIGHT_VIEWLAYER_PT_passes(_Panel, bpy.types.Panel):
    bl_label = "Passes"
    bl_context = "view_layer"

    def draw(self, context: Any) -> None:
        col = self.column(self.layout)
        col.prop(context.view_layer, "use_pass_z", text="Depth")
        names = [item.name for item in PASSES if not item.is_builtin]
        col.label(text=f"Always: Combined, {', '.join(names)}")


# ---- Node menu -----------------------------------------------------------------------------------

SHADERS = (
    ("ShaderNodeBsdfGlass", "Glass BSDF"),
    ("ShaderNodeBsdfRefraction", "Refraction BSDF"),
    ("ShaderNodeBsdfPrincipled", "Principled BSDF"),
    ("ShaderNodeBsdfDiffuse", "Diffuse BSDF"),
    ("ShaderNodeBsdfTransparent", "Transparent BSDF"),
    ("ShaderNodeEmission", "Emission"),
    ("ShaderNodeBackground", "Background"),
    ("ShaderNodeTexEnvironment", "Environment Texture"),
    ("ShaderNodeTexSky", "Sky Texture"),
    ("ShaderNodeMapping", "Mapping"),
    ("ShaderNodeTexCoord", "Texture Coordinate"),
    ("ShaderNodeVolumeScatter", "Volume Scatter"),
    ("ShaderNodeVolumeAbsorption", "Volume Absorption"),
    ("ShaderNodeVolumePrincipled", "Principled Volume"),
    ("ShaderNodeAddShader", "Add Shader"),
    ("ShaderNodeMixShader", "Mix Shader"),
    ("ShaderNodeOutputMaterial", "Material Output"),
    ("ShaderNodeOutputWorld", "World Output"),
)


class AMBERLIGHT_MT_shaders(bpy.types.Menu):
    """Before 4.0 Blender hides shader nodes from every engine that is not its own."""

    bl_label = "Amberlight"

    def draw(self, context: Any) -> None:
        for identifier, label in SHADERS:
            add = self.layout.operator("node.add_node", text=label)
            add.type = identifier
            add.use_transform = True


def draw_shader_menu(self: Any, context: Any) -> None:
    if context.engine == ENGINE and context.space_data.tree_type == "ShaderNodeTree":
        self.layout.menu("AMBERLIGHT_MT_shaders")


# ---- Registration --------------------------------------------------------------------------------

CLASSES = (
    AMBERLIGHT_RENDER_PT_sampling,
    AMBERLIGHT_RENDER_PT_estimator,
    AMBERLIGHT_RENDER_PT_effects,
    AMBERLIGHT_RENDER_PT_film,
    AMBERLIGHT_RENDER_PT_performance,
    AMBERLIGHT_RENDER_PT_last,
    AMBERLIGHT_LIGHT_PT_light,
    AMBERLIGHT_WORLD_PT_surface,
    AMBERLIGHT_WORLD_PT_bake,
    AMBERLIGHT_MATERIAL_PT_new,
    AMBERLIGHT_MATERIAL_PT_surface,
    AMBERLIGHT_MATERIAL_PT_volume,
    AMBERLIGHT_MATERIAL_PT_overlap,
    AMBERLIGHT_VIEWLAYER_PT_passes,
    AMBERLIGHT_MT_shaders,
)


def foreign_panels() -> list[Any]:
    """Blender's panels that are shown for this engine too."""
    panels = [
        panel
        for panel in bpy.types.Panel.__subclasses__()
        if "BLENDER_RENDER" in getattr(panel, "COMPAT_ENGINES", ())
        and panel.__name__ not in EXCLUDED
    ]
    adopted = (getattr(bpy.types, name, None) for name in ADOPTED)
    return panels + [panel for panel in adopted if panel is not None]


def register() -> None:
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    for panel in foreign_panels():
        panel.COMPAT_ENGINES.add(ENGINE)
    if bpy.app.version < (4, 0):
        bpy.types.NODE_MT_add.append(draw_shader_menu)


def unregister() -> None:
    if bpy.app.version < (4, 0):
        bpy.types.NODE_MT_add.remove(draw_shader_menu)
    for panel in foreign_panels():
        panel.COMPAT_ENGINES.discard(ENGINE)
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
