# SPDX-License-Identifier: GPL-3.0-or-later
"""Run in a Blender with a window by test_in_blender.py: rendered mode, a moved view, a changed
scene, every tab of the properties and a final render; says what it saw."""

import sys
from pathlib import Path

import bpy
from amberlight import engine, viewport
from amberlight.operators import new_translucent_material
from amberlight.world_bake import state_of

sys.path.insert(0, str(Path(__file__).resolve().parent))
from window_steps import area, run, say, step, steps, window  # noqa: E402

seen = {"pictures": [], "previews": 0, "renders": 0}


def watch():
    take, render = viewport.Viewport.take_picture, engine.AmberlightRenderEngine._render

    def take_and_note(self, *arguments):
        take(self, *arguments)
        seen["pictures"].append(self.budget)

    def render_and_note(self, depsgraph):
        render(self, depsgraph)
        seen["previews" if self.is_preview else "renders"] += 1

    viewport.Viewport.take_picture = take_and_note
    engine.AmberlightRenderEngine._render = render_and_note


def has_drawn(name):
    """Waits for a picture in the viewport; a draft of it comes first."""

    def look():
        pictures = seen["pictures"]
        if viewport.PICTURE not in pictures:
            return False
        say(f"{name}{'' if pictures[0] == viewport.DRAFT else ' without a draft'}")
        pictures.clear()
        return True

    return look


def tab(context, active):
    """Shows a tab; which tabs there are Blender decides when it draws the active object."""

    def show():
        bpy.context.view_layer.objects.active = bpy.data.objects[active]
        try:
            area("PROPERTIES").spaces[0].context = context
        except TypeError:
            area("PROPERTIES").tag_redraw()
            return False
        say(f"tab {context} of {active}")
        return True

    return show


@step
def rendered_mode():
    scene = bpy.context.scene
    scene.render.engine = "AMBERLIGHT"
    scene.render.resolution_x = scene.render.resolution_y = 16
    cube = bpy.data.objects["Cube"]
    cube.data.materials[0] = new_translucent_material("RESIN")
    area("VIEW_3D").spaces[0].shading.type = "RENDERED"


steps.append(has_drawn("first"))


@step
def move_the_view():
    area("VIEW_3D").spaces[0].region_3d.view_distance *= 0.5


steps.append(has_drawn("moved"))


@step
def change_the_scene():
    bpy.data.objects["Cube"].location.z += 0.5


steps.append(has_drawn("changed"))


@step
def orthographic():
    area("VIEW_3D").spaces[0].region_3d.view_perspective = "ORTHO"


steps.append(has_drawn("orthographic"))


@step
def final_render():
    with bpy.context.temp_override(window=window()):
        bpy.ops.render.render()
    say(f"renders {seen['renders']}")


def baked(name):
    scene = bpy.context.scene
    say(f"{name} {state_of(scene.world, scene.frame_current)}")


@step
def a_world_to_bake():
    world = bpy.context.scene.world
    sky = world.node_tree.nodes.new("ShaderNodeTexSky")
    background = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
    world.node_tree.links.new(sky.outputs[0], background.inputs["Color"])
    world.amberlight.width = 64
    with bpy.context.temp_override(window=window()):
        bpy.ops.ed.undo_push(message="sky")
        bpy.ops.amberlight.bake_world("EXEC_DEFAULT", True)
    baked("baked")


@step
def take_it_back():
    with bpy.context.temp_override(window=window()):
        bpy.ops.ed.undo()
    baked("undone")


@step
def and_again():
    with bpy.context.temp_override(window=window()):
        bpy.ops.ed.redo()
    baked("redone")


for name in ("RENDER", "OUTPUT", "VIEW_LAYER", "WORLD", "OBJECT", "MATERIAL"):
    steps.append(tab(name, "Cube"))
steps += [tab("DATA", "Light"), tab("DATA", "Camera")]

watch()
run()
