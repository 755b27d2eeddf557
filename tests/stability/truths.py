# SPDX-License-Identifier: GPL-3.0-or-later
"""Closed forms of the hard cases that tests/images/oracles.py does not have, in float64."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from oracles import henyey_greenstein

Array = NDArray[np.float64]


def _gauss(low: float, high: float, panels: int = 64, nodes: int = 16) -> tuple[Array, Array]:
    """Points and weights of a composite Gauss rule."""
    u, weight = np.polynomial.legendre.leggauss(nodes)
    edges = np.linspace(low, high, panels + 1)
    half = (edges[1:] - edges[:-1])[:, None] / 2
    return (edges[:-1, None] + half * (1 + u)).ravel(), (half * weight).ravel()


def chord(origin: Array, direction: Array, low: ArrayLike, high: ArrayLike) -> tuple[Array, Array]:
    """Where lines o + t d, shape (n, 3), enter and leave the box [low, high]."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a = (np.asarray(low) - origin) / direction
        b = (np.asarray(high) - origin) / direction
    first, last = np.fmin(a, b), np.fmax(a, b)
    # A line inside of two parallel faces and along them: unbounded by these.
    along = direction == 0
    within = (origin >= low) & (origin <= high)
    first = np.where(along, np.where(within, -np.inf, np.inf), first)
    last = np.where(along, np.where(within, np.inf, -np.inf), last)
    return first.max(axis=-1), last.min(axis=-1)


def matched_box_and_points(
    origin: ArrayLike,
    direction: ArrayLike,
    lamps: Sequence[ArrayLike],
    sigma_s: ArrayLike,
    sigma_t: ArrayLike,
    g: float = 0.0,
    low: ArrayLike = (-1, -1, -1),
    high: ArrayLike = (1, 1, 1),
    panels: int = 256,
) -> Array:
    """RGB radiance of a box of index 1 under point lamps of 1 W/sr anywhere, inside included."""
    o, d = np.asarray(origin, np.float64), np.asarray(direction, np.float64)
    near, far = chord(o[None], d[None], low, high)
    start = max(float(near[0]), 0.0)
    total = np.zeros(3)
    if far[0] <= start:
        return total
    s, extinct = (np.broadcast_to(np.asarray(v, np.float64), 3) for v in (sigma_s, sigma_t))
    # Panels that shrink towards the nearest point of the lamp: its light falls off there.
    for lamp in (np.asarray(place, np.float64) for place in lamps):
        nearest = float(np.clip((lamp - o) @ d, start, far[0]))
        for a, b in ((start, nearest), (nearest, float(far[0]))):
            if b <= a:
                continue
            v, weight = _gauss(0, 1, panels)
            # t - nearest = length v^4, so that dt vanishes where the lamp is near.
            length = b - a
            t = b - length * v**4 if a == start and b == nearest else a + length * v**4
            weight = weight * 4 * v**3 * length
            x = o + t[:, None] * d
            offset = x - lamp
            r = np.linalg.norm(offset, axis=1)
            w = offset / r[:, None]
            first, last = chord(np.broadcast_to(lamp, x.shape), w, low, high)
            inside = np.minimum(last, r) - np.maximum(first, 0)
            phase = henyey_greenstein(-(w @ d), g)
            path = inside + t - start
            for k in range(3):
                value = s[k] * phase / r**2 * np.exp(-extinct[k] * path)
                total[k] += float(np.sum(weight * value))
    return total


def half_space(
    albedo: float, light_cosine: float, camera_cosine: float, phase: float, irradiance: float = 1.0
) -> float:
    """Single scattering of a half space of index 1, lit and seen from above; cosines from its
    normal, irradiance perpendicular to the beam."""
    return albedo * phase * irradiance * light_cosine / (light_cosine + camera_cosine)
