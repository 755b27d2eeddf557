# SPDX-License-Identifier: GPL-3.0-or-later
"""The exported scene as plain data: copies, so that nothing of Blender is needed any more.

Units: metres (scene units), radians, watts; colours are scene-linear RGB tuples. Indices count
from 0 into the lists of SceneData.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

RGB = tuple[float, float, float]
Vector = tuple[float, float, float]
Matrix = tuple[tuple[float, ...], ...]

BLACK: RGB = (0.0, 0.0, 0.0)
WHITE: RGB = (1.0, 1.0, 1.0)
IDENTITY: Matrix = (
    (1.0, 0.0, 0.0, 0.0),
    (0.0, 1.0, 0.0, 0.0),
    (0.0, 0.0, 1.0, 0.0),
    (0.0, 0.0, 0.0, 1.0),
)


@dataclass(frozen=True, eq=False)
class TextureData:
    """color: (height, width, 3) float32 in [0,1], scene-linear, row 0 at the bottom; extension:
    REPEAT, EXTEND, CLIP or MIRROR, as Blender names them."""

    name: str
    color: NDArray[np.float32]
    extension: str = "REPEAT"
    is_closest: bool = False


@dataclass(frozen=True)
class UVTexture:
    """A texture on a surface: it multiplies the albedo at to_texture (row-major 2x3) of the mesh's
    coordinates named `uv_map`; "": those that its mesh renders with."""

    texture: TextureData
    uv_map: str = ""
    to_texture: tuple[float, float, float, float, float, float] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)


@dataclass(frozen=True)
class PhaseLobe:
    """Henyey-Greenstein lobe: scattering coefficient (1/m) and mean cosine."""

    sigma_s: RGB
    g: float


@dataclass(frozen=True)
class MediumData:
    """Homogeneous medium: absorption coefficient (1/m) and its lobes."""

    sigma_a: RGB = BLACK
    lobes: tuple[PhaseLobe, ...] = ()


@dataclass(frozen=True)
class MaterialData:
    name: str
    is_dielectric: bool = False
    albedo: RGB = (0.8, 0.8, 0.8)
    emission: RGB = BLACK
    transmit_color: RGB = WHITE
    reflect_color: RGB = WHITE
    ior: float = 1.0
    medium: MediumData = MediumData()
    priority: int = 0
    texture: UVTexture | None = None


@dataclass(frozen=True, eq=False)
class MeshData:
    """positions: (n, 3) float32, object space; triangles: (m, 3) uint32; normals: None (flat),
    (n, 3) for vertices or (m, 3, 3) for corners, float32, unit; slots: (m,) uint32 or None; uvs:
    (m, 3, 2) float32 or None."""

    name: str
    positions: NDArray[np.float32]
    triangles: NDArray[np.uint32]
    normals: NDArray[np.float32] | None = None
    slots: NDArray[np.uint32] | None = None
    uvs: NDArray[np.float32] | None = None


@dataclass(frozen=True)
class ObjectData:
    """One placement of a mesh; to_world: 4x4, row-major; one material for each slot."""

    name: str
    mesh: int
    to_world: Matrix
    materials: tuple[int, ...]


@dataclass(frozen=True)
class LightData:
    """kind: POINT, SPOT, SUN or AREA; color as AmbLight of the library means it for each kind."""

    name: str
    kind: str
    color: RGB
    position: Vector = BLACK
    direction: Vector = (0.0, 0.0, -1.0)
    tangent: Vector = (1.0, 0.0, 0.0)
    radius: float = 0.0
    angle: float = 0.0
    spot_size: float = 0.0
    spot_blend: float = 0.0
    spot_cosine: float = 0.0
    size: tuple[float, float] = (1.0, 1.0)
    is_ellipse: bool = False


@dataclass(frozen=True)
class CameraData:
    """window: left, right, bottom, top at distance 1 (perspective) or in metres; +y up, looks
    along -z of to_world."""

    to_world: Matrix
    window: tuple[float, float, float, float]
    is_orthographic: bool = False
    clip_start: float = 0.1
    clip_end: float = 1000.0
    lens_radius: float = 0.0
    focus_distance: float = 0.0


@dataclass(frozen=True, eq=False)
class WorldImageData:
    """radiance: (height, width, 3) float32, equirectangular, row 0 at the bottom; to_world: 3x3,
    row-major, of the image's axes."""

    radiance: NDArray[np.float32]
    to_world: Matrix


@dataclass
class SceneData:
    materials: list[MaterialData] = field(default_factory=list)
    meshes: list[MeshData] = field(default_factory=list)
    objects: list[ObjectData] = field(default_factory=list)
    lights: list[LightData] = field(default_factory=list)
    world: RGB = BLACK
    world_image: WorldImageData | None = None
    camera: CameraData | None = None
