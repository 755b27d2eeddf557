# SPDX-License-Identifier: GPL-3.0-or-later
"""Plain data -> handles of the library."""

from __future__ import annotations

from ..binding import _ffi
from ..binding.handles import Scene
from .scene_data import CameraData, LightData, MaterialData, MeshData, SceneData, TextureData

LIGHT_KINDS = {
    "POINT": _ffi.AMB_LIGHT_POINT,
    "SPOT": _ffi.AMB_LIGHT_SPOT,
    "SUN": _ffi.AMB_LIGHT_SUN,
    "AREA": _ffi.AMB_LIGHT_AREA,
}


EXTENSIONS = {
    "REPEAT": _ffi.AMB_EXTENSION_REPEAT,
    "EXTEND": _ffi.AMB_EXTENSION_EDGE,
    "CLIP": _ffi.AMB_EXTENSION_CLIP,
    "MIRROR": _ffi.AMB_EXTENSION_MIRROR,
}


def upload(data: SceneData, scene: Scene) -> None:
    """Fills `scene`, which must be fresh: then the ids are the indices of `data`. Not committed."""
    textures: dict[TextureData, int] = {}
    for material in data.materials:
        add_material(scene, material, textures)
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


def add_texture(scene: Scene, texture: TextureData) -> int:
    closest = texture.is_closest
    return scene.add_texture(
        texture.name,
        texture.color,
        EXTENSIONS[texture.extension],
        _ffi.AMB_INTERPOLATION_CLOSEST if closest else _ffi.AMB_INTERPOLATION_LINEAR,
    )


def add_material(scene: Scene, material: MaterialData, textures: dict[TextureData, int]) -> int:
    """`textures`: ids of those that the scene has."""
    dielectric, placed = material.is_dielectric, material.texture
    fields: dict[str, object] = {}
    if placed is not None:
        if placed.texture not in textures:
            textures[placed.texture] = add_texture(scene, placed.texture)
        fields = {"texture": textures[placed.texture], "uv_to_texture": placed.to_texture}
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
        **fields,
    )


def add_mesh(scene: Scene, mesh: MeshData) -> int:
    domain = _ffi.AMB_NORMALS_NONE
    if mesh.normals is not None:
        corner = mesh.normals.ndim == 3
        domain = _ffi.AMB_NORMALS_CORNER if corner else _ffi.AMB_NORMALS_VERTEX
    return scene.add_mesh(
        mesh.name, mesh.positions, mesh.triangles, mesh.normals, domain, mesh.slots, mesh.uvs
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
