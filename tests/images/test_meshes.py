# SPDX-License-Identifier: GPL-3.0-or-later
"""The generated meshes are closed, outward and have the normals of their formulas."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import Mesh, box, bumpy_sphere, icosphere


def _face_vectors(mesh: Mesh) -> np.ndarray:
    """Area-weighted normals, (m, 3) m^2."""
    corners = mesh.positions[mesh.triangles]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2


@pytest.mark.parametrize("mesh", [icosphere(3), bumpy_sphere(3), box((-1, -2, -3), (1, 1, 0))])
def test_closed_and_outward(mesh: Mesh) -> None:
    edges = mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    forward = {tuple(edge) for edge in edges.tolist()}
    assert len(forward) == len(edges)
    assert all((b, a) in forward for a, b in forward)
    centres = mesh.positions[mesh.triangles].mean(axis=1) - mesh.positions.mean(axis=0)
    assert np.all(np.sum(_face_vectors(mesh) * centres, axis=1) > 0)


def test_icosphere_converges_to_the_sphere() -> None:
    areas = [np.linalg.norm(_face_vectors(icosphere(k)), axis=1).sum() for k in (2, 3, 4)]
    missing = 4 * np.pi - np.array(areas)
    assert len(icosphere(4).triangles) == 20 * 4**4
    assert missing[:-1] / missing[1:] == pytest.approx([4, 4], rel=0.05)


def test_bumpy_normals_are_those_of_the_limit_surface() -> None:
    """Face normals of ever finer meshes tend to the analytic normals, to first order or better."""

    def gap(level: int) -> float:
        mesh = bumpy_sphere(level)
        flat = _face_vectors(mesh)
        flat /= np.linalg.norm(flat, axis=1, keepdims=True)
        smooth = mesh.normals[mesh.triangles].mean(axis=1)
        return float(np.sqrt(np.mean((flat - smooth) ** 2)))

    gaps = [gap(k) for k in (4, 5, 6)]
    assert gaps[1] < gaps[0] / 2 and gaps[2] < gaps[1] / 2
