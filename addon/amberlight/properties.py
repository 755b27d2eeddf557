# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of scenes, materials and worlds: their property amberlight."""

# No postponed annotations here: Blender reads the properties from the annotations themselves.
from typing import Any

import bpy
from bpy.props import (
    BoolProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from .render_job import Settings

enum_estimators = (
    ("AUTO", "Automatic", "Let the scene decide"),
    ("POINTS_FIXED", "Points, fixed kernel", "Volume samples, each blurred by the same kernel"),
    (
        "POINTS_COVARIANCE",
        "Points, covariance kernel",
        "Volume samples, each blurred as the covariance of its light allows: sharp where light is "
        "focused, smooth elsewhere",
    ),
    (
        "TUBES",
        "Tubes",
        "Light tubes behind each triangle: no kernel, no noise; for lamps outside of all "
        "translucent objects; best for small ones and up to two light bounces",
    ),
    (
        "SPECULAR",
        "Exact connections",
        "Light paths solved for each camera ray: the reference of the others, exact and slow; for "
        "lamps without extent outside of all translucent objects, without light bounces",
    ),
)
enum_scatter_estimators = (
    ("AUTO", "Automatic", "Let the scene decide"),
    ("WALK", "Random Walk", "Random walks from the camera: noise, but no other error"),
    (
        "PHOTONS",
        "Photons",
        "Photons from the lamps, kept by depth below the surface: for jade, wax and milk",
    ),
    (
        "TREE_CUT",
        "Tree Cut",
        "The published point-based method, for comparison: straight connections to volume samples; "
        "light that walls reflect between scatterings is missing",
    ),
)
enum_effects = (
    ("AUTO", "Automatic", "Simulate what the scene shows, and say what was left out and why"),
    ("MANUAL", "Manual", "Choose the effects"),
)

DEFAULT = Settings()
FOLLOW = (
    "internal reflections inside the medium that {} paths follow; 0 = none. Automatic effects "
    "choose the number by themselves"
)


class AmberlightSceneSettings(bpy.types.PropertyGroup):
    estimator: EnumProperty(
        name="Estimator",
        description="How light that scattered in a medium is gathered",
        items=enum_estimators,
        default=DEFAULT.estimator,
    )
    samples: IntProperty(
        name="Samples",
        description="Camera samples for each pixel; without effect where an accuracy is set",
        min=1,
        soft_max=1024,
        default=DEFAULT.samples,
    )
    accuracy: FloatProperty(
        name="Accuracy",
        description="Relative error of the translucent objects to stop at, 0.01 = 1 %: camera "
        "samples go where the picture needs them, and the light field is made fine enough; 0 = "
        "fixed number of samples",
        min=0.0,
        max=1.0,
        soft_max=0.1,
        step=0.1,
        precision=4,
        default=DEFAULT.accuracy,
    )
    light_samples: IntProperty(
        name="Light Samples",
        description="Volume samples that the light leaves in the media; where an accuracy is set, "
        "it may take from a 64th to 16 times as many",
        min=1,
        soft_min=1000,
        soft_max=100_000_000,
        default=DEFAULT.light_samples,
    )
    kernel_size: FloatProperty(
        name="Kernel Size",
        description="Samples that overlap a point: more is smoother and less sharp",
        min=0.01,
        soft_max=200.0,
        default=DEFAULT.kernel_size,
    )
    tube_refinement: IntProperty(
        name="Tube Refinement",
        description="Tubes for each triangle: 0, 1, 2, 3, 4 = one, 4, 16, 64, 256; -1 and -2 cut "
        "rough faces and edges of shadows less",
        min=-2,
        max=4,
        default=DEFAULT.tube_refinement,
    )
    effects: EnumProperty(
        name="Effects",
        description="Which effects are simulated",
        items=enum_effects,
        default=DEFAULT.effects,
    )
    use_single_scattering: BoolProperty(
        name="Single Scattering",
        description="Light that scattered once in a medium: the volume caustics",
        default=DEFAULT.use_single_scattering,
    )
    use_double_scattering: BoolProperty(
        name="Double Scattering",
        description="Light that scattered twice",
        default=DEFAULT.use_double_scattering,
    )
    use_multiple_scattering: BoolProperty(
        name="Multiple Scattering",
        description="Light that scattered three times and more",
        default=DEFAULT.use_multiple_scattering,
    )
    use_world_light: BoolProperty(
        name="Light of the Surroundings",
        description="Light of the world and of lit opaque surfaces that scatters in a medium",
        default=DEFAULT.use_world_light,
    )
    use_surface_reflection: BoolProperty(
        name="Surface Reflection",
        description="Surroundings reflected by refractive surfaces",
        default=DEFAULT.use_surface_reflection,
    )
    use_background: BoolProperty(
        name="Background",
        description="What is seen through refractive objects",
        default=DEFAULT.use_background,
    )
    use_transmitted_light: BoolProperty(
        name="Light Through Objects",
        description="Light that passes one refractive object and then enters another",
        default=DEFAULT.use_transmitted_light,
    )
    use_caustics: BoolProperty(
        name="Caustics",
        description="Light that reaches opaque surfaces through translucent objects or off them; "
        "without, these cast black shadows",
        default=DEFAULT.use_caustics,
    )
    use_interreflection: BoolProperty(
        name="Light Between Surfaces",
        description="Light that opaque surfaces send one another",
        default=DEFAULT.use_interreflection,
    )
    use_lamp_images: BoolProperty(
        name="Images of Lamps",
        description="Lamps of some size that are seen mirrored in objects, or through them",
        default=DEFAULT.use_lamp_images,
    )
    light_bounces: IntProperty(
        name="Light Bounces",
        description="Most " + FOLLOW.format("light"),
        min=0,
        soft_max=8,
        default=DEFAULT.light_bounces,
    )
    camera_bounces: IntProperty(
        name="Camera Bounces",
        description="Most " + FOLLOW.format("camera"),
        min=0,
        soft_max=8,
        default=DEFAULT.camera_bounces,
    )
    adjoint_normals: BoolProperty(
        name="Adjoint Normals",
        description="Correct the light's side for shading normals that differ from the geometry",
        default=DEFAULT.adjoint_normals,
    )
    seed: IntProperty(
        name="Seed",
        description="Other random numbers; the same seed gives the same image",
        min=0,
        default=DEFAULT.seed,
    )
    scatter_estimator: EnumProperty(
        name="Later Orders",
        description="How light that scattered twice and more is found",
        items=enum_scatter_estimators,
        default=DEFAULT.scatter_estimator,
    )
    scatter_order_max: IntProperty(
        name="Most Scatterings",
        description="Light that scattered more often is left out; 0 = no limit",
        min=0,
        soft_max=64,
        default=DEFAULT.scatter_order_max,
    )
    memory_limit: IntProperty(
        name="Memory Limit",
        description="MiB that a render may use; 0 = half of the machine's memory",
        min=0,
        default=DEFAULT.memory_limit,
    )
    report_path: StringProperty(
        name="Report",
        description="JSON file with the report of each render; empty = none",
        subtype="FILE_PATH",
    )
    exr_path: StringProperty(
        name="Passes",
        description="OpenEXR file with all passes in 32-bit float, beside Blender's own output; "
        "empty = none",
        subtype="FILE_PATH",
    )


class AmberlightMaterialSettings(bpy.types.PropertyGroup):
    priority: IntProperty(
        name="Priority",
        description="Where objects overlap, the medium with the highest priority fills the common "
        "part; with equal ones it is that of the object that a ray entered last",
        soft_min=-10,
        soft_max=10,
        default=0,
    )


class AmberlightWorldSettings(bpy.types.PropertyGroup):
    image: PointerProperty(
        name="Baked World",
        description="What Cycles found that the nodes of the world show, in all directions",
        type=bpy.types.Image,
    )
    fingerprint: StringProperty(
        name="Fingerprint",
        description="Of the nodes that were baked: they have changed where it is another",
        options={"HIDDEN"},
    )
    width: IntProperty(
        name="Width",
        description="Pixels around the horizon; 0 = those of the widest image in the nodes, but "
        "from 2048 to 8192",
        min=0,
        max=16384,
        default=0,
    )


def read_settings(scene: bpy.types.Scene) -> Settings:
    """The settings of a scene as plain values."""
    group: Any = scene.amberlight
    return Settings(**{name: getattr(group, name) for name in Settings.__dataclass_fields__})


def register() -> None:
    bpy.utils.register_class(AmberlightSceneSettings)
    bpy.utils.register_class(AmberlightMaterialSettings)
    bpy.utils.register_class(AmberlightWorldSettings)
    bpy.types.Scene.amberlight = PointerProperty(type=AmberlightSceneSettings)
    bpy.types.Material.amberlight = PointerProperty(type=AmberlightMaterialSettings)
    bpy.types.World.amberlight = PointerProperty(type=AmberlightWorldSettings)


def unregister() -> None:
    del bpy.types.World.amberlight
    del bpy.types.Material.amberlight
    del bpy.types.Scene.amberlight
    bpy.utils.unregister_class(AmberlightWorldSettings)
    bpy.utils.unregister_class(AmberlightMaterialSettings)
    bpy.utils.unregister_class(AmberlightSceneSettings)
