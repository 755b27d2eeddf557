# SPDX-License-Identifier: GPL-3.0-or-later
"""Image nodes of shader trees: their pixels, and the constants that multiply them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..binding.handles import import_numpy
from . import conventions as conv
from .node_tree import Path, Source, TreeReader
from .scene_data import RGB, WHITE

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

# Names of linear spaces, in which the numbers of 8-bit images mean what they say.
LINEAR = {"Non-Color", "Raw", "Linear", "Linear Rec.709"}


# Row-major 2x3: from coordinates of a mesh to places of an image.
Placement = tuple[float, float, float, float, float, float]
PLAIN: Placement = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)


@dataclass(frozen=True)
class Texture:
    """An image node and the factor on its colour."""

    node: Any
    path: Path
    factor: RGB

    def scaled(self, weight: float) -> Texture:
        return Texture(self.node, self.path, conv.scaled(self.factor, weight))


class ImageReader(TreeReader):
    """A tree in which nodes of type `image_type` show images."""

    image_type: str

    def texture(self, node: Any, name: str, path: Path) -> Texture | None:
        """The image behind a colour socket, which a constant may multiply; None: no image."""
        source = self.source(node.inputs[name], path)
        if source.node is None:
            return None
        if source.node.type == self.image_type:
            return Texture(source.node, source.path, WHITE)
        return self.product(source)

    def product(self, source: Source) -> Texture | None:
        """A Mix node that multiplies an image by a constant colour."""
        node, path = source.node, source.path
        if node.type not in {"MIX", "MIX_RGB"} or getattr(node, "blend_type", "") != "MULTIPLY":
            return None
        # The sockets of Mix have names in common, one for each type of data.
        sockets = [s for s in node.inputs if s.type == "RGBA"]
        factors = [s for s in node.inputs if s.type == "VALUE" and s.enabled]
        if len(sockets) != 2 or not factors or any(link for s in factors for link in s.links):
            return None
        share = min(max(float(factors[0].default_value), 0.0), 1.0)
        sources = [self.source(s, path) for s in sockets]
        for texture, other in (sources, sources[::-1]):
            if texture.node is None or texture.node.type != self.image_type:
                continue
            value = self._evaluate(other)
            if value is None or (share < 1.0 and texture is sources[1]):
                return None
            color = (value, value, value) if isinstance(value, float) else value
            factor = conv.added(conv.scaled(color, share), conv.scaled(WHITE, 1.0 - share))
            return Texture(texture.node, texture.path, factor)
        return None

    def placement(self, texture: Texture) -> tuple[str, Placement] | None:
        """Name of the mesh's coordinates that the image is placed by ("": those it renders with)
        and their way to it; None: not by such coordinates."""
        source = self.source(texture.node.inputs["Vector"], texture.path)
        if source.node is None or source.node.type != "MAPPING":
            name = _coordinates(source)
            return None if name is None else (name, PLAIN)
        node, path = source.node, source.path
        name = _coordinates(self.source(node.inputs["Vector"], path))
        if name is None or node.vector_type == "NORMAL":
            return None
        has_place = node.vector_type != "VECTOR"
        place = self.color(node, "Location", path) if has_place else (0.0, 0.0, 0.0)
        turn, scale = self.color(node, "Rotation", path), self.color(node, "Scale", path)
        return name, _mapping(place, turn, scale, is_inverse=node.vector_type == "TEXTURE")

    def check_image(self, node: Any) -> bool:
        """Whether the node's image can be read; names what is then not as it should be."""
        image = node.image
        if image is None:
            self.note(node, "it has no image and is left out")
            return False
        if image.source in {"SEQUENCE", "MOVIE", "TILED"}:
            kind = image.source.lower()
            self.warn(node, f"an image of kind {kind} is read as one image")
        width, height = image.size
        if width * height == 0 or len(image.pixels) < width * height:
            self.note(node, f'image "{image.name}" cannot be read and is left out')
            return False
        space = image.colorspace_settings.name
        if not (image.is_float or space in LINEAR or space == "sRGB"):
            self.warn(node, f'colour space "{space}" is taken as sRGB')
        return True

    def pixels(self, node: Any) -> NDArray[np.float32] | None:
        """(height, width, 3), scene-linear, row 0 at the bottom; None: it cannot be read."""
        return read_pixels(node.image) if self.check_image(node) else None


def read_pixels(image: Any) -> NDArray[np.float32]:
    """(height, width, 3), scene-linear, row 0 at the bottom."""
    np = import_numpy()
    width, height = image.size
    flat = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(flat)
    pixels = flat.reshape(height, width, -1)
    # One channel or two are grey, and alpha.
    pixels = pixels[..., :3] if pixels.shape[2] >= 3 else np.repeat(pixels[..., :1], 3, axis=2)
    # Blender holds images of floats in the scene's linear space, those of bytes as they are.
    if image.is_float or image.colorspace_settings.name in LINEAR:
        return pixels
    return conv.srgb_to_linear(pixels)  # type: ignore[no-any-return]


def _coordinates(source: Source) -> str | None:
    """A socket that is not linked has the coordinates that the mesh renders with."""
    node = source.node
    if node is None:
        return "" if source.socket is not None else None
    if node.type == "UVMAP":
        return str(node.uv_map)
    return "" if node.type == "TEX_COORD" and source.socket.name == "UV" else None


def _mapping(place: RGB, turn: RGB, scale: RGB, *, is_inverse: bool) -> Placement:
    """What a Mapping node does to (u, v, 0), as far as (x, y) see it: scaled, turned about x, y and
    z, moved; or all of that taken back."""
    (sx, sy, sz), (cx, cy, cz) = map(math.sin, turn), map(math.cos, turn)
    rows = (
        (cz * cy, cz * sy * sx - sz * cx),
        (sz * cy, sz * sy * sx + cz * cx),
        (-sy, cy * sx),
    )
    if not is_inverse:
        (a, b), (c, d) = rows[:2]
        return (a * scale[0], b * scale[1], place[0], c * scale[0], d * scale[1], place[1])
    # Cycles divides by 0 to 0.
    by = [1.0 / value if value else 0.0 for value in scale[:2]]
    moved = [-sum(rows[k][i] * place[k] for k in range(3)) for i in range(2)]
    (a, b), (c, d) = ((by[i] * rows[0][i], by[i] * rows[1][i]) for i in range(2))
    return (a, b, by[0] * moved[0], c, d, by[1] * moved[1])
