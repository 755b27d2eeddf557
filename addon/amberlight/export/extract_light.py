# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's lights -> LightData, in Cycles' units."""

from __future__ import annotations

import math
from typing import Any

from . import conventions as conv
from .export_log import ExportLog
from .node_tree import Path, TreeReader
from .scene_data import BLACK, RGB, WHITE, LightData


def read_light(
    light: Any, matrix: Any, where: str, version: conv.Version, log: ExportLog
) -> LightData | None:
    """`light`: evaluated bpy Light; `matrix`: its object's 4x4 world matrix. None if it is dark."""
    if getattr(getattr(light, "cycles", None), "is_portal", False):
        log.warn(where, "a portal is no light of its own and is left out")
        return None
    power = light.energy * 2.0 ** getattr(light, "exposure", 0.0)
    color = tuple(light.color)
    if getattr(light, "use_temperature", False):
        color = conv.multiplied(color, light.temperature_color)
    if light.node_tree and light.use_nodes:
        reader = TreeReader(light.node_tree, where, log)
        color = conv.multiplied(color, emission_of(reader, "OUTPUT_LIGHT", "light"))
    color = conv.scaled(color, power)
    if min(color) < 0.0:
        log.warn(where, "a light of negative power is left out")
        return None
    if not any(color):
        return None
    columns = list(zip(*(tuple(row) for row in matrix), strict=True))
    axis_x, axis_y, axis_z, position = (tuple(column[:3]) for column in columns)
    direction = (-axis_z[0], -axis_z[1], -axis_z[2])
    radius = 0.0 if light.type in {"SUN", "AREA"} else light.shadow_soft_size
    angle = light.angle if light.type == "SUN" else 0.0
    extent, shape = (0.0, 0.0), light.type
    if light.type == "AREA":
        size_y = light.size_y if light.shape in {"RECTANGLE", "ELLIPSE"} else light.size
        extent = (light.size * _length(axis_x), size_y * _length(axis_y))
        shape = "ELLIPSE" if light.shape in {"DISK", "ELLIPSE"} else "AREA"
    area = conv.light_area(shape, radius, angle, extent)
    if not getattr(light, "normalize", True):
        color = conv.scaled(color, area)
    if light.type == "AREA":
        if area <= 0.0:
            log.warn(where, "an area light of size zero is left out")
            return None
        if abs(light.spread - math.pi) > 1e-4:
            log.warn(where, "the spread of an area light is ignored")
        return LightData(
            light.name,
            "AREA",
            conv.scaled(color, conv.area_radiance(1.0, area, version)),
            position,
            direction,
            tangent=axis_x,
            size=extent,
            is_ellipse=shape == "ELLIPSE",
        )
    if light.type == "SUN":
        return LightData(light.name, "SUN", color, position, direction, angle=angle)
    if radius > 0.0 and not getattr(light, "use_soft_falloff", True):
        log.warn(where, "a light without soft falloff is rendered with it")
    color = conv.scaled(color, conv.point_intensity(1.0))
    if light.type == "POINT":
        return LightData(light.name, "POINT", color, position, radius=radius)
    lengths = [_length(axis) for axis in (axis_x, axis_y, axis_z)]
    if max(lengths) > 1.001 * min(lengths):
        log.warn(where, "the uneven scale of a spot light is ignored")
    return LightData(
        light.name,
        "SPOT",
        color,
        position,
        direction,
        radius=radius,
        spot_size=light.spot_size,
        spot_blend=light.spot_blend,
        spot_cosine=1.0 if conv.spot_has_cosine(version) else 0.0,
    )


def emission_of(reader: TreeReader, kind: str, what: str) -> RGB:
    """Sum of the Emission and Background nodes behind an output's Surface."""
    output = reader.output(kind)
    if output is None:
        return BLACK
    return _emission_terms(reader, output.inputs["Surface"], (), what)


def _emission_terms(reader: TreeReader, socket: Any, path: Path, what: str) -> RGB:
    def read(node: Any, path: Path) -> RGB:
        if node.type == "ADD_SHADER":
            a, b = (_emission_terms(reader, inner, path, what) for inner in node.inputs[:2])
            return conv.added(a, b)
        if node.type == "MIX_SHADER":
            factor = min(max(reader.number(node, node.inputs[0].name, path), 0.0), 1.0)
            a, b = (_emission_terms(reader, inner, path, what) for inner in node.inputs[1:3])
            return conv.added(conv.scaled(a, 1.0 - factor), conv.scaled(b, factor))
        if node.type in {"EMISSION", "BACKGROUND"}:
            color = reader.color(node, "Color", path)
            return conv.scaled(color, reader.number(node, "Strength", path))
        reader.warn(node, f"{node.bl_label} is not understood in a {what}, white is used")
        return WHITE

    source = reader.source(socket, path)
    return reader.once("emission", source, read) if source.node is not None else BLACK


def _length(vector: Any) -> float:
    return math.sqrt(sum(c * c for c in vector))
