# SPDX-License-Identifier: GPL-3.0-or-later
"""Steps that a script takes in a Blender with a window, one a tick, so that Blender draws and
answers between them. What a step sees is printed, and test_in_blender.py reads it."""

import os
import traceback
from collections.abc import Callable

import bpy

Step = Callable[[], bool | None]
steps: list[Step] = []


def say(text: str) -> None:
    print(f"SAW {text}", flush=True)


def step(function: Step) -> Step:
    """Decorator: the next step. One that answers False is tried again at the next tick."""
    steps.append(function)
    return function


def window() -> bpy.types.Window:
    return bpy.context.window_manager.windows[0]


def area(kind: str) -> bpy.types.Area:
    return next(area for area in window().screen.areas if area.type == kind)


def end() -> None:
    say("the end")
    os._exit(0)


def _tick() -> float:
    try:
        if steps[0]() is not False:
            steps.pop(0)
    except Exception as error:
        # For a moment, while a preview's thread calls Python, Blender refuses what a timer may
        # write; no step has written anything by then, and it is tried again.
        if "Writing to ID classes" not in str(error):
            traceback.print_exc()
            os._exit(1)
    return 0.3


def run() -> None:
    """Takes the steps that are there by now, then quits Blender with 0; with 1 where one raises."""
    steps.append(end)
    bpy.app.timers.register(_tick, first_interval=1.0)
