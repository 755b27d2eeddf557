# SPDX-License-Identifier: GPL-3.0-or-later
"""Plain data -> handles of the library."""

from __future__ import annotations

from ..binding import _ffi
from ..binding.handles import Scene
from .scene_data import CameraData, LightData, MaterialData, MeshData, SceneData

LIGHT_KINDS = {
    "POINT": _ffi.AMB_LIGHT_POINT,
    "SPOT": _ffi.AMB_LIGHT_SPOT,
    "SUN": _ffi.AMB_LIGHT_SUN,
    "AREA": _ffi.AMB_LIGHT_AREA,
}


def upload(data: SceneData, scene: Scene) -> None:
    """Fills `scene`, which must be fresh: then the ids are the indices of `data`. Not committed."""
    for material in data.materials:
        add_material(scene, material)
    for mesh in data.meshes:
        add_mesh(scene, mesh)
    for placed in data.objects:
        scene.add_object(placed.name, placed.mesh, placed.to_world, placed.materials)
    for light in data.lights:
        add_light(scene, light)
    if data.world_image:
        scene.set_world_image(data.world_image.radiance, data.world_image.to_world)
    else:
        scene.set_world(data.world)
    if data.camera:
        set_camera(scene, data.camera)


def add_material(scene: Scene, material: MaterialData) -> int:
    dielectric = material.is_dielectric
    return scene.add_material(
        material.name,
        surface=_ffi.AMB_SURFACE_DIELECTRIC if dielectric else _ffi.AMB_SURFACE_DIFFUSE,
        albedo=material.albedo,
        emission=material.emission,
        transmit_color=material.transmit_color,
        reflect_color=material.reflect_color,
        ior=material.ior,
        priority=material.priority,
        sigma_a=material.medium.sigma_a,
        lobes=[(lobe.sigma_s, lobe.g) for lobe in material.medium.lobes],
    )


def add_mesh(scene: Scene, mesh: MeshData) -> int:
    domain = _ffi.AMB_NORMALS_NONE
    if mesh.normals is not None:
        corner = mesh.normals.ndim == 3
        domain = _ffi.AMB_NORMALS_CORNER if corner else _ffi.AMB_NORMALS_VERTEX
    return scene.add_mesh(
        mesh.name, mesh.positions, mesh.triangles, mesh.normals, domain, mesh.slots
    )


def add_light(scene: Scene, light: LightData) -> int:
    return scene.add_light(
        LIGHT_KINDS[light.kind],
        light.name,
        color=light.color,
        position=light.position,
        direction=light.direction,
        tangent=light.tangent,
        radius=light.radius,
        angle=light.angle,
        spot_size=light.spot_size,
        spot_blend=light.spot_blend,
        spot_cosine=light.spot_cosine,
        size=light.size,
        area_shape=_ffi.AMB_AREA_ELLIPSE if light.is_ellipse else _ffi.AMB_AREA_RECTANGLE,
    )


def set_camera(scene: Scene, camera: CameraData) -> None:
    orthographic = camera.is_orthographic
    scene.set_camera(
        _ffi.AMB_CAMERA_ORTHOGRAPHIC if orthographic else _ffi.AMB_CAMERA_PERSPECTIVE,
        camera.to_world,
        window=camera.window,
        clip_start=camera.clip_start,
        clip_end=camera.clip_end,
        lens_radius=camera.lens_radius,
        focus_distance=camera.focus_distance,
    )
