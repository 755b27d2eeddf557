# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads what the tests let Blender write: uncompressed scan lines of 32-bit floats."""

import struct

import numpy as np


def read_exr(path):
    """{channel name: (height, width) float32, row 0 at the bottom} of a single-part file."""
    data = path.read_bytes()
    assert data[:4] == b"\x76\x2f\x31\x01"
    header, at = read_header(data, 8)
    assert header["compression"] == b"\0"
    x0, y0, x1, y1 = struct.unpack("<4i", header["dataWindow"])
    width, height = x1 - x0 + 1, y1 - y0 + 1
    channels = list(read_channels(header["channels"]))
    assert {kind for _, kind in channels} == {2}, "not all 32-bit floats"
    offsets = np.frombuffer(data, "<u8", height, at)
    image = np.empty((height, len(channels), width), np.float32)
    for row, offset in enumerate(offsets):
        image[row].ravel()[:] = np.frombuffer(data, "<f4", width * len(channels), int(offset) + 8)
    return {name: image[::-1, index] for index, (name, _) in enumerate(channels)}


def read_string(data, at):
    end = data.index(b"\0", at)
    return data[at:end].decode(), end + 1


def read_header(data, at):
    header = {}
    while data[at]:
        name, at = read_string(data, at)
        _, at = read_string(data, at)
        (size,) = struct.unpack_from("<i", data, at)
        header[name] = data[at + 4 : at + 4 + size]
        at += 4 + size
    return header, at + 1


def read_channels(data):
    at = 0
    while data[at]:
        name, at = read_string(data, at)
        (kind,) = struct.unpack_from("<i", data, at)
        yield name, kind
        at += 16
