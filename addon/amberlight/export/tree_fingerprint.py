# SPDX-License-Identifier: GPL-3.0-or-later
"""One number for all that a world's nodes say: it changes when an image that was baked of them no
longer shows them.

Left out are nodes that lead nowhere, where nodes lie in the editor, and the pixels of images.
Needs no Blender.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from typing import Any

# Structs in structs, of broken or circular data.
DEPTH_MAX = 6
# What changes by itself: the frame of an image that may not even move.
VOLATILE = {"rna_type", "frame_current"}
PLAIN = {"BOOLEAN", "INT", "FLOAT", "STRING", "ENUM"}
OUTPUTS = {"OUTPUT_WORLD", "GROUP_OUTPUT"}


def fingerprint(world: Any, frame: int) -> str:
    """Of the world as it is evaluated at `frame`, which matters to sequences of images only."""
    digest = hashlib.sha256()
    for line in _tree_lines(world.node_tree, frame, set()):
        digest.update(repr(line).encode("utf-8", "surrogateescape"))
    return digest.hexdigest()


def widest_image(world: Any) -> int:
    """Pixels; 0 without an image."""
    return max((image.size[0] for image in _images(world.node_tree, set())), default=0)


def _images(tree: Any, seen: set[str]) -> Iterator[Any]:
    seen.add(tree.name_full)
    for node in reachable(tree):
        if getattr(node, "image", None) is not None:
            yield node.image
        inner = getattr(node, "node_tree", None)
        if inner is not None and inner.name_full not in seen:
            yield from _images(inner, seen)


def _links(tree: Any) -> list[Any]:
    """All but those to a volume, which the surroundings do not show."""
    return [
        link
        for link in tree.links
        if link.to_node.type != "OUTPUT_WORLD" or link.to_socket.identifier != "Volume"
    ]


def reachable(tree: Any) -> list[Any]:
    """The nodes that lead to an output of the tree, by name."""
    into: dict[Any, list[Any]] = {}
    for link in _links(tree):
        into.setdefault(link.to_node, []).append(link.from_node)
    found = dict[str, Any]()
    waiting = [node for node in tree.nodes if node.type in OUTPUTS]
    while waiting:
        node = waiting.pop()
        if node.name not in found:
            found[node.name] = node
            waiting += into.get(node, [])
    return [found[name] for name in sorted(found)]


def _tree_lines(tree: Any, frame: int, seen: set[str]) -> Iterator[Any]:
    """Each group once, however often it is used."""
    if tree.name_full in seen:
        return
    seen.add(tree.name_full)
    nodes = reachable(tree)
    names = {node.name for node in nodes}
    for node in nodes:
        yield node.name, node.bl_idname, node.mute
        # The own settings of a kind of nodes, without those that all have (name, place, colour).
        yield from _settings(node, _inherited(node, "Node"), frame, 0)
        for socket in (*node.inputs, *node.outputs):
            yield socket.identifier, _plain(getattr(socket, "default_value", None))
        if getattr(node, "node_tree", None) is not None:
            yield from _tree_lines(node.node_tree, frame, seen)
    yield from sorted(
        (
            link.from_node.name,
            link.from_socket.identifier,
            link.to_node.name,
            link.to_socket.identifier,
            link.is_muted,
        )
        for link in _links(tree)
        if link.to_node.name in names
    )


def _inherited(item: Any, base: str) -> set[str]:
    """Names of the properties that the struct has from `base`."""
    kind = item.bl_rna
    while kind is not None and kind.identifier != base:
        kind = kind.base
    return VOLATILE | (set(kind.properties.keys()) if kind is not None else set())


def _settings(item: Any, without: set[str], frame: int, depth: int) -> Iterator[Any]:
    for prop in item.bl_rna.properties:
        name = prop.identifier
        if name in without:
            continue
        value = getattr(item, name, None)
        if prop.type in PLAIN:
            yield name, _plain(value)
        elif prop.type == "COLLECTION":
            for part in value if depth < DEPTH_MAX else ():
                yield from _settings(part, VOLATILE, frame, depth + 1)
        elif value is None:
            yield name, None
        elif hasattr(value, "name_full"):
            yield name, *_data_block(value, frame)
        elif depth < DEPTH_MAX:
            yield name
            yield from _settings(value, VOLATILE, frame, depth + 1)


def _data_block(block: Any, frame: int) -> tuple[Any, ...]:
    """What a node sees of another data-block."""
    kind = block.bl_rna.identifier
    if kind == "Object":
        return kind, tuple(tuple(row) for row in block.matrix_world)
    if kind == "Image":
        moving = frame if block.source in {"SEQUENCE", "MOVIE"} else None
        space = block.colorspace_settings.name
        return kind, block.name_full, block.filepath, tuple(block.size), space, moving
    if kind == "Text":
        return kind, block.as_string()
    return kind, block.name_full


def _plain(value: Any) -> Any:
    """Arrays as tuples and sets in order: by themselves they have no text that stays."""
    if isinstance(value, (str, int, float, type(None))):
        return value
    if isinstance(value, (set, frozenset)):
        return sorted(value)
    return tuple(value) if hasattr(value, "__iter__") else getattr(value, "name_full", "")
