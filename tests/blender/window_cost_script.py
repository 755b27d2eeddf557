# SPDX-License-Identifier: GPL-3.0-or-later
"""Run in a Blender with a window by test_in_blender.py: the cost report beside a user interface
that stays alive, stopped with Esc, then to its end; says what it saw."""

import os
import sys
import time
from pathlib import Path

import bpy
from amberlight.operators import new_translucent_material

sys.path.insert(0, str(Path(__file__).resolve().parent))
from window_steps import area, run, say, step, steps, window  # noqa: E402

seen = {"ticks": 0, "longest": 0.0, "last": 0.0}


def state():
    return bpy.context.window_manager.amberlight_cost


@step
def prepare():
    scene = bpy.context.scene
    scene.render.engine = "AMBERLIGHT"
    scene.render.resolution_x = scene.render.resolution_y = 16
    bpy.data.objects["Cube"].data.materials[0] = new_translucent_material("RESIN")
    scene.amberlight_cost.time_limit = 60.0
    scene.amberlight_cost.directory = os.path.join(bpy.app.tempdir, "cost")
    area("PROPERTIES").spaces[0].context = "RENDER"


def start():
    with bpy.context.temp_override(window=window(), area=area("PROPERTIES")):
        result = bpy.ops.amberlight.measure_cost("INVOKE_DEFAULT")
    say(f"started {result}")


steps.append(start)


@step
def runs():
    if state().fraction == 0.0 or "rows" not in state().text:
        return False
    say(f"running {state().is_running}")
    window().event_simulate(type="ESC", value="PRESS")
    return True


@step
def stopped():
    if state().is_running:
        return False
    say(f"stopped with {len(state().rows)} rows")


@step
def again():
    bpy.context.scene.amberlight_cost.time_limit = 3.0
    seen["last"] = time.perf_counter()
    start()


@step
def measured():
    now = time.perf_counter()
    seen["longest"] = max(seen["longest"], now - seen["last"])
    seen["last"] = now
    seen["ticks"] += 1
    if state().is_running:
        return False
    say(f"rows {len(state().rows) > 3}")
    # Ticks come every 0.3 s; a measurement that blocked would let none of them through.
    say(f"ticks {seen['ticks'] >= 4}")


@step
def picture():
    """A second window, because no image editor was open."""
    shown = [
        area.spaces.active.image.name
        for window in bpy.context.window_manager.windows
        for area in window.screen.areas
        if area.type == "IMAGE_EDITOR" and area.spaces.active.image
    ]
    say(f"picture {shown}")


@step
def apply():
    """The panel draws the rows by now."""
    index = next(i for i, row in enumerate(state().rows) if row.estimator == "POINTS_FIXED")
    state().active = index
    with bpy.context.temp_override(window=window(), area=area("PROPERTIES")):
        bpy.ops.amberlight.apply_cost_row("INVOKE_DEFAULT")
    say(f"applied {bpy.context.scene.amberlight.estimator}")


run()
