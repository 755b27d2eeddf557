# SPDX-License-Identifier: GPL-3.0-or-later
"""PNGs of the benchmarks, without a library for them."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def display(radiance: NDArray[np.floating], exposure: float) -> NDArray[np.uint8]:
    """sRGB of linear radiance, `exposure` in stops."""
    linear = np.clip(np.asarray(radiance, dtype=np.float64) * 2.0**exposure, 0.0, 1.0)
    curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return (curve * 255 + 0.5).astype(np.uint8)


def exposure_of(radiance: NDArray[np.floating], mask: NDArray[np.bool_]) -> float:
    """Stops that show the brightest one in a hundred of the masked values as white."""
    return float(-np.log2(max(np.percentile(radiance[mask], 99), 1e-30)))


def montage(rows: Sequence[Sequence[NDArray[np.uint8]]], gap: int = 4) -> NDArray[np.uint8]:
    """Images of one size, (height, width, 3), row by row with dark lines between."""

    def padded(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        return np.pad(image, ((0, gap), (0, gap), (0, 0)), constant_values=40)

    return np.concatenate([np.concatenate([padded(i) for i in row], axis=1) for row in rows])


def write_png(path: Path, image: NDArray[np.uint8]) -> None:
    """(height, width, 3), row 0 = top."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    height, width = image.shape[:2]
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    lines = b"".join(b"\0" + row.tobytes() for row in np.ascontiguousarray(image))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(lines, 9))
        + chunk(b"IEND", b"")
    )
