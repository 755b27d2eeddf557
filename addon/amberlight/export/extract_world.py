# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's world -> a constant radiance and an image of it, in Cycles' units and orientation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mathutils import Euler

from ..binding.handles import import_numpy
from . import conventions as conv
from .export_log import ExportLog
from .image_nodes import ImageReader, Texture, read_pixels
from .node_tree import Path, Source
from .scene_data import BLACK, RGB, WHITE, WorldImageData
from .tree_fingerprint import fingerprint

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

VISIBILITY = ("camera", "diffuse", "glossy", "transmission", "scatter")

Terms = tuple[RGB, list[Texture]]
NONE: Terms = (BLACK, [])

# What the user is asked to press.
BAKE = "Bake World (World properties)"


def read_world(
    world: Any, version: conv.Version, log: ExportLog, frame: int = 0
) -> tuple[RGB, WorldImageData | None]:
    """Radiance of the surroundings: constant where there is no image, else in the image. `frame`:
    that of the scene, for a world whose nodes were baked."""
    if world is None:
        return BLACK, None
    where = place(world)
    visibility = getattr(world, "cycles_visibility", None)
    if not all(getattr(visibility, name, True) for name in VISIBILITY):
        log.warn(where, "the ray visibility of the world is ignored")
    if not has_nodes(world, version):
        return (world.color[0], world.color[1], world.color[2]), None
    reader = _WorldReader(world.node_tree, where, log)
    constant, texture = reader.parts()
    settings = world.original.amberlight
    if reader.problems and settings.image is not None:
        if settings.fingerprint != fingerprint(world, frame):
            log.warn(where, f"what was baked of the world is out of date: {BAKE}")
        return BLACK, reader.baked(settings.image)
    for message, places in reader.problems.entries.items():
        for problem in places:
            log.warn(problem, message)
    if reader.problems:
        log.warn(where, f"{BAKE} lets Cycles evaluate nodes that are not understood")
    image = reader.image(texture, constant) if texture else None
    if isinstance(image, tuple):
        constant, image = image, None
    return _positive(constant), image


def is_understood(world: Any, version: conv.Version) -> bool:
    """Whether the world's nodes are rendered as they are without being baked."""
    if not has_nodes(world, version):
        return True
    reader = _WorldReader(world.node_tree, place(world), ExportLog())
    reader.parts()
    return not reader.problems


def has_nodes(world: Any, version: conv.Version) -> bool:
    return bool(world.node_tree) and (version >= (5, 0) or bool(world.use_nodes))


def place(world: Any) -> str:
    return f'world "{world.name}"'


class _WorldReader(ImageReader):
    """`problems`: what the nodes say and is not understood."""

    image_type = "TEX_ENVIRONMENT"

    def __init__(self, tree: Any, where: str, log: ExportLog) -> None:
        super().__init__(tree, where, log)
        self.problems = ExportLog()

    def warn(self, node: Any, message: str) -> None:
        self.problems.warn(self.named(node), message)

    def parts(self) -> tuple[RGB, Texture | None]:
        """The constant and the image that make up the surroundings."""
        output = self.output("OUTPUT_WORLD")
        if output is None:
            return BLACK, None
        if self.is_linked(output, "Volume"):
            self.note(output, "the volume of the world is ignored")
        constant, textures = self.terms(output.inputs["Surface"], ())
        for texture in textures[1:]:
            self.warn(texture.node, "a second image of the world is left out")
        if not textures:
            return constant, None
        if self.check_image(textures[0].node):
            self.rotation(textures[0])
            if textures[0].node.projection != "EQUIRECTANGULAR":
                self.warn(
                    textures[0].node, "mirror balls are not supported, the image's mean is used"
                )
        return constant, textures[0]

    # ---- Nodes -----------------------------------------------------------------------------------

    def terms(self, socket: Any, path: Path) -> Terms:
        """Sum of the Emission and Background nodes behind a shader socket."""
        source = self.source(socket, path)
        return self.once("terms", source, self.read_terms) if source.node is not None else NONE

    def read_terms(self, node: Any, path: Path) -> Terms:
        if node.type == "ADD_SHADER":
            return _sum([(1.0, self.terms(inner, path)) for inner in node.inputs[:2]])
        if node.type == "MIX_SHADER":
            factor = min(max(self.number(node, node.inputs[0].name, path), 0.0), 1.0)
            return _sum(
                [
                    (1.0 - factor, self.terms(node.inputs[1], path)),
                    (factor, self.terms(node.inputs[2], path)),
                ]
            )
        if node.type in {"EMISSION", "BACKGROUND"}:
            strength = self.number(node, "Strength", path)
            return _sum([(strength, self.colors(node, "Color", path))])
        self.warn(node, f"{node.bl_label} is not understood in a world, white is used")
        return WHITE, []

    def colors(self, node: Any, name: str, path: Path) -> Terms:
        """A colour socket: a constant, or a texture, which a constant may multiply."""
        texture = self.texture(node, name, path)
        if texture is not None:
            return BLACK, [texture]
        return self.color(node, name, path), []

    def rotation(self, texture: Texture) -> tuple[tuple[float, ...], ...]:
        """Of the image's axes in the world, from a Mapping node."""
        source = self.source(texture.node.inputs["Vector"], texture.path)
        node, path = source.node, source.path
        if node is None or _is_direction(source):
            return IDENTITY
        if node.type != "MAPPING":
            self.warn(node, f"{node.bl_label} is not understood as a direction of the world")
            return IDENTITY
        inner = self.source(node.inputs["Vector"], path)
        if not _is_direction(inner):
            self.warn(node, "its vector is taken as the direction of the world")
        scale = self.color(node, "Scale", path)
        if max(scale) - min(scale) > 1e-5 * max(map(abs, scale)) or min(scale) <= 0.0:
            self.warn(node, "its scale is ignored")
        if node.vector_type in {"POINT", "TEXTURE"} and any(self.color(node, "Location", path)):
            self.warn(node, "its location is ignored")
        matrix = Euler(self.color(node, "Rotation", path), "XYZ").to_matrix()
        # A point is turned by the matrix, a texture against it: of what is looked up that is the
        # other way round.
        if node.vector_type != "TEXTURE":
            matrix = matrix.transposed()
        return tuple(tuple(row) for row in matrix)

    # ---- Pixels ----------------------------------------------------------------------------------

    def image(self, texture: Texture, constant: RGB) -> WorldImageData | RGB:
        """The radiance image; or its mean, with the constant, where it cannot be one."""
        node = texture.node
        pixels = self.pixels(node)
        if pixels is None:
            return constant
        np = import_numpy()
        radiance = pixels * np.array(texture.factor, np.float32) + np.array(constant, np.float32)
        radiance = self.limited(radiance, self.named(node))
        if node.projection != "EQUIRECTANGULAR":
            mean = radiance.mean(axis=(0, 1), dtype=np.float64)
            return (float(mean[0]), float(mean[1]), float(mean[2]))
        return WorldImageData(radiance, self.rotation(texture))

    def baked(self, image: Any) -> WorldImageData:
        return WorldImageData(self.limited(read_pixels(image), self.where), IDENTITY)

    def limited(self, radiance: NDArray[np.float32], where: str) -> NDArray[np.float32]:
        """What a renderer can sample: finite, and not negative."""
        np = import_numpy()
        finite = np.isfinite(radiance)
        if not finite.all():
            self.log.warn(where, "pixels that are not finite are limited to the largest one")
            largest = radiance[finite].max() if finite.any() else 0.0
            radiance = np.nan_to_num(radiance, nan=0.0, posinf=largest, neginf=0.0)
        return np.maximum(radiance, 0.0).astype(np.float32, copy=False)


def _sum(parts: list[tuple[float, Terms]]) -> Terms:
    """Weighted sum of terms; a texture that is met again counts once, with both factors."""
    constant, textures = BLACK, dict[tuple[Any, Path], RGB]()
    for weight, (color, inner) in parts:
        constant = conv.added(constant, conv.scaled(color, weight))
        for texture in inner if weight > 0.0 else ():
            key = (texture.node, texture.path)
            factor = conv.scaled(texture.factor, weight)
            textures[key] = conv.added(textures.get(key, BLACK), factor)
    return constant, [Texture(*key, factor) for key, factor in textures.items()]


def _is_direction(source: Source) -> bool:
    """In a world the generated coordinates are the direction itself, as is no link at all."""
    return (
        source.node is not None
        and source.node.type == "TEX_COORD"
        and source.socket.name == "Generated"
    )


def _positive(color: RGB) -> RGB:
    return (max(color[0], 0.0), max(color[1], 0.0), max(color[2], 0.0))
