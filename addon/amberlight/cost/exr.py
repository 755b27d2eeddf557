# SPDX-License-Identifier: GPL-3.0-or-later
"""OpenEXR files of one part in scan lines: what Blender and the library write can be read, and
pictures can be written without either.

Pixels in memory begin at the bottom, those in the file at the top.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAGIC = b"\x76\x2f\x31\x01"
VERSION = 2
FLAG_TILES, FLAG_DEEP, FLAG_PARTS, FLAG_LONG_NAMES = 0x200, 0x800, 0x1000, 0x400
# Lines in a block for each compression that is known: none, ZIPS, ZIP.
BLOCK_LINES = {0: 1, 2: 1, 3: 16}
ZIP = 3
KINDS: dict[int, Any] = {1: np.dtype("<f2"), 2: np.dtype("<f4")}
FLOAT = 2


class ExrError(ValueError):
    """A file that is not such an OpenEXR file, in one sentence."""


def read(path: Path) -> dict[str, NDArray[np.float32]]:
    """{channel name: (height, width) float32, row 0 at the bottom}."""
    data = path.read_bytes()
    if data[:4] != MAGIC:
        raise ExrError(f"{path} is not an OpenEXR file")
    try:
        return _decode(data)
    except (struct.error, KeyError, IndexError, zlib.error) as error:
        raise ExrError(f"{path} is damaged: {error}") from error
    except ValueError as error:
        raise ExrError(f"{path}: {error}") from error


def read_rgb(path: Path, passes: tuple[str, ...]) -> NDArray[np.float32]:
    """(height, width, 3): the first of `passes` that the file has in any layer, else its plain
    R, G and B."""
    channels = read(path)
    for name in passes:
        for channel in channels:
            if channel.endswith(f".{name}.R") or channel == f"{name}.R":
                stem = channel[:-1]
                return np.stack([channels[stem + c] for c in "RGB"], axis=-1)
    if not {"R", "G", "B"} <= channels.keys():
        raise ExrError(f"{path} has no channels {' or '.join(passes)}, and no R, G and B")
    return np.stack([channels[c] for c in "RGB"], axis=-1)


def write(path: Path, layers: Mapping[str, NDArray[Any]]) -> None:
    """Layers of (height, width, 3), all of one size, as 32-bit channels "layer.R"."""
    planes = {
        f"{name}.{letter}": np.asarray(pixels[::-1, :, index], "<f4")
        for name, pixels in layers.items()
        for index, letter in enumerate("RGB")
    }
    names = sorted(planes)
    height, width = planes[names[0]].shape
    head = _header(names, width, height)
    blocks = []
    for y in range(0, height, BLOCK_LINES[ZIP]):
        lines = range(y, min(y + BLOCK_LINES[ZIP], height))
        raw = b"".join(planes[name][line].tobytes() for line in lines for name in names)
        packed = _zip(raw)
        # A block that does not shrink is stored as it is; readers know it by its size.
        packed = packed if len(packed) < len(raw) else raw
        blocks.append(struct.pack("<ii", y, len(packed)) + packed)
    at = len(head) + 8 * len(blocks)
    offsets = b""
    for block in blocks:
        offsets += struct.pack("<Q", at)
        at += len(block)
    path.write_bytes(head + offsets + b"".join(blocks))


# ---- Header --------------------------------------------------------------------------------------


def _header(names: list[str], width: int, height: int) -> bytes:
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    channels = b"".join(
        name.encode() + b"\0" + struct.pack("<iB3xii", FLOAT, 0, 1, 1) for name in names
    )
    attributes = (
        ("channels", "chlist", channels + b"\0"),
        ("compression", "compression", bytes([ZIP])),
        ("dataWindow", "box2i", window),
        ("displayWindow", "box2i", window),
        ("lineOrder", "lineOrder", b"\0"),
        ("pixelAspectRatio", "float", struct.pack("<f", 1.0)),
        ("screenWindowCenter", "v2f", struct.pack("<2f", 0.0, 0.0)),
        ("screenWindowWidth", "float", struct.pack("<f", 1.0)),
    )
    long_names = FLAG_LONG_NAMES if max(map(len, names)) > 31 else 0
    text = MAGIC + struct.pack("<I", VERSION | long_names)
    for name, kind, value in attributes:
        text += name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value))
        text += value
    return text + b"\0"


def _string(data: bytes, at: int) -> tuple[str, int]:
    end = data.index(b"\0", at)
    return data[at:end].decode("utf-8", "replace"), end + 1


def _attributes(data: bytes, at: int) -> tuple[dict[str, bytes], int]:
    found = {}
    while data[at]:
        name, at = _string(data, at)
        _, at = _string(data, at)
        (size,) = struct.unpack_from("<i", data, at)
        found[name] = data[at + 4 : at + 4 + size]
        at += 4 + size
    return found, at + 1


def _channels(data: bytes) -> Iterator[tuple[str, Any]]:
    at = 0
    while data[at]:
        name, at = _string(data, at)
        kind, _, step_x, step_y = struct.unpack_from("<iB3xii", data, at)
        if kind not in KINDS or (step_x, step_y) != (1, 1):
            raise ValueError(f"the channel {name} is not of floating-point pixels")
        yield name, KINDS[kind]
        at += 16


# ---- Pixels --------------------------------------------------------------------------------------


def _decode(data: bytes) -> dict[str, NDArray[np.float32]]:
    (version,) = struct.unpack_from("<I", data, 4)
    if version & (FLAG_TILES | FLAG_DEEP | FLAG_PARTS):
        raise ValueError("tiles, deep pixels and several parts are not read")
    header, at = _attributes(data, 8)
    compression = header["compression"][0]
    if compression not in BLOCK_LINES:
        raise ValueError("only no compression and ZIP are read")
    x0, y0, x1, y1 = struct.unpack("<4i", header["dataWindow"])
    width, height = x1 - x0 + 1, y1 - y0 + 1
    channels = list(_channels(header["channels"]))
    line_bytes = width * sum(kind.itemsize for _, kind in channels)
    block_lines = BLOCK_LINES[compression]
    block_count = -(-height // block_lines)
    planes = {name: np.empty((height, width), np.float32) for name, _ in channels}
    for offset in struct.unpack_from(f"<{block_count}Q", data, at):
        y, size = struct.unpack_from("<ii", data, offset)
        lines = range(y - y0, min(y - y0 + block_lines, height))
        raw = data[offset + 8 : offset + 8 + size]
        if size < line_bytes * len(lines):
            raw = _unzip(raw)
        position = 0
        for line in lines:
            for name, kind in channels:
                planes[name][line] = np.frombuffer(raw, kind, width, position)
                position += width * kind.itemsize
    return {name: plane[::-1] for name, plane in planes.items()}


def _zip(raw: bytes) -> bytes:
    """Even bytes, then odd ones, each as its difference from the one before plus 128."""
    values = np.frombuffer(raw, np.uint8)
    parted = np.concatenate([values[0::2], values[1::2]])
    steps = parted.copy()
    steps[1:] = parted[1:] - parted[:-1] + np.uint8(128)
    return zlib.compress(steps.tobytes())


def _unzip(packed: bytes) -> bytes:
    steps = np.frombuffer(zlib.decompress(packed), np.uint8).astype(np.int64)
    steps[1:] -= 128
    parted = (np.cumsum(steps) & 255).astype(np.uint8)
    half = (len(parted) + 1) // 2
    values = np.empty_like(parted)
    values[0::2], values[1::2] = parted[:half], parted[half:]
    return values.tobytes()
