# SPDX-License-Identifier: GPL-3.0-or-later
"""Media at their limits: no medium, an opaque one, lobes like needles, channels that differ."""

from __future__ import annotations

import numpy as np
from hard import ALL, Case
from meshes import large_slab
from oracles import Slab
from scenes import SUN, Body, Camera, Lamp, Setup, mean, relative


def slab_setup(
    slab: Slab, sigma_s: tuple[float, ...] | float, sigma_a: tuple[float, ...] | float
) -> Setup:
    """The slab of the closed forms, edges black."""
    mesh = large_slab(slab.thickness, 3.0)
    z = mesh.positions[mesh.triangles][..., 2]
    light = (np.sin(slab.light_angle), 0, -np.cos(slab.light_angle))
    camera = np.array([np.sin(slab.camera_angle), 0, np.cos(slab.camera_angle)])
    body = Body(mesh, slab.n, sigma_s, sigma_a, slab.g, black=np.ptp(z, axis=1) > 0)
    return Setup(
        (body,), (Lamp(SUN, direction=light),), Camera(8 * camera, -camera, window=0.05), size=2
    )


def slab_error(
    method: str,
    sigma_s: tuple[float, ...] | float = 0.4,
    sigma_a: tuple[float, ...] | float = 0.1,
    **fields: float,
) -> float:
    """Relative error of the mean of a slab, the worst channel."""
    s, a = np.broadcast_to(sigma_s, 3), np.broadcast_to(sigma_a, 3)
    truth = [
        Slab(sigma_s=x, sigma_t=x + y, **fields).radiance() if x + y > 0 else 0.0
        for x, y in zip(s, a, strict=True)
    ]
    setup = slab_setup(Slab(**fields), tuple(map(float, s)), tuple(map(float, a)))
    return relative(mean(setup, method, samples=4), truth)


CLOSED = "closed form of a slab of index 1.5; relative"


def slab(name: str, bound: float = 1e-3, bound_points: float = 1.5e-2, **fields: object) -> Case:
    return Case(
        name, CLOSED, bound, lambda m: slab_error(m, **fields), ALL, bound_points=bound_points
    )


CASES = [
    slab("sigma_t = 0", sigma_s=0.0, sigma_a=0.0, bound=0.0, bound_points=0.0),
    slab("no scattering, absorption 1", sigma_s=0.0, sigma_a=1.0, bound=0.0, bound_points=0.0),
    slab("sigma_t = 1e-7", sigma_s=5e-8, sigma_a=5e-8),
    slab("sigma_t = 1e-3, albedo 1", sigma_s=1e-3, sigma_a=0.0),
    slab("sigma_t = 1, albedo 1", sigma_s=1.0, sigma_a=0.0),
    slab("sigma_t = 1e3", bound_points=6e-2, sigma_s=5e2, sigma_a=5e2),
    slab("sigma_t = 1e6", bound=4e-2, bound_points=6e-2, sigma_s=5e5, sigma_a=5e5),
    slab("sigma_t = 1e7, albedo 1", bound=0.3, bound_points=6e-2, sigma_s=1e7, sigma_a=0.0),
    slab(
        "one channel clear, one thin, one opaque",
        bound=4e-2,
        bound_points=6e-2,
        sigma_s=(0.0, 0.4, 1e6),
        sigma_a=(0.0, 0.1, 0),
    ),
    slab(
        "one channel absorbs 1e6, one nothing",
        bound=4e-2,
        bound_points=6e-2,
        sigma_s=(1.0, 1.0, 1.0),
        sigma_a=(1e6, 1.0, 0.0),
    ),
    slab("g = 0.999", g=0.999),
    slab("g = -0.999", g=-0.999),
    slab("g = 1e-7", g=1e-7),
    slab("ior 1", n=1.0),
    slab("ior 1 + 1e-7", n=1 + 2**-23),
    slab("ior 1 + 1e-4", n=1.0001),
    slab("ior 1 - 1e-4", n=0.9999),
    slab("ior 4", n=4.0),
    slab("ior 0.8", n=0.8),
]
