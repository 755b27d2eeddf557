# SPDX-License-Identifier: GPL-3.0-or-later
"""Material node trees -> MaterialData, with Cycles' meaning of every socket.

A surface becomes one of the library's two boundaries. What mixes several is reduced to the part
that matters most for translucency, and said so; a volume is summed exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from . import conventions as conv
from .export_log import ExportLog
from .node_tree import Path, TreeReader
from .scene_data import BLACK, RGB, WHITE, MaterialData, MediumData, PhaseLobe

DEFAULT_MATERIAL = MaterialData(name="Default")

Medium = tuple[RGB, tuple[PhaseLobe, ...]]

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
    emission: RGB = BLACK
    transmit_color: RGB = WHITE
    reflect_color: RGB = WHITE
    ior: float = 1.0


def read_material(material: Any, where: str, version: conv.Version, log: ExportLog) -> MaterialData:
    """`material`: an evaluated bpy Material or None; `where` names its first user."""
    if material is None:
        return DEFAULT_MATERIAL
    name = material.name
    # Since 5.0 every material has nodes, and asking is deprecated.
    has_nodes = material.node_tree and (version >= (5, 0) or material.use_nodes)
    if not has_nodes:
        color = material.diffuse_color
        return MaterialData(name, albedo=(color[0], color[1], color[2]))
    reader = _MaterialReader(material.node_tree, f'{where}, material "{name}"', version, log)
    # Nothing of ours is there where only the exporter runs.
    priority = getattr(getattr(material.original, "amberlight", None), "priority", 0)
    return replace(reader.read(), name=name, priority=priority)


class _MaterialReader(TreeReader):
    def __init__(self, tree: Any, where: str, version: conv.Version, log: ExportLog) -> None:
        super().__init__(tree, where, log)
        self.version = version

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
            return MaterialData("", albedo=surface.albedo, emission=surface.emission)
        return MaterialData(
            "",
            is_dielectric=True,
            transmit_color=surface.transmit_color,
            reflect_color=surface.reflect_color,
            ior=surface.ior,
            medium=medium,
        )

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
            for term in terms:
                albedo = conv.added(albedo, conv.scaled(term.albedo, term.weight))
                emission = conv.added(emission, conv.scaled(term.emission, term.weight))
            capped = (min(albedo[0], 1.0), min(albedo[1], 1.0), min(albedo[2], 1.0))
            if capped != albedo:
                self.warn(terms[0].node, "reflects more light than it gets, limited to white")
            return replace(terms[0], albedo=capped, emission=emission)
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
            albedo = self.color(node, name, path) if name else (0.8, 0.8, 0.8)
            self.warn(node, f"{node.bl_label} is not understood, rendered as diffuse")
            return [(Surface(node, DIFFUSE, albedo=albedo), 1.0)]
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
        return Surface(node, DIFFUSE, albedo=self.albedo(node, "Color", path))

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
        return Surface(
            node, DIFFUSE, albedo=self.albedo(node, "Base Color", path), emission=emission
        )

    def boundary_color(self, node: Any, name: str, path: Path) -> RGB:
        """A tint in [0,1]: more would create energy at every crossing."""
        return self.limited(node, name, path)

    def albedo(self, node: Any, name: str, path: Path) -> RGB:
        return self.limited(node, name, path)

    def limited(self, node: Any, name: str, path: Path) -> RGB:
        color = self.color(node, name, path)
        r, g, b = (min(max(c, 0.0), 1.0) for c in color)
        if (r, g, b) != color:
            self.warn(node, f'input "{name}" is limited to the range from 0 to 1')
        return (r, g, b)

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
