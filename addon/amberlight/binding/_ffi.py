# SPDX-License-Identifier: GPL-3.0-or-later
"""ctypes declarations of amberlight.h, in the header's order and with the header's names.

Nothing but declarations: a test parses the header and compares every constant, field and
function with this file.
"""

from __future__ import annotations

from ctypes import (
    POINTER,
    Structure,
    c_char,
    c_char_p,
    c_double,
    c_float,
    c_int32,
    c_uint32,
    c_uint64,
    c_void_p,
)
from typing import Any

AMB_ABI_VERSION = 6
AMB_VERSION_STRING = "0.1.0"

# ---- Status --------------------------------------------------------------------------------------

AMB_OK = 0
AMB_INVALID_ARGUMENT = 1
AMB_INVALID_STATE = 2
AMB_OUT_OF_MEMORY = 3
AMB_UNSUPPORTED = 4
AMB_IO = 5
AMB_CANCELLED = 6
AMB_INTERNAL = 7


class AmbStatus(c_int32):
    """Return type of the functions that can fail; its errcheck raises."""


class AmbErrorInfo(Structure):
    _fields_ = [
        ("status", c_int32),
        ("function", c_char * 64),
        ("message", c_char * 256),
    ]


# ---- Version -------------------------------------------------------------------------------------

AMB_STRUCT_ERROR_INFO = 0
AMB_STRUCT_PHASE_LOBE = 1
AMB_STRUCT_MATERIAL = 2
AMB_STRUCT_MESH = 3
AMB_STRUCT_OBJECT = 4
AMB_STRUCT_LIGHT = 5
AMB_STRUCT_CAMERA = 6
AMB_STRUCT_RENDER_PARAMS = 7
AMB_STRUCT_PROGRESS = 8
AMB_STRUCT_WORLD_IMAGE = 9
AMB_STRUCT_TEXTURE = 10
AMB_STRUCT_COUNT = 11

# ---- Scene ---------------------------------------------------------------------------------------


AMB_EXTENSION_REPEAT = 0
AMB_EXTENSION_EDGE = 1
AMB_EXTENSION_CLIP = 2
AMB_EXTENSION_MIRROR = 3

AMB_INTERPOLATION_LINEAR = 0
AMB_INTERPOLATION_CLOSEST = 1


class AmbTexture(Structure):
    _fields_ = [
        ("struct_size", c_uint32),
        ("width", c_uint32),
        ("height", c_uint32),
        ("extension", c_uint32),
        ("interpolation", c_uint32),
        ("reserved", c_uint32),
        ("name", c_char_p),
        ("color", POINTER(c_float)),
    ]


class AmbPhaseLobe(Structure):
    _fields_ = [
        ("sigma_s", c_float * 3),
        ("g", c_float),
    ]


AMB_PHASE_LOBE_MAX = 4

AMB_SURFACE_DIFFUSE = 0
AMB_SURFACE_DIELECTRIC = 1


class AmbMaterial(Structure):
    _fields_ = [
        ("struct_size", c_uint32),
        ("surface", c_uint32),
        ("name", c_char_p),
        ("albedo", c_float * 3),
        ("emission", c_float * 3),
        ("transmit_color", c_float * 3),
        ("reflect_color", c_float * 3),
        ("ior", c_float),
        ("sigma_a", c_float * 3),
        ("lobe_count", c_uint32),
        ("lobes", AmbPhaseLobe * AMB_PHASE_LOBE_MAX),
        ("priority", c_int32),
        ("texture", c_uint32),
        ("uv_to_texture", c_float * 6),
    ]


AMB_NORMALS_NONE = 0
AMB_NORMALS_VERTEX = 1
AMB_NORMALS_CORNER = 2


class AmbMesh(Structure):
    _fields_ = [
        ("struct_size", c_uint32),
        ("normal_domain", c_uint32),
        ("name", c_char_p),
        ("positions", POINTER(c_float)),
        ("triangles", POINTER(c_uint32)),
        ("normals", POINTER(c_float)),
        ("slots", POINTER(c_uint32)),
        ("vertex_count", c_uint64),
        ("triangle_count", c_uint64),
        ("uvs", POINTER(c_float)),
    ]


class AmbObject(Structure):
    _fields_ = [
        ("struct_size", c_uint32),
        ("mesh", c_uint32),
        ("name", c_char_p),
        ("to_world", c_float * 16),
        ("materials", POINTER(c_uint32)),
        ("material_count", c_uint32),
        ("reserved", c_uint32),
    ]


AMB_LIGHT_POINT = 0
AMB_LIGHT_SPOT = 1
AMB_LIGHT_SUN = 2
AMB_LIGHT_AREA = 3

AMB_AREA_RECTANGLE = 0
AMB_AREA_ELLIPSE = 1


class AmbLight(Structure):
    _fields_ = [
        ("struct_size", c_uint32),
        ("kind", c_uint32),
        ("name", c_char_p),
        ("color", c_float * 3),
        ("position", c_float * 3),
        ("direction", c_float * 3),
        ("tangent", c_float * 3),
        ("radius", c_float),
        ("angle", c_float),
        ("spot_size", c_float),
        ("spot_blend", c_float),
        ("spot_cosine", c_float),
        ("size", c_float * 2),
        ("area_shape", c_uint32),
        ("reserved", c_uint32),
    ]


class AmbWorldImage(Structure):
    _fields_ = [
        ("struct_size", c_uint32),
        ("width", c_uint32),
        ("height", c_uint32),
        ("to_world", c_float * 9),
        ("radiance", POINTER(c_float)),
    ]


AMB_CAMERA_PERSPECTIVE = 0
AMB_CAMERA_ORTHOGRAPHIC = 1


class AmbCamera(Structure):
    _fields_ = [
        ("struct_size", c_uint32),
        ("kind", c_uint32),
        ("to_world", c_float * 16),
        ("window", c_float * 4),
        ("clip_start", c_float),
        ("clip_end", c_float),
        ("lens_radius", c_float),
        ("focus_distance", c_float),
    ]


# ---- Render --------------------------------------------------------------------------------------

AMB_ESTIMATOR_AUTO = 0
AMB_ESTIMATOR_POINTS_FIXED = 1
AMB_ESTIMATOR_POINTS_COVARIANCE = 2
AMB_ESTIMATOR_TUBES = 3
AMB_ESTIMATOR_SPECULAR = 4

AMB_EFFECT_SINGLE_SCATTERING = 1 << 0
AMB_EFFECT_DOUBLE_SCATTERING = 1 << 1
AMB_EFFECT_MULTIPLE_SCATTERING = 1 << 2
AMB_EFFECT_SURFACE_REFLECTION = 1 << 3
AMB_EFFECT_BACKGROUND = 1 << 4
AMB_EFFECT_TRANSMITTED_LIGHT = 1 << 5
AMB_EFFECT_CAUSTICS = 1 << 6
AMB_EFFECT_WORLD_LIGHT = 1 << 7
AMB_EFFECT_INTERREFLECTION = 1 << 8
AMB_EFFECT_LAMP_IMAGES = 1 << 9

AMB_SCATTER_AUTO = 0
AMB_SCATTER_WALK = 1
AMB_SCATTER_PHOTONS = 2
AMB_SCATTER_TREE_CUT = 3


class AmbRenderParams(Structure):
    _fields_ = [
        ("struct_size", c_uint32),
        ("width", c_uint32),
        ("height", c_uint32),
        ("crop_x", c_uint32),
        ("crop_y", c_uint32),
        ("crop_width", c_uint32),
        ("crop_height", c_uint32),
        ("samples", c_uint32),
        ("estimator", c_uint32),
        ("effects", c_uint32),
        ("light_samples", c_uint64),
        ("kernel_size", c_float),
        ("light_bounces", c_uint32),
        ("camera_bounces", c_uint32),
        ("adjoint_normals", c_uint32),
        ("seed", c_uint32),
        ("threads", c_uint32),
        ("film_transparent", c_uint32),
        ("tube_refinement", c_int32),
        ("accuracy", c_float),
        ("scatter_estimator", c_uint32),
        ("scatter_order_max", c_uint32),
        ("effects_are_auto", c_uint32),
        ("memory_limit", c_uint64),
        ("coarse_first", c_uint32),
        ("reserved", c_uint32),
    ]


AMB_STATE_RUNNING = 0
AMB_STATE_DONE = 1
AMB_STATE_CANCELLED = 2
AMB_STATE_FAILED = 3


class AmbProgress(Structure):
    _fields_ = [
        ("struct_size", c_uint32),
        ("state", c_uint32),
        ("fraction", c_float),
        ("elapsed", c_float),
        ("samples_done", c_uint32),
        ("pixel_step", c_uint32),
        ("stage", c_char * 32),
        ("detail", c_char * 96),
        ("error", c_float),
        ("remaining", c_float),
    ]


# Opaque objects.
AmbScene = c_void_p
AmbRender = c_void_p

# Struct ids of amb_struct_size, for the check at load.
STRUCT_IDS: dict[int, type[Structure]] = {
    AMB_STRUCT_ERROR_INFO: AmbErrorInfo,
    AMB_STRUCT_PHASE_LOBE: AmbPhaseLobe,
    AMB_STRUCT_MATERIAL: AmbMaterial,
    AMB_STRUCT_MESH: AmbMesh,
    AMB_STRUCT_OBJECT: AmbObject,
    AMB_STRUCT_LIGHT: AmbLight,
    AMB_STRUCT_CAMERA: AmbCamera,
    AMB_STRUCT_RENDER_PARAMS: AmbRenderParams,
    AMB_STRUCT_PROGRESS: AmbProgress,
    AMB_STRUCT_WORLD_IMAGE: AmbWorldImage,
    AMB_STRUCT_TEXTURE: AmbTexture,
}

# name: (restype, argtypes). AmbStatus as restype means: raise unless AMB_OK.
FUNCTIONS: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "amb_last_error": (None, (POINTER(AmbErrorInfo),)),
    "amb_status_name": (c_char_p, (c_int32,)),
    "amb_abi_version": (c_uint32, ()),
    "amb_version_string": (c_char_p, ()),
    "amb_struct_size": (c_uint64, (c_uint32,)),
    "amb_self_test": (AmbStatus, ()),
    "amb_scene_create": (AmbStatus, (POINTER(AmbScene),)),
    "amb_scene_destroy": (None, (AmbScene,)),
    "amb_texture_init": (None, (POINTER(AmbTexture),)),
    "amb_scene_add_texture": (AmbStatus, (AmbScene, POINTER(AmbTexture), POINTER(c_uint32))),
    "amb_material_init": (None, (POINTER(AmbMaterial),)),
    "amb_scene_add_material": (
        AmbStatus,
        (AmbScene, POINTER(AmbMaterial), POINTER(c_uint32)),
    ),
    "amb_mesh_init": (None, (POINTER(AmbMesh),)),
    "amb_scene_add_mesh": (AmbStatus, (AmbScene, POINTER(AmbMesh), POINTER(c_uint32))),
    "amb_object_init": (None, (POINTER(AmbObject),)),
    "amb_scene_add_object": (AmbStatus, (AmbScene, POINTER(AmbObject), POINTER(c_uint32))),
    "amb_light_init": (None, (POINTER(AmbLight), c_uint32)),
    "amb_scene_add_light": (AmbStatus, (AmbScene, POINTER(AmbLight), POINTER(c_uint32))),
    "amb_scene_set_world": (AmbStatus, (AmbScene, POINTER(c_float))),
    "amb_world_image_init": (None, (POINTER(AmbWorldImage),)),
    "amb_scene_set_world_image": (AmbStatus, (AmbScene, POINTER(AmbWorldImage))),
    "amb_camera_init": (None, (POINTER(AmbCamera), c_uint32)),
    "amb_scene_set_camera": (AmbStatus, (AmbScene, POINTER(AmbCamera))),
    "amb_scene_commit": (AmbStatus, (AmbScene,)),
    "amb_render_params_init": (None, (POINTER(AmbRenderParams),)),
    "amb_render_start": (
        AmbStatus,
        (AmbScene, POINTER(AmbRenderParams), POINTER(AmbRender)),
    ),
    # The buffer is a plain address: c_char_p would copy, and it may be NULL.
    "amb_plan_explain": (
        AmbStatus,
        (AmbScene, POINTER(AmbRenderParams), c_void_p, c_uint64, POINTER(c_uint64)),
    ),
    "amb_progress_init": (None, (POINTER(AmbProgress),)),
    "amb_render_progress": (AmbStatus, (AmbRender, POINTER(AmbProgress))),
    "amb_render_cancel": (None, (AmbRender,)),
    "amb_render_wait": (AmbStatus, (AmbRender, c_double, POINTER(c_int32))),
    "amb_render_pass_channels": (AmbStatus, (AmbRender, c_char_p, POINTER(c_uint32))),
    "amb_render_read_pass": (AmbStatus, (AmbRender, c_char_p, POINTER(c_float), c_uint64)),
    "amb_render_report": (AmbStatus, (AmbRender, c_void_p, c_uint64, POINTER(c_uint64))),
    "amb_render_write_exr": (AmbStatus, (AmbRender, c_char_p, c_char_p)),
    "amb_render_destroy": (None, (AmbRender,)),
}
