# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of the cost report, scene.amberlight_cost, and its rows on the window manager."""

# No postponed annotations here: Blender reads the properties from the annotations themselves.
import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

enum_metrics = (
    (
        "rel_rmse",
        "RMSE / Mean",
        "Root of the mean squared error over the mean: mostly the edges of caustics",
    ),
    (
        "floored_rel",
        "Relative, Floored",
        "Relative error of each pixel, with 5 % of the mean added below: dark regions too",
    ),
)


class AmberlightCostSettings(bpy.types.PropertyGroup):
    size: IntProperty(
        name="Size",
        description="Pixels of the image's longer side at most; 0 = the scene's own resolution",
        min=0,
        soft_max=2048,
        default=256,
    )
    samples: IntProperty(
        name="Samples",
        description="Camera samples for each pixel, the same ones in every render",
        min=1,
        soft_max=64,
        default=4,
    )
    time_limit: FloatProperty(
        name="Time Limit",
        description="Seconds; what does not fit is left out and named; 0 = no limit",
        min=0.0,
        soft_max=3600.0,
        default=300.0,
    )
    repeats: IntProperty(
        name="Repeats",
        description="Runs of each of the best settings, where time allows: times are medians",
        min=1,
        soft_max=9,
        default=3,
    )
    metric: EnumProperty(
        name="Error",
        description="The error for which kernels are tuned, and that equal error means",
        items=enum_metrics,
        default="rel_rmse",
    )
    equal_error: FloatProperty(
        name="Equal Error",
        description="The error at which costs are compared; 0 = the smallest that every estimator "
        "reaches",
        min=0.0,
        max=1.0,
        precision=4,
    )
    equal_time: FloatProperty(
        name="Equal Time",
        description="The CPU seconds at which errors are compared; 0 = the longest to which every "
        "estimator was measured",
        min=0.0,
        precision=3,
    )
    reference: StringProperty(
        name="Reference",
        description="Image to compare with (.npy, .exr or the case.json of a reference case); "
        "empty = the most accurate estimator renders one",
        subtype="FILE_PATH",
    )
    directory: StringProperty(
        name="Directory",
        description="Where cost.csv, cost.md, cost.png and the images go",
        subtype="DIR_PATH",
        default="//amberlight_cost",
    )


class AmberlightCostRow(bpy.types.PropertyGroup):
    """A measured setting, as the list shows it and as it can be applied; 0: not of its kind."""

    estimator: StringProperty()
    light_samples: IntProperty()
    kernel_size: FloatProperty()
    tube_refinement: IntProperty()
    budget: StringProperty()
    total: FloatProperty()
    error: FloatProperty()
    is_best: BoolProperty()


class AmberlightCostState(bpy.types.PropertyGroup):
    """What the last measurement found, and how far a running one is."""

    rows: CollectionProperty(type=AmberlightCostRow)
    active: IntProperty()
    is_running: BoolProperty()
    fraction: FloatProperty(name="Progress", subtype="PERCENTAGE", min=0.0, max=100.0)
    text: StringProperty()


CLASSES = (AmberlightCostSettings, AmberlightCostRow, AmberlightCostState)


def register() -> None:
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.amberlight_cost = PointerProperty(type=AmberlightCostSettings)
    bpy.types.WindowManager.amberlight_cost = PointerProperty(type=AmberlightCostState)


def unregister() -> None:
    del bpy.types.WindowManager.amberlight_cost
    del bpy.types.Scene.amberlight_cost
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
