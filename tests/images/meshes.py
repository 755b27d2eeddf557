# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangle meshes of the image tests, made from formulas so that nothing has to be stored.

All triangles are counter-clockwise seen from outside.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Mesh:
    """``positions`` (n, 3) metres, ``triangles`` (m, 3), ``normals`` (n, 3) unit or None = flat."""

    positions: Array
    triangles: NDArray[np.uint32]
    normals: Array | None = None


def icosphere(level: int) -> Mesh:
    """Unit sphere of 20 * 4^level triangles with the sphere's exact normals."""
    golden = (1 + np.sqrt(5)) / 2
    corners = [(-1, golden, 0), (1, golden, 0), (-1, -golden, 0), (1, -golden, 0)]
    corners += [(0, x, y) for x, y, _ in corners]
    corners += [(y, 0, x) for x, y, _ in corners[:4]]
    points = np.array(corners, dtype=np.float64)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    # Neighbours on the icosahedron are those at the smallest distance; its faces follow.
    near = np.linalg.norm(points[:, None] - points[None], axis=2)
    edge = np.sort(near[0])[1] * 1.01
    faces = []
    for a in range(12):
        for b in range(a + 1, 12):
            for c in range(b + 1, 12):
                if max(near[a, b], near[b, c], near[a, c]) < edge:
                    out = np.cross(points[b] - points[a], points[c] - points[a]) @ points[a] > 0
                    faces.append((a, b, c) if out else (a, c, b))
    triangles = np.array(faces, dtype=np.uint32)
    for _ in range(level):
        points, triangles = subdivide(points, triangles)
        points /= np.linalg.norm(points, axis=1, keepdims=True)
    return Mesh(points, triangles, points.copy())


def subdivide(points: Array, triangles: NDArray[np.uint32]) -> tuple[Array, NDArray[np.uint32]]:
    """Each triangle into four at its edge midpoints; shared edges stay shared. Any columns."""
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, index = np.unique(sides, axis=0, return_inverse=True)
    middles = (points[unique[:, 0]] + points[unique[:, 1]]) / 2
    ab, bc, ca = (index.reshape(-1, 3) + len(points)).T.astype(np.uint32)
    a, b, c = triangles.T
    split = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1)
    return np.concatenate([points, middles]), split.reshape(-1, 3)


def bumpy_sphere(level: int = 5) -> Mesh:
    """r(d) = 1 + 0.025 (sin 8x sin 8y + sin 8y sin 8z + sin 8z sin 8x), d = (x, y, z) unit.

    Normals are those of the analytic surface: the gradient of |p| - r(p / |p|).
    """
    sphere = icosphere(level)
    d = sphere.positions
    sin, cos = np.sin(8 * d), np.cos(8 * d)
    others = sin.sum(axis=1, keepdims=True) - sin
    radius = 1 + 0.0125 * np.sum(sin * others, axis=1, keepdims=True)
    slope = 0.2 * cos * others
    tangential = slope - np.sum(slope * d, axis=1, keepdims=True) * d
    normals = d - tangential / radius
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Mesh(radius * d, sphere.triangles, normals)


def torus(around: int, across: int, radius: float = 0.7, tube: float = 0.3) -> Mesh:
    """About the z axis, with exact normals."""
    u, v = (
        angle.ravel()[:, None]
        for angle in np.meshgrid(
            np.arange(around) * 2 * np.pi / around,
            np.arange(across) * 2 * np.pi / across,
            indexing="ij",
        )
    )
    ring = np.concatenate([np.cos(u), np.sin(u), 0 * u], axis=1)
    normals = np.cos(v) * ring + np.sin(v) * np.array([0.0, 0.0, 1.0])
    index = np.arange(around * across).reshape(around, across)
    a, b = index.ravel(), np.roll(index, -1, axis=0).ravel()
    c, d = np.roll(index, (-1, -1), axis=(0, 1)).ravel(), np.roll(index, -1, axis=1).ravel()
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return Mesh(radius * ring + tube * normals, triangles.astype(np.uint32), normals)


def lathe(profile: list[tuple[float, float]], around: int = 24) -> Mesh:
    """(radius, z) turned around z, from an end on the axis to the other, with smooth normals."""
    turns = 2 * np.pi * np.arange(around) / around
    ring = np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    inner = profile[1:-1]
    points = [(0.0, 0.0, profile[0][1]), (0.0, 0.0, profile[-1][1])]
    points += [(r * x, r * y, z) for r, z in inner for x, y in ring]
    faces = []
    for i in range(around):
        j = (i + 1) % around
        faces.append((0, 2 + j, 2 + i))
        last = 2 + (len(inner) - 1) * around
        faces.append((1, last + i, last + j))
        for k in range(len(inner) - 1):
            a, b = 2 + k * around, 2 + (k + 1) * around
            faces += [(a + i, a + j, b + j), (a + i, b + j, b + i)]
    positions = np.array(points)
    triangles = np.array(faces, dtype=np.uint32)
    corners = positions[triangles]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(positions)
    for k in range(3):
        np.add.at(normals, triangles[:, k], areas)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Mesh(positions, triangles, normals)


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Mesh:
    """Axis-aligned box with flat faces, 12 triangles."""
    lo, hi = np.array(low), np.array(high)
    bits = np.array([[(i >> k) & 1 for k in range(3)] for i in range(8)])
    points = np.where(bits == 1, hi, lo).astype(np.float64)
    quads = [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return Mesh(points, np.array(triangles, dtype=np.uint32))


def large_slab(thickness: float, half_width: float) -> Mesh:
    """Box with its top at z = 0, wide enough that a small image of its middle sees no edge."""
    return box((-half_width, -half_width, -thickness), (half_width, half_width, 0.0))


def single_triangle(corners: Array, normals: Array) -> Mesh:
    """One triangle with its own shading normals, (3, 3) each."""
    return Mesh(corners, np.array([[0, 1, 2]], dtype=np.uint32), normals)


def read_obj(path: Path) -> Mesh:
    """An OBJ of triangles; normals, where it has any, have the vertices' own indices."""
    columns: dict[str, list[list[str]]] = {"v": [], "vn": [], "f": []}
    for line in path.read_text().splitlines():
        words = line.split()
        if words and words[0] in columns:
            columns[words[0]].append(words[1:])
    corners = [[word.split("/") for word in face] for face in columns["f"]]
    triangles = np.array([[int(c[0]) - 1 for c in face] for face in corners], dtype=np.uint32)
    positions = np.array(columns["v"], dtype=np.float64)
    if not columns["vn"]:
        return Mesh(positions, triangles)
    if any(corner[0] != corner[-1] for face in corners for corner in face):
        raise ValueError(f"{path}: normals are indexed apart from the vertices")
    return Mesh(positions, triangles, np.array(columns["vn"], dtype=np.float64))
