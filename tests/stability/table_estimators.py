# SPDX-License-Identifier: GPL-3.0-or-later
"""Where estimators degenerate: along the light, at edges, at foci, with next to no samples."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from api import errors
from hard import POINTS, Case
from meshes import box, icosphere, large_slab
from oracles import (
    Slab,
    SphereLight,
    SphereMedium,
    henyey_greenstein,
    matched_sphere,
    refracting_sphere,
)
from scenes import POINT, SUN, Body, Camera, Lamp, Setup, mean, picture, relative
from table_media import slab_error, slab_setup

BOX = box((-1, -1, -1), (1, 1, 1))


# ---- Along the light -----------------------------------------------------------------------------


def slab_along(method: str, tilt: float, n: float, is_from_behind: bool = False) -> float:
    """A slab under a perpendicular sun, viewed along the light but for `tilt` radians; from the
    lit side, or against the light from behind."""
    if not is_from_behind:
        return slab_error(method, light_angle=0.0, camera_angle=tilt, n=n, g=0.5)
    # Every point of the line of sight is reached after the whole thickness in all.
    setup = slab_setup(Slab(n=n, g=0.5, light_angle=0.0), 0.4, 0.1)
    direction = np.array([np.sin(tilt), 0, np.cos(tilt)])
    camera = Camera(np.array([0, 0, -0.5]) - 5 * direction, direction, window=1e-3)
    out, inside = np.cos(tilt), np.sqrt(1 - (np.sin(tilt) / n) ** 2)
    enters = 1 - ((n - 1) / (n + 1)) ** 2
    s, p = (n * out - inside) / (n * out + inside), (out - n * inside) / (out + n * inside)
    leaves = 1 - (s * s + p * p) / 2
    # exp(-sigma_t (z + (1 - z) / inside)) over z / inside
    k = 0.5 * (1 / inside - 1)
    fade = np.exp(-0.5) * (1.0 if k < 1e-12 else -np.expm1(-k) / k)
    phase = henyey_greenstein(inside, 0.5)
    truth = 0.4 * phase * enters * leaves / n**2 * fade / inside
    return relative(mean(replace(setup, camera=camera), method, samples=4), truth)


def sphere_along(method: str, tilt: float, sign: float) -> float:
    """A sphere of index 1 viewed along the light (sign 1) or against it (-1)."""
    light = np.array([0.36, 0.48, 0.8])
    aside = np.array([0.8, -0.6, 0.0])
    d = sign * (np.cos(tilt) * light + np.sin(tilt) * aside)
    origin = np.array([0.11, 0.07, -0.05]) - 5 * d
    body = Body(icosphere(4), 1.0, 0.4, 0.1, 0.3)
    setup = Setup((body,), (Lamp(SUN, direction=light),), Camera(origin, d))
    truth = matched_sphere(origin, d, light, 0.4, 0.5, 0.3)
    return relative(mean(setup, method, samples=4), truth)


def point_along(method: str, offset: float) -> float:
    """A camera ray that passes a point lamp outside of a matched box at the distance `offset`."""
    from truths import matched_box_and_points

    lamp = np.array([0.1 + offset, 0.2, 3.0])
    setup = Setup(
        (Body(BOX),), (Lamp(POINT, position=lamp),), Camera((0.1, 0.2, 6), window=offset / 20)
    )
    truth = matched_box_and_points((0.1, 0.2, 6), (0, 0, -1), [lamp], 0.4, 0.5)
    return relative(mean(setup, method, samples=4), truth)


# ---- Edges ---------------------------------------------------------------------------------------


def beside_a_face(method: str, depth: float) -> float:
    """A view along the face of a matched box that the sun lights, `depth` below it."""
    camera = Camera((0.3, 5, 1 - depth), (0, -1, 0), (0, 0, 1), window=depth / 50)
    setup = Setup((Body(BOX, g=0.4),), (Lamp(SUN),), camera)
    truth = 0.4 * henyey_greenstein(0, 0.4) * np.exp(-0.5 * depth) * -np.expm1(-0.5 * 2) / 0.5
    return relative(mean(setup, method, samples=4), truth)


def silhouette(method: str, height: float) -> float:
    """A camera ray that grazes a matched sphere, at 1 - height from its centre."""
    light = np.array([0.6, 0, 0.8])
    y = 1 - height
    origin, d = np.array([5, y, 0.0]), np.array([-1.0, 0, 0])
    setup = Setup(
        (Body(icosphere(6)),),
        (Lamp(SUN, direction=light),),
        Camera(origin, d, (0, 0, 1), window=height / 20),
    )
    truth = matched_sphere(origin, d, light, 0.4, 0.5, 0)
    return abs(float(mean(setup, method, samples=4)[0]) / truth - 1)


def starts_at(method: str, height: float) -> float:
    """A camera `height` above the lit face of a matched slab, inside where negative."""
    mesh = large_slab(1.0, 3.0)
    camera = Camera((0, 0, height), window=1e-3, clip=(1e-9, 1e3))
    setup = Setup((Body(mesh),), (Lamp(SUN, direction=(0.6, 0, -0.8)),), camera)
    start = max(-height, 0.0)
    k = 0.5 * (1 / 0.8 + 1)
    fade = np.exp(-0.5 * start / 0.8) * -np.expm1(-k * (1 - start)) / k
    truth = 0.4 / (4 * np.pi) * fade
    return relative(mean(setup, method, samples=4), truth)


# ---- Caustics ------------------------------------------------------------------------------------


@cache
def mean_of_sphere(n: float, y: float, z: float, window: float) -> float:
    """The quadrature's mean over a window of rays."""
    u, weight = np.polynomial.legendre.leggauss(6)
    sun = SphereLight(np.array([0, 0, -1.0]))
    total = 0.0
    for i, a in zip(u, weight, strict=True):
        for j, b in zip(u, weight, strict=True):
            origin = np.array([5, y + window / 2 * i, z + window / 2 * j])
            ray = refracting_sphere(
                origin, np.array([-1.0, 0, 0]), sun, SphereMedium(n, 0.5, 0.5), scan=601
            )
            total += a * b * ray / 4
    return total


def sphere_ray(method: str, n: float, y: float, z: float, window: float) -> float:
    """A refracting sphere under a sun: the mean over a window of rays against the quadrature."""
    truth = mean_of_sphere(n, y, z, window)
    setup = Setup(
        (Body(icosphere(5), n, 0.5, 0.0),),
        (Lamp(SUN, direction=(0, 0, 1)),),
        Camera((5, y, z), (-1, 0, 0), (0, 0, 1), window=window),
    )
    samples = 64 if method == "SPECULAR" else 256
    value = mean(setup, method, samples=samples, light_samples=2**16, kernel_size=4)
    return relative(value, truth)


# ---- Samples -------------------------------------------------------------------------------------


def coincident(method: str) -> float:
    """The same lamp twice, and one of twice the intensity."""
    lamp = Lamp(POINT, position=(0.3, 0.4, 3))
    body = Body(icosphere(3), 1.3)
    camera = Camera((5, 0.2, 0.3), (-1, 0, 0), (0, 0, 1), window=1.5)
    twice = Setup((body,), (lamp, lamp), camera, size=6)
    once = Setup((body,), (replace(lamp, color=2.0),), camera, size=6)
    return relative(mean(twice, method), mean(once, method))


def few_samples(method: str, count: int) -> float:
    """How much more than the truth comes from next to no samples, seeds taken together."""
    slab = Slab(n=1.0, light_angle=0.0)
    setup = replace(slab_setup(slab, 0.4, 0.1), size=1)
    values = [mean(setup, method, light_samples=count, seed=seed)[0] for seed in range(8)]
    return max(float(np.mean(values)) / slab.radiance() - 1, 0.0)


def huge_kernel(method: str, size: float) -> float:
    """The same for kernels larger than the object: light is carried out of it, none is added."""
    slab = Slab(n=1.0)
    value = mean(slab_setup(slab, 0.4, 0.1), method, kernel_size=size)
    return max(float(value[0]) / slab.radiance() - 1, 0.0)


def refused(method: str, **params: object) -> float:
    """0 where the library refuses the parameters with one sentence, 1 where it renders."""
    try:
        mean(slab_setup(Slab(), 0.4, 0.1), method, **params)
    except errors.AmberlightError as error:
        return 0.0 if str(error) else 1.0
    return 1.0


def dark(method: str, setup: Setup) -> float:
    return float(picture(setup, method, samples=4).max())


BEHIND_A_PLATE = Setup(
    (
        Body(box((-1, -1, -1), (1, 1, 1)), 1.5),
        Body(box((-9, -9, 2), (9, 9, 2.1)), is_opaque=True),
    ),
    (Lamp(SUN), Lamp(POINT, position=(0, 0, 5))),
    Camera((5, 0, 0), (-1, 0, 0), (0, 0, 1), window=3),
    size=4,
)
NO_LIGHT = replace(BEHIND_A_PLATE, lamps=())


# ---- Tubes ---------------------------------------------------------------------------------------


def half_in_shadow(method: str) -> float:
    """A plate covers half of a matched slab: means over a window across the edge of its shadow."""
    slab = Slab(n=1.0, light_angle=0.0)
    setup = slab_setup(slab, 0.4, 0.1)
    plate = Body(box((0, -9, 2), (9, 9, 2.1)), is_opaque=True)
    z = np.radians(45)
    camera = Camera((0.5, 8 * np.sin(z), 8 * np.cos(z)), (0, -np.sin(z), -np.cos(z)), window=0.02)
    lit = replace(camera, at=(-0.5, 8 * np.sin(z), 8 * np.cos(z)))
    bodies = (*setup.bodies, plate)
    seen = [
        mean(replace(setup, bodies=bodies, camera=c, size=1), method, samples=64)[0]
        for c in (camera, lit)
    ]
    return max(abs(seen[0]), abs(seen[1] - slab.radiance())) / slab.radiance()


def lit_along_a_face(method: str) -> float:
    """The sun runs exactly along four faces of a matched box: they get nothing, the fifth all."""
    camera = Camera((0.3, 5, 0.2), (0, -1, 0), (0, 0, 1))
    setup = Setup((Body(BOX),), (Lamp(SUN),), camera)
    truth = 0.4 / (4 * np.pi) * np.exp(-0.5 * 0.8) * -np.expm1(-0.5 * 2) / 0.5
    return relative(mean(setup, method, samples=4), truth)


ALONG = "closed form; relative"
CASES = [
    *(
        Case(
            f"slab, n = {n}, {t:g} rad from the light{' behind' if behind else ''}",
            ALONG,
            1e-3,
            lambda m, t=t, n=n, behind=behind: slab_along(m, t, n, behind),
            bound_points=2e-2,
        )
        for n in (1.0, 1.5)
        for behind in (False, True)
        for t in (0.0, 1e-7, 1e-5, 1e-4, 1e-2)
    ),
    *(
        Case(
            f"sphere of index 1, {t:g} rad from the light{', against it' if sign < 0 else ''}",
            ALONG,
            3e-3,
            lambda m, t=t, sign=sign: sphere_along(m, t, sign),
            bound_points=3e-2,
        )
        for sign in (1.0, -1.0)
        for t in (0.0, 1e-5, 1e-3)
    ),
    *(
        Case(
            f"view past a lamp at {x:g} m",
            "quadrature, matched box; relative",
            b,
            lambda m, x=x: point_along(m, x),
            bound_points=6e-2,
        )
        for x, b in ((1e-1, 2e-2), (1e-3, 2e-3), (1e-5, 0.1))
    ),
    *(
        Case(
            f"view {h:g} m below a lit face",
            "closed form; relative",
            1e-3,
            lambda m, h=h: beside_a_face(m, h),
            bound_points=5e-2,
        )
        for h in (1e-1, 1e-3, 1e-5)
    ),
    *(
        Case(
            f"silhouette of a sphere, {h:g} below its edge",
            "quadrature; relative, the mesh of 81 920 facets included",
            b,
            lambda m, h=h: silhouette(m, h),
            bound_points=0.8,
        )
        for h, b in ((1e-2, 1e-3), (1e-3, 3e-2))
    ),
    *(
        Case(
            f"camera {abs(h):g} m {'inside' if h < 0 else 'above'} the boundary",
            "closed form, matched slab; relative",
            1e-3,
            lambda m, h=h: starts_at(m, h),
            bound_points=4e-2,
        )
        for h in (1e-3, 1e-6, 0.0, -1e-6, -1e-3, -0.5)
    ),
    *(
        Case(
            name,
            "quadrature, refracting sphere, a window of rays; relative",
            2e-2,
            lambda m, a=a: sphere_ray(m, *a),
            bound_points=3e-2,
        )
        for name, a in (
            ("across a caustic", (1.5, 0.0, 0.55, 0.1)),
            ("beside the focus of a sphere of index 2", (2.0, 0.02, 0.9, 0.1)),
        )
    ),
    Case(
        "coincident samples",
        "two lamps in one place are one twice as bright; relative",
        1e-5,
        coincident,
        bound_points=2e-2,
    ),
    *(
        Case(
            f"{n} light sample{'s' if n > 1 else ''}",
            "no brighter than the truth; excess",
            0.0,
            lambda m, n=n: few_samples(m, n),
            POINTS,
            bound_points=0.2,
        )
        for n in (1, 2, 100)
    ),
    *(
        Case(
            f"kernel size {k:g}",
            "no brighter than the truth; excess",
            0.0,
            lambda m, k=k: huge_kernel(m, k),
            POINTS,
            bound_points=1e-2,
        )
        for k in (1e3, 1e6)
    ),
    Case("0 light samples", "refused", 0.0, lambda m: refused(m, light_samples=0)),
    Case("0 camera samples", "refused", 0.0, lambda m: refused(m, samples=0)),
    Case(
        "all light behind a plate", "nothing; W m^-2 sr^-1", 0.0, lambda m: dark(m, BEHIND_A_PLATE)
    ),
    Case("no light", "nothing; W m^-2 sr^-1", 0.0, lambda m: dark(m, NO_LIGHT)),
    Case(
        "shadow across two large triangles",
        "dark and lit halves of a matched slab; relative",
        1e-3,
        half_in_shadow,
        bound_points=2e-2,
    ),
    Case(
        "sun along four faces", "closed form; relative", 1e-3, lit_along_a_face, bound_points=4e-2
    ),
]
