# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads shader node trees: follows links through reroutes, muted nodes and groups, and evaluates
sockets to constants. Works on anything shaped like Blender's nodes; needs no Blender.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..binding.errors import AmberlightError
from .conventions import blackbody, luminance
from .export_log import ExportLog
from .scene_data import RGB

# The group nodes that were entered, outermost first.
Path = tuple[Any, ...]

# Nodes of one tree, those of groups as often as the groups are used.
READ_MAX = 100_000


def _power(a: float, b: float) -> float:
    try:
        return a**b if a > 0.0 else 0.0
    except OverflowError:
        return math.inf


MATH: dict[str, Callable[[float, float], float]] = {
    "ADD": lambda a, b: a + b,
    "SUBTRACT": lambda a, b: a - b,
    "MULTIPLY": lambda a, b: a * b,
    "DIVIDE": lambda a, b: a / b if b else 0.0,
    "POWER": _power,
    "MINIMUM": min,
    "MAXIMUM": max,
}
COMBINE = {"COMBRGB", "COMBXYZ", "COMBINE_COLOR"}


@dataclass(frozen=True)
class Source:
    """Where a socket's value comes from: a node's output, or (node None) a socket's own value."""

    node: Any
    socket: Any
    path: Path


class TreeReader:
    """One tree of one owner; `where` names both in warnings."""

    def __init__(self, tree: Any, where: str, log: ExportLog) -> None:
        self.tree = tree
        self.where = where
        self.log = log
        self.known: dict[tuple[str, Any, Path], Any] = {}
        self.links: dict[Any, dict[Any, list[Any]]] = {}

    def once(self, what: str, source: Source, read: Callable[[Any, Path], Any]) -> Any:
        """read(node, path) of a source, asked for once: through a ladder of sums, each of which
        takes the one before twice, there are 2^n ways. AmberlightError where groups in groups are
        too many or a chain is too long."""
        key = (what, source.node, source.path)
        if key not in self.known:
            if len(self.known) > READ_MAX:
                raise AmberlightError(f"{self.where}: its node groups hold too many nodes")
            try:
                self.known[key] = read(source.node, source.path)
            except RecursionError:
                raise AmberlightError(f"{self.where}: its nodes are too many in a row") from None
        return self.known[key]

    def named(self, node: Any) -> str:
        return f'{self.where}, node "{node.name}"' if node is not None else self.where

    def warn(self, node: Any, message: str) -> None:
        """The nodes say what is not understood, and so not rendered."""
        self.log.warn(self.named(node), message)

    def note(self, node: Any, message: str) -> None:
        """Nothing is misunderstood, but it must be said."""
        self.log.warn(self.named(node), message)

    def output(self, kind: str) -> Any:
        """The active output node for this engine: ALL and CYCLES count, as materials are made for
        Cycles; None without one. kind: OUTPUT_MATERIAL, OUTPUT_WORLD or OUTPUT_LIGHT."""
        nodes = [node for node in self.tree.nodes if node.type == kind]
        for target in ("CYCLES", "ALL"):
            matching = [node for node in nodes if node.target == target]
            for node in matching:
                if node.is_active_output:
                    return node
            if matching:
                return matching[0]
        return None

    # ---- Links -----------------------------------------------------------------------------------

    def links_into(self, socket: Any) -> list[Any]:
        """The links that count. socket.links looks through all of the tree each time, before
        Blender 4: each tree is looked through once."""
        tree = socket.id_data
        if tree not in self.links:
            found = self.links[tree] = {}
            for link in tree.links:
                if link.is_valid and not link.is_muted:
                    found.setdefault(link.to_socket, []).append(link)
        return self.links[tree].get(socket, [])

    def source(self, socket: Any, path: Path = ()) -> Source:
        """Follows the link into `socket` to a node that makes a value."""
        # Each step goes to another socket of a finite, acyclic tree; the bound is for broken files.
        for _ in range(10000):
            links = self.links_into(socket)
            if not links:
                return Source(None, socket, path)
            link = links[0]
            node, output = link.from_node, link.from_socket
            if node.mute:
                inner = next((k for k in node.internal_links if k.to_socket == output), None)
                if inner is None:
                    return Source(None, None, path)
                socket = inner.from_socket
            elif node.type == "REROUTE":
                socket = node.inputs[0]
            elif node.type == "GROUP" and node.node_tree:
                end = next(
                    (
                        n
                        for n in node.node_tree.nodes
                        if n.type == "GROUP_OUTPUT" and n.is_active_output
                    ),
                    None,
                )
                if end is None:
                    return Source(None, None, path)
                path = (*path, node)
                socket = _by_identifier(end.inputs, output.identifier)
            elif node.type == "GROUP_INPUT" and path:
                socket = _by_identifier(path[-1].inputs, output.identifier)
                path = path[:-1]
            else:
                return Source(node, output, path)
        return Source(None, None, path)

    # ---- Values ----------------------------------------------------------------------------------

    def color(self, node: Any, name: str, path: Path = ()) -> RGB:
        value = self._value(node, name, path)
        if isinstance(value, float):
            return (value, value, value)
        return value

    def number(self, node: Any, name: str, path: Path = ()) -> float:
        value = self._value(node, name, path)
        # Cycles turns a colour into a number by its luminance.
        return value if isinstance(value, float) else luminance(value)

    def is_linked(self, node: Any, name: str) -> bool:
        socket = node.inputs.get(name)
        return socket is not None and bool(self.links_into(socket))

    def _value(self, node: Any, name: str, path: Path) -> float | RGB:
        socket = node.inputs[name]
        value = self._evaluate(self.source(socket, path))
        if value is None:
            value = _default(socket) or 0.0
            self.warn(node, f'input "{name}" is not a constant, its own value is used')
        return value

    def _evaluate(self, source: Source, depth: int = 0) -> float | RGB | None:
        """The constant of a source, or None if it is none that we understand."""
        node = source.node
        if source.socket is None or depth > 100:
            return None
        if node is None:
            return _default(source.socket)
        if node.type in {"RGB", "VALUE"}:
            return _default(node.outputs[0])
        if node.type == "LIGHT_PATH" and source.socket.name.startswith("Is "):
            # Mixes of what the camera sees with what lights the scene are the latter.
            self.note(node, "kinds of rays are not told apart, it is 0 for all")
            return 0.0
        return self.once("value", source, lambda node, path: self._value_of(node, path, depth))

    def _value_of(self, node: Any, path: Path, depth: int) -> float | RGB | None:
        if node.type == "MATH" and node.operation in MATH:
            a, b = (self._evaluate(self.source(s, path), depth + 1) for s in node.inputs[:2])
            if a is None or b is None:
                return None
            a, b = (v if isinstance(v, float) else luminance(v) for v in (a, b))
            value = MATH[node.operation](a, b)
            return min(max(value, 0.0), 1.0) if node.use_clamp else value
        if node.type == "BLACKBODY":
            kelvin = self._evaluate(self.source(node.inputs[0], path), depth + 1)
            if kelvin is None:
                return None
            return blackbody(kelvin if isinstance(kelvin, float) else luminance(kelvin))
        if node.type in COMBINE and getattr(node, "mode", "RGB") == "RGB":
            parts = [self._evaluate(self.source(s, path), depth + 1) for s in node.inputs[:3]]
            if all(isinstance(part, float) for part in parts):
                return (parts[0], parts[1], parts[2])  # type: ignore[return-value]
        return None


def _by_identifier(sockets: Any, identifier: str) -> Any:
    return next(s for s in sockets if s.identifier == identifier)


def _default(socket: Any) -> float | RGB | None:
    value = getattr(socket, "default_value", None)
    if value is None:
        return None
    try:
        return (float(value[0]), float(value[1]), float(value[2]))
    except TypeError:
        return float(value)
