# SPDX-License-Identifier: GPL-3.0-or-later
"""Material node trees -> MaterialData, with Cycles' meaning of every socket.

A surface becomes one of the library's two boundaries. What mixes several is reduced to the part
that matters most for translucency, and said so; a volume is summed exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from ..binding.handles import import_numpy
from . import conventions as conv
from .export_log import ExportLog
from .image_nodes import ImageReader, Texture
from .node_tree import Path
from .scene_data import (
    BLACK,
    RGB,
    WHITE,
    MaterialData,
    MediumData,
    PhaseLobe,
    TextureData,
    UVTexture,
)

DEFAULT_MATERIAL = MaterialData(name="Default")

Medium = tuple[RGB, tuple[PhaseLobe, ...]]

# Images by pointer, extension and whether their pixels have edges; None: cannot be read.
Textures = dict[tuple[int, str, bool], TextureData | None]

# Rank of a boundary when shaders are mixed: the refractive one makes the object translucent.
DIFFUSE, CLEAR, REFRACTIVE = 0, 1, 2


@dataclass(frozen=True)
class Surface:
    """One term of a surface shader, and its weight in the mix. `albedo` and `emission` of diffuse
    terms carry no weight yet; transmit and reflect colours belong to the other ranks."""

    node: Any
    rank: int
    weight: float = 1.0
    albedo: RGB = BLACK
    texture: Texture | None = None  # multiplies the albedo
    emission: RGB = BLACK
    transmit_color: RGB = WHITE
    reflect_color: RGB = WHITE
    ior: float = 1.0


def read_material(
    material: Any, where: str, version: conv.Version, log: ExportLog, textures: Textures
) -> MaterialData:
    """`material`: an evaluated bpy Material or None; `where` names its first user; `textures`:
    images that were read for other materials."""
    if material is None:
        return DEFAULT_MATERIAL
    name = material.name
    # Since 5.0 every material has nodes, and asking is deprecated.
    has_nodes = material.node_tree and (version >= (5, 0) or material.use_nodes)
    if not has_nodes:
        color = material.diffuse_color
        return MaterialData(name, albedo=(color[0], color[1], color[2]))
    where = f'{where}, material "{name}"'
    reader = _MaterialReader(material.node_tree, where, version, log, textures)
    # Nothing of ours is there where only the exporter runs.
    priority = getattr(getattr(material.original, "amberlight", None), "priority", 0)
    return replace(reader.read(), name=name, priority=priority)


class _MaterialReader(ImageReader):
    image_type = "TEX_IMAGE"

    def __init__(
        self, tree: Any, where: str, version: conv.Version, log: ExportLog, textures: Textures
    ) -> None:
        super().__init__(tree, where, log)
        self.version = version
        self.textures = textures

    def read(self) -> MaterialData:
        output = self.output("OUTPUT_MATERIAL")
        if output is None:
            self.warn(None, "the material has no output node, it is rendered black")
            return MaterialData("", albedo=BLACK)
        if self.is_linked(output, "Displacement"):
            self.warn(output, "displacement is ignored")
        medium = self.medium(output)
        surface = self.surface(output)
        if surface is None:
            # As in Cycles, a volume without a surface has no boundary to light.
            if self.source(output.inputs["Volume"]).node is not None:
                return MaterialData("", is_dielectric=True, medium=medium)
            self.warn(output, "nothing that is understood is connected, it is rendered black")
            return MaterialData("", albedo=BLACK)
        if surface.rank == DIFFUSE:
            if medium.lobes or any(medium.sigma_a):
                self.warn(surface.node, "the volume lies behind an opaque surface and is not seen")
            return self.opaque(surface)
        return MaterialData(
            "",
            is_dielectric=True,
            transmit_color=surface.transmit_color,
            reflect_color=surface.reflect_color,
            ior=surface.ior,
            medium=medium,
        )

    # ---- Images ----------------------------------------------------------------------------------

    def opaque(self, surface: Surface) -> MaterialData:
        plain = MaterialData("", albedo=surface.albedo, emission=surface.emission)
        if surface.texture is None:
            return plain
        texture = surface.texture
        placement, data = self.placement(texture), self.texture_data(texture.node)
        if data is None:
            return plain
        if placement is None:
            self.warn(texture.node, "is not placed by a UV map, its mean is used")
            return replace(plain, albedo=_limited(conv.added(surface.albedo, self.mean(texture))))
        factor = texture.factor
        if any(surface.albedo) or factor != _limited(factor):
            # What adds to the image is a part of it.
            np = import_numpy()
            color = data.color * np.array(factor, np.float32) + np.array(surface.albedo, np.float32)
            data, factor = replace(data, color=np.clip(color, 0.0, 1.0)), WHITE
        return replace(plain, albedo=factor, texture=UVTexture(data, *placement))

    def mean(self, texture: Texture) -> RGB:
        data = self.texture_data(texture.node)
        if data is None:
            return BLACK
        mean = data.color.mean(axis=(0, 1), dtype=float)
        return conv.multiplied(texture.factor, (float(mean[0]), float(mean[1]), float(mean[2])))

    def texture_data(self, node: Any) -> TextureData | None:
        """Read once for all materials that show the image."""
        closest = node.interpolation == "Closest"
        pointer = node.image.as_pointer() if node.image else 0
        key = (pointer, node.extension, closest)
        if key not in self.textures:
            self.textures[key] = self.read_texture(node, is_closest=closest)
        return self.textures[key]

    def read_texture(self, node: Any, *, is_closest: bool) -> TextureData | None:
        if node.projection != "FLAT":
            self.warn(node, f"its {node.projection.lower()} projection is rendered as flat")
        pixels = self.pixels(node)
        if pixels is None:
            return None
        np = import_numpy()
        limited = np.clip(np.nan_to_num(pixels), 0.0, 1.0)
        if not (limited == pixels).all():
            self.warn(node, "pixels are limited to the range from 0 to 1")
        return TextureData(node.image.name, limited, node.extension, is_closest)

    # ---- Surface ---------------------------------------------------------------------------------

    def surface(self, output: Any) -> Surface | None:
        """The terms of the surface reduced to one, or None without any."""
        terms = [
            replace(term, weight=weight)
            for term, weight in self.surface_terms(output.inputs["Surface"], ())
        ]
        if not terms:
            return None
        if all(term.rank == DIFFUSE for term in terms):
            # A mixture of Lambertian and emitting surfaces is one, exactly.
            albedo = emission = BLACK
            textures: list[Texture] = []
            for term in terms:
                if term.texture and term.weight > 0.0:
                    textures.append(term.texture.scaled(term.weight))
                albedo = conv.added(albedo, conv.scaled(term.albedo, term.weight))
                emission = conv.added(emission, conv.scaled(term.emission, term.weight))
            capped = _limited(albedo)
            if capped != albedo:
                self.warn(terms[0].node, "reflects more light than it gets, limited to white")
            for texture in textures[1:]:
                self.warn(texture.node, "of a mix of images one is seen, and the mean of others")
                capped = conv.added(capped, self.mean(texture))
            texture = textures[0] if textures else None
            return replace(terms[0], albedo=capped, emission=emission, texture=texture)
        best = max(terms, key=lambda term: (term.rank, term.weight))
        lost = [term.node.name for term in terms if term is not best]
        if lost:
            self.warn(best.node, f"alone stands for a mix of surfaces, without {', '.join(lost)}")
        return best

    def surface_terms(self, socket: Any, path: Path) -> list[tuple[Surface, float]]:
        """The surfaces that the shader behind `socket` mixes, each once, with their weights."""
        source = self.source(socket, path)
        return self.once("surface", source, self.read_surface) if source.node is not None else []

    def read_surface(self, node: Any, path: Path) -> list[tuple[Surface, float]]:
        if node.type in {"MIX_SHADER", "ADD_SHADER"}:
            # A surface that is met again is the same object.
            found: dict[int, tuple[Surface, float]] = {}
            for inner, share in self.shares(node, path):
                for term, weight in self.surface_terms(inner, path) if share > 0.0 else ():
                    _, before = found.get(id(term), (term, 0.0))
                    found[id(term)] = (term, before + share * weight)
            return list(found.values())
        read = self.SURFACES.get(node.type)
        if read is None:
            name = next((n for n in ("Color", "Base Color") if node.inputs.get(n)), None)
            self.warn(node, f"{node.bl_label} is not understood, rendered as diffuse")
            albedo, texture = self.albedo(node, name, path) if name else ((0.8, 0.8, 0.8), None)
            return [(Surface(node, DIFFUSE, albedo=albedo, texture=texture), 1.0)]
        return [(read(self, node, path), 1.0)]

    def shares(self, node: Any, path: Path) -> list[tuple[Any, float]]:
        """The two shader inputs of a Mix or Add node with their weights."""
        if node.type == "ADD_SHADER":
            return [(node.inputs[0], 1.0), (node.inputs[1], 1.0)]
        factor = min(max(self.number(node, node.inputs[0].name, path), 0.0), 1.0)
        return [(node.inputs[1], 1.0 - factor), (node.inputs[2], factor)]

    def check_details(self, node: Any, path: Path, *, boundary: bool) -> None:
        """Names the options of a surface node that have no counterpart here."""
        for name in ("Normal", "Coat Normal", "Clearcoat Normal"):
            if self.is_linked(node, name):
                self.warn(node, f'input "{name}" is ignored')
        if boundary and getattr(node, "distribution", "SHARP") != "SHARP":
            if self.number(node, "Roughness", path) > 0.0:
                self.warn(node, "a rough refractive surface is rendered as smooth")
        if node.inputs.get("Thin Film Thickness") and (
            self.is_linked(node, "Thin Film Thickness")
            or self.number(node, "Thin Film Thickness", path) > 0.0
        ):
            self.warn(node, "the thin film is ignored")

    def glass(self, node: Any, path: Path) -> Surface:
        self.check_details(node, path, boundary=True)
        color = self.boundary_color(node, "Color", path)
        ior = self.number(node, "IOR", path)
        return Surface(node, REFRACTIVE, transmit_color=color, reflect_color=color, ior=ior)

    def refraction(self, node: Any, path: Path) -> Surface:
        return replace(self.glass(node, path), reflect_color=BLACK)

    def transparent(self, node: Any, path: Path) -> Surface:
        return Surface(node, CLEAR, transmit_color=self.boundary_color(node, "Color", path))

    def diffuse(self, node: Any, path: Path) -> Surface:
        self.check_details(node, path, boundary=False)
        if self.number(node, "Roughness", path) > 0.0:
            self.warn(node, "a rough diffuse surface is rendered as Lambertian")
        albedo, texture = self.albedo(node, "Color", path)
        return Surface(node, DIFFUSE, albedo=albedo, texture=texture)

    def emission(self, node: Any, path: Path) -> Surface:
        strength = self.number(node, "Strength", path)
        return Surface(
            node,
            DIFFUSE,
            emission=_positive(conv.scaled(self.color(node, "Color", path), strength)),
        )

    def principled(self, node: Any, path: Path) -> Surface:
        transmission = self.number(
            node, self.first(node, "Transmission Weight", "Transmission"), path
        )
        boundary = transmission >= 0.5
        self.check_details(node, path, boundary=False)
        if 0.0 < transmission < 1.0:
            side = "all" if boundary else "no"
            self.warn(node, f"partial transmission is rendered as {side} transmission")
        for names, what in self.PRINCIPLED_EXTRAS:
            name = self.first(node, *names)
            if name and self.number(node, name, path) > 0.0:
                self.warn(node, f"{what} is ignored")
        if self.number(node, "Alpha", path) < 1.0:
            self.warn(node, "alpha is ignored")
        if node.inputs.get("Thin Wall") and self.number(node, "Thin Wall", path) > 0.0:
            self.warn(node, "a thin wall is rendered as a solid")
        emission_color = self.first(node, "Emission Color", "Emission")
        strength = self.number(node, "Emission Strength", path)
        emission = BLACK
        if strength > 0.0:
            emission = _positive(conv.scaled(self.color(node, emission_color, path), strength))
        if boundary:
            if self.number(node, "Roughness", path) > 0.0:
                self.warn(node, "a rough refractive surface is rendered as smooth")
            if any(emission):
                self.warn(node, "the emission of a refractive surface is ignored")
            base = self.boundary_color(node, "Base Color", path)
            return Surface(
                node,
                REFRACTIVE,
                transmit_color=conv.principled_transmit_color(base, self.version),
                ior=self.number(node, "IOR", path),
            )
        specular = self.first(node, "Specular IOR Level", "Specular")
        if self.number(node, "Roughness", path) < 0.2 and self.number(node, specular, path) > 0.0:
            self.warn(node, "the gloss of an opaque surface is ignored")
        albedo, texture = self.albedo(node, "Base Color", path)
        return Surface(node, DIFFUSE, albedo=albedo, texture=texture, emission=emission)

    def boundary_color(self, node: Any, name: str, path: Path) -> RGB:
        """A tint in [0,1]: more would create energy at every crossing."""
        return self.limited(node, name, path)

    def albedo(self, node: Any, name: str, path: Path) -> tuple[RGB, Texture | None]:
        """A constant, or nothing and an image."""
        texture = self.texture(node, name, path)
        if texture is not None and texture.node.image is not None:
            return BLACK, texture
        return self.limited(node, name, path), None

    def limited(self, node: Any, name: str, path: Path) -> RGB:
        color = self.color(node, name, path)
        limited = _limited(color)
        if limited != color:
            self.warn(node, f'input "{name}" is limited to the range from 0 to 1')
        return limited

    @staticmethod
    def first(node: Any, *names: str) -> str:
        """The name that this version of Blender gives to an input; "" if it has none."""
        return next((name for name in names if node.inputs.get(name)), "")

    PRINCIPLED_EXTRAS = (
        (("Metallic",), "metallic reflection"),
        (("Subsurface Weight", "Subsurface"), "subsurface scattering of the surface"),
        (("Coat Weight", "Clearcoat"), "the coat"),
        (("Sheen Weight", "Sheen"), "sheen"),
    )
    SURFACES = {
        "BSDF_GLASS": glass,
        "BSDF_REFRACTION": refraction,
        "BSDF_TRANSPARENT": transparent,
        "BSDF_DIFFUSE": diffuse,
        "BSDF_PRINCIPLED": principled,
        "EMISSION": emission,
    }

    # ---- Volume ----------------------------------------------------------------------------------

    def medium(self, output: Any) -> MediumData:
        sigma_a, lobes = self.volume_terms(output.inputs["Volume"], ())
        merged, approximate = conv.merge_lobes(lobes)
        if approximate:
            self.warn(output, f"more than {conv.LOBE_MAX} anisotropies, the nearest are merged")
        return MediumData(sigma_a, merged)

    def volume_terms(self, socket: Any, path: Path) -> Medium:
        """(sigma_a, lobes) of the shader tree behind `socket`."""
        source = self.source(socket, path)
        if source.node is None:
            return BLACK, ()
        return self.once("volume", source, self.read_volume)

    def read_volume(self, node: Any, path: Path) -> Medium:
        if node.type in {"MIX_SHADER", "ADD_SHADER"}:
            sigma_a: RGB = BLACK
            lobes: list[PhaseLobe] = []
            for inner, share in self.shares(node, path):
                if share > 0.0:
                    inner_a, inner_lobes = self.volume_terms(inner, path)
                    sigma_a = conv.added(sigma_a, conv.scaled(inner_a, share))
                    lobes += [PhaseLobe(conv.scaled(k.sigma_s, share), k.g) for k in inner_lobes]
            return sigma_a, conv.join_lobes(lobes)
        read = self.VOLUMES.get(node.type)
        if read is None:
            self.warn(node, f"{node.bl_label} is not understood in a volume and is ignored")
            return BLACK, ()
        sigma_a, sigma_s = read(self, node, path)
        return sigma_a, (PhaseLobe(sigma_s, self.anisotropy(node, path)),) if any(sigma_s) else ()

    def anisotropy(self, node: Any, path: Path) -> float:
        phase = getattr(node, "phase", "HENYEY_GREENSTEIN")
        # Rayleigh, Mie and Fournier-Forand have other parameters, and most often hide the socket.
        has_g = phase in {"HENYEY_GREENSTEIN", "DRAINE"}
        if phase != "HENYEY_GREENSTEIN":
            suffix = "" if has_g else " with g = 0"
            self.warn(node, f"the phase function is replaced by Henyey-Greenstein{suffix}")
        return conv.clamp_anisotropy(self.number(node, "Anisotropy", path)) if has_g else 0.0

    def volume_scatter(self, node: Any, path: Path) -> tuple[RGB, RGB]:
        color, density = self.color(node, "Color", path), self.number(node, "Density", path)
        return BLACK, conv.scatter_coefficient(color, density)

    def volume_absorption(self, node: Any, path: Path) -> tuple[RGB, RGB]:
        color, density = self.color(node, "Color", path), self.number(node, "Density", path)
        return conv.absorption_coefficient(color, density), BLACK

    def principled_volume(self, node: Any, path: Path) -> tuple[RGB, RGB]:
        color, density = self.color(node, "Color", path), self.number(node, "Density", path)
        tint = self.color(node, "Absorption Color", path)
        if self.number(node, "Emission Strength", path) > 0.0:
            self.warn(node, "the emission of a volume is ignored")
        if self.number(node, "Blackbody Intensity", path) > 0.0:
            self.warn(node, "the blackbody emission of a volume is ignored")
        return (
            conv.principled_absorption(color, tint, density),
            conv.scatter_coefficient(color, density),
        )

    def volume_coefficients(self, node: Any, path: Path) -> tuple[RGB, RGB]:
        # Coefficients straight in 1/m: a density of 1 in the scattering of the others.
        if any(self.color(node, "Emission Coefficients", path)):
            self.warn(node, "the emission of a volume is ignored")
        sigma_a = _positive(self.color(node, "Absorption Coefficients", path))
        return sigma_a, _positive(self.color(node, "Scatter Coefficients", path))

    VOLUMES = {
        "VOLUME_SCATTER": volume_scatter,
        "VOLUME_ABSORPTION": volume_absorption,
        "PRINCIPLED_VOLUME": principled_volume,
        "VOLUME_COEFFICIENTS": volume_coefficients,
    }


def _positive(color: RGB) -> RGB:
    return (max(color[0], 0.0), max(color[1], 0.0), max(color[2], 0.0))


def _limited(color: RGB) -> RGB:
    r, g, b = (min(max(part, 0.0), 1.0) for part in color)
    return (r, g, b)
