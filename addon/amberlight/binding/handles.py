# SPDX-License-Identifier: GPL-3.0-or-later
"""Scene and Render: context managers that own one pointer each.

Closing twice is allowed. A scene closes its renders before itself, in the order that the library
demands. A handle that is only garbage-collected closes too, with a ResourceWarning.
"""

from __future__ import annotations

import ctypes
import json
import os
import warnings
import weakref
from collections.abc import Sequence
from ctypes import POINTER, byref, c_float, c_int32, c_uint32, c_uint64
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any, TypeVar

from . import _ffi
from .errors import AmberlightError, AmbStateError
from .library import Library

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Self = TypeVar("Self", bound="_Handle")


def import_numpy() -> Any:
    """numpy, or a sentence that says how to get it: Debian's Blender only recommends it."""
    try:
        import numpy
    except ImportError as error:
        raise AmberlightError(
            "Blender's Python has no numpy, which Amberlight needs: install python3-numpy"
        ) from error
    return numpy


@dataclass(frozen=True)
class Progress:
    """State of a render: `fraction` in [0,1], `elapsed` seconds, camera samples per pixel done,
    the relative `error` as it is stated so far (0: not estimated), seconds that `remain` (< 0:
    unknown). Every `pixel_step`-th pixel of a row and of a column has a sample (0: none)."""

    state: int
    fraction: float
    elapsed: float
    samples_done: int
    stage: str
    detail: str
    error: float = 0.0
    remaining: float = -1.0
    pixel_step: int = 0


class _Handle:
    """Owner of one pointer; subclasses say how to destroy it."""

    def __init__(self, library: Library) -> None:
        self._lib = library
        self._ptr = ctypes.c_void_p()

    def _destroy(self) -> None:
        raise NotImplementedError

    @property
    def pointer(self) -> ctypes.c_void_p:
        if not self._ptr:
            raise AmbStateError(f"the {type(self).__name__.lower()} is closed")
        return self._ptr

    @property
    def is_closed(self) -> bool:
        return not self._ptr

    def close(self) -> None:
        if self._ptr:
            self._destroy()
            self._ptr = ctypes.c_void_p()

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def __del__(self) -> None:
        # The constructor may have failed before the pointer existed.
        if getattr(self, "_ptr", None):
            warnings.warn(f"unclosed {type(self).__name__}", ResourceWarning, stacklevel=2)
            self.close()


class Scene(_Handle):
    """What is to be rendered; ids returned by add_* count from 0, those of textures from 1."""

    def __init__(self, library: Library) -> None:
        super().__init__(library)
        self._renders: weakref.WeakSet[Render] = weakref.WeakSet()
        library.amb_scene_create(byref(self._ptr))

    def _destroy(self) -> None:
        for render in list(self._renders):
            render.close()
        self._lib.amb_scene_destroy(self._ptr)

    def add_texture(
        self, name: str, color: NDArray[np.float32], extension: int, interpolation: int
    ) -> int:
        """color: (height, width, 3) float32, scene-linear, in [0,1], row 0 at the bottom;
        extension, interpolation: AMB_EXTENSION_*, AMB_INTERPOLATION_*. Copied by the library."""
        np = import_numpy()
        pixels = _array(np, color, np.float32, (None, None, 3), "color")
        texture = _ffi.AmbTexture()
        self._lib.amb_texture_init(byref(texture))
        texture.name = name.encode()
        texture.height, texture.width = pixels.shape[:2]
        texture.extension, texture.interpolation = extension, interpolation
        texture.color = pixels.ctypes.data_as(POINTER(c_float))
        return self._add(self._lib.amb_scene_add_texture, texture)

    def add_material(
        self,
        name: str,
        *,
        lobes: Sequence[tuple[Sequence[float], float]] = (),
        **fields: Any,
    ) -> int:
        """`lobes`: (sigma_s RGB in 1/m, g); `fields`: the other members of AmbMaterial."""
        material = _ffi.AmbMaterial()
        self._lib.amb_material_init(byref(material))
        material.name = name.encode()
        _assign(material, fields)
        # Beyond the array's end only the count is set, and the library refuses it.
        material.lobe_count = len(lobes)
        for lobe, (sigma_s, g) in zip(material.lobes, lobes, strict=False):
            lobe.sigma_s[:] = list(map(float, sigma_s))
            lobe.g = g
        return self._add(self._lib.amb_scene_add_material, material)

    def add_mesh(
        self,
        name: str,
        positions: NDArray[np.float32],
        triangles: NDArray[np.uint32],
        normals: NDArray[np.float32] | None = None,
        normal_domain: int = _ffi.AMB_NORMALS_NONE,
        slots: NDArray[np.uint32] | None = None,
        uvs: NDArray[np.float32] | None = None,
    ) -> int:
        """positions: (n, 3) float32; triangles: (m, 3) uint32; normals: (n, 3) or (m, 3, 3)
        float32 as `normal_domain` says; slots: (m,) uint32; uvs: (m, 3, 2) float32. Copied by the
        library."""
        np = import_numpy()
        keep = [
            _array(np, positions, np.float32, (None, 3), "positions"),
            _array(np, triangles, np.uint32, (None, 3), "triangles"),
        ]
        vertex_count, triangle_count = len(keep[0]), len(keep[1])
        mesh = _ffi.AmbMesh()
        self._lib.amb_mesh_init(byref(mesh))
        mesh.name = name.encode()
        mesh.positions = keep[0].ctypes.data_as(POINTER(c_float))
        mesh.triangles = keep[1].ctypes.data_as(POINTER(c_uint32))
        mesh.vertex_count = vertex_count
        mesh.triangle_count = triangle_count
        if normals is not None and normal_domain != _ffi.AMB_NORMALS_NONE:
            corner = normal_domain == _ffi.AMB_NORMALS_CORNER
            shape = (triangle_count, 3, 3) if corner else (vertex_count, 3)
            keep.append(_array(np, normals, np.float32, shape, "normals"))
            mesh.normals = keep[-1].ctypes.data_as(POINTER(c_float))
            mesh.normal_domain = normal_domain
        if slots is not None:
            keep.append(_array(np, slots, np.uint32, (triangle_count,), "slots"))
            mesh.slots = keep[-1].ctypes.data_as(POINTER(c_uint32))
        if uvs is not None:
            keep.append(_array(np, uvs, np.float32, (triangle_count, 3, 2), "uvs"))
            mesh.uvs = keep[-1].ctypes.data_as(POINTER(c_float))
        return self._add(self._lib.amb_scene_add_mesh, mesh)

    def add_object(
        self, name: str, mesh: int, to_world: Sequence[Sequence[float]], materials: Sequence[int]
    ) -> int:
        """to_world: (4, 4), row-major; materials: ids, one for each slot of the mesh."""
        placed = _ffi.AmbObject()
        self._lib.amb_object_init(byref(placed))
        placed.name = name.encode()
        placed.mesh = mesh
        placed.to_world[:] = _flat(to_world)
        placed.materials = (c_uint32 * len(materials))(*materials)
        placed.material_count = len(materials)
        return self._add(self._lib.amb_scene_add_object, placed)

    def add_light(self, kind: int, name: str, **fields: Any) -> int:
        """`fields`: members of AmbLight."""
        light = _ffi.AmbLight()
        self._lib.amb_light_init(byref(light), kind)
        light.name = name.encode()
        _assign(light, fields)
        return self._add(self._lib.amb_scene_add_light, light)

    def set_world(self, radiance: Sequence[float]) -> None:
        """radiance: RGB, W m^-2 sr^-1."""
        self._lib.amb_scene_set_world(self.pointer, (c_float * 3)(*map(float, radiance)))

    def set_world_image(
        self, radiance: NDArray[np.float32], to_world: Sequence[Sequence[float]]
    ) -> None:
        """radiance: (height, width, 3) float32, row 0 at the bottom; to_world: (3, 3), of the
        image's axes. Copied by the library."""
        np = import_numpy()
        pixels = _array(np, radiance, np.float32, (None, None, 3), "radiance")
        image = _ffi.AmbWorldImage()
        self._lib.amb_world_image_init(byref(image))
        image.height, image.width = pixels.shape[:2]
        image.to_world[:] = [float(value) for row in to_world for value in row]
        image.radiance = pixels.ctypes.data_as(POINTER(c_float))
        self._lib.amb_scene_set_world_image(self.pointer, byref(image))

    def set_camera(self, kind: int, to_world: Sequence[Sequence[float]], **fields: Any) -> None:
        """to_world: (4, 4), row-major; `fields`: the other members of AmbCamera. Allowed after the
        commit too, while no render of the scene is open."""
        camera = _ffi.AmbCamera()
        self._lib.amb_camera_init(byref(camera), kind)
        camera.to_world[:] = _flat(to_world)
        _assign(camera, fields)
        self._lib.amb_scene_set_camera(self.pointer, byref(camera))

    def commit(self) -> None:
        """Checks the whole and freezes it."""
        self._lib.amb_scene_commit(self.pointer)

    def explain(self, **params: Any) -> dict[str, Any]:
        """The plan of a render that is not started; `params`: members of AmbRenderParams."""
        settings = _ffi.AmbRenderParams()
        self._lib.amb_render_params_init(byref(settings))
        _assign(settings, params)
        size = c_uint64(1 << 14)
        while True:
            # A second call plans again, to the same text.
            room = size.value
            buffer = ctypes.create_string_buffer(room)
            self._lib.amb_plan_explain(self.pointer, byref(settings), buffer, room, byref(size))
            if size.value <= room:
                return dict(json.loads(buffer.value.decode("utf-8", "replace")))

    def start(self, **params: Any) -> Render:
        """Starts a render; `params`: members of AmbRenderParams."""
        return Render(self, **params)

    def _add(self, function: Any, struct: ctypes.Structure) -> int:
        out_id = c_uint32()
        function(self.pointer, byref(struct), byref(out_id))
        return out_id.value


class Render(_Handle):
    """A running or ended render of a committed scene."""

    def __init__(self, scene: Scene, **params: Any) -> None:
        super().__init__(scene._lib)
        # The reference keeps the scene alive as long as its render.
        self._scene = scene
        self.params = _ffi.AmbRenderParams()
        self._lib.amb_render_params_init(byref(self.params))
        _assign(self.params, params)
        self._lib.amb_render_start(scene.pointer, byref(self.params), byref(self._ptr))
        scene._renders.add(self)

    def _destroy(self) -> None:
        self._lib.amb_render_destroy(self._ptr)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the rendered rectangle, pixels."""
        p = self.params
        return (p.crop_width, p.crop_height) if p.crop_width else (p.width, p.height)

    def progress(self) -> Progress:
        info = _ffi.AmbProgress()
        self._lib.amb_progress_init(byref(info))
        self._lib.amb_render_progress(self.pointer, byref(info))
        return Progress(
            info.state,
            info.fraction,
            info.elapsed,
            info.samples_done,
            info.stage.decode("utf-8", "replace"),
            info.detail.decode("utf-8", "replace"),
            info.error,
            info.remaining,
            info.pixel_step,
        )

    def wait(self, timeout: float = -1.0) -> bool:
        """True once the render has ended well; raises its error, AmbCancelled after a cancel.

        timeout in seconds, negative for no limit. Other Python threads run meanwhile.
        """
        ended = c_int32()
        self._lib.amb_render_wait(self.pointer, timeout, byref(ended))
        return bool(ended.value)

    def cancel(self) -> None:
        self._lib.amb_render_cancel(self.pointer)

    def channels(self, name: str) -> int:
        count = c_uint32()
        self._lib.amb_render_pass_channels(self.pointer, name.encode(), byref(count))
        return count.value

    def read_pass(self, name: str) -> NDArray[np.float32]:
        """(height, width, channels) float32 of the rendered rectangle, row 0 at the bottom."""
        np = import_numpy()
        width, height = self.size
        pixels = np.empty((height, width, self.channels(name)), np.float32)
        self._lib.amb_render_read_pass(
            self.pointer, name.encode(), pixels.ctypes.data_as(POINTER(c_float)), pixels.size
        )
        return pixels  # type: ignore[no-any-return]

    def report_text(self) -> str:
        """The report of an ended render, JSON."""
        size = c_uint64()
        self._lib.amb_render_report(self.pointer, None, 0, byref(size))
        buffer = ctypes.create_string_buffer(size.value)
        self._lib.amb_render_report(self.pointer, buffer, size.value, byref(size))
        return buffer.value.decode("utf-8", "replace")

    def report(self) -> dict[str, Any]:
        return dict(json.loads(self.report_text()))

    def write_exr(self, path: str | os.PathLike[str], layer: str) -> None:
        """All passes into one OpenEXR file, channels "layer.Pass.R"."""
        self._lib.amb_render_write_exr(self.pointer, os.fsencode(path), layer.encode())


def _assign(struct: ctypes.Structure, fields: dict[str, Any]) -> None:
    """Sets members by name; a name that the struct lacks is a TypeError, not a new attribute."""
    names = {field[0] for field in struct._fields_}
    for name, value in fields.items():
        if name not in names:
            raise TypeError(f"{type(struct).__name__} has no field {name!r}")
        member = getattr(struct, name)
        if isinstance(member, ctypes.Array):
            values = [float(item) for item in value]
            if len(values) != len(member):
                raise ValueError(f"{name} needs {len(member)} values, got {len(values)}")
            member[:] = values
        else:
            setattr(struct, name, value)


def _flat(matrix: Sequence[Sequence[float]]) -> list[float]:
    values = [float(value) for row in matrix for value in row]
    if len(values) != 16:
        raise ValueError(f"a 4x4 matrix is needed, got {len(values)} values")
    return values


def _array(np: Any, array: Any, dtype: Any, shape: tuple[int | None, ...], what: str) -> Any:
    """`array` as C-contiguous `dtype`, its shape checked: the library trusts the counts."""
    array = np.ascontiguousarray(array, dtype)
    if len(array.shape) != len(shape) or any(
        want is not None and got != want for got, want in zip(array.shape, shape, strict=True)
    ):
        raise ValueError(f"{what} has shape {array.shape}, needed {shape}")
    return array
