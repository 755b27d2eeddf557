# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps and cameras where they should not be: on surfaces, inside, far, without extent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from api import errors, render
from hard import ALL, METHODS, POINTS, TRIANGLES, Case
from meshes import box, bumpy_sphere, icosphere, large_slab
from oracles import fresnel, refracted_cosine
from scenes import (
    AREA,
    POINT,
    SPOT,
    SUN,
    Body,
    Camera,
    Lamp,
    Setup,
    difference,
    mean,
    picture,
    relative,
)
from truths import matched_box_and_points

CUBE = box((-1, -1, -1), (1, 1, 1))


# ---- Lamps near and in a matched box -------------------------------------------------------------


def lamp_at(method: str, z: float, aside: float = 0.3, **params: object) -> float:
    """A lamp z above the top of a matched box, and a vertical camera ray beside it."""
    lamp = (0.1, 0.2, 1 + z)
    setup = Setup(
        (Body(CUBE),), (Lamp(POINT, position=lamp),), Camera((0.1 + aside, 0.2, 6), window=2e-3)
    )
    truth = matched_box_and_points((0.1 + aside, 0.2, 6), (0, 0, -1), [lamp], 0.4, 0.5)
    return relative(mean(setup, method, samples=4, light_samples=2**16, **params), truth)


def refused(method: str, z: float) -> float:
    """0 where a lamp inside is refused with the lamp's name, 1 where it is rendered."""
    try:
        lamp_at(method, z)
    except errors.AmberlightError as error:
        return 0.0 if "lamp 0" in str(error) else 1.0
    return 1.0


SPHERE = Setup(
    (Body(icosphere(4), 1.5, (0.4, 0.5, 0.3), 0.2),),
    (),
    Camera((4, 0.6, 0.5), (-4, -0.6, -0.5), (0, 0, 1), window=1.5),
    size=6,
)


def as_point(method: str, lamp: Lamp) -> float:
    """A lamp without extent to speak of against a point of the same intensity."""
    point = Lamp(POINT, color=10.0, position=(0.5, 0.4, 4))
    a, b = (
        picture(replace(SPHERE, lamps=(x,)), method, samples=4, light_samples=2**15)
        for x in (lamp, point)
    )
    return difference(a, b)


def area_lamp(size: float) -> Lamp:
    to_middle = -np.array([0.5, 0.4, 4])
    # cos = 1 in the middle: its falloff over the sphere is the only difference to a point.
    return Lamp(
        AREA, color=10.0 / size**2, position=(0.5, 0.4, 4), direction=to_middle, size=(size, size)
    )


def disc_lamp(radius: float) -> Lamp:
    return Lamp(POINT, color=10.0, position=(0.5, 0.4, 4), radius=radius)


def area_error(method: str, size: float) -> float:
    """Of an area lamp of that size against one of a thousandth of a metre."""
    a, b = (
        picture(replace(SPHERE, lamps=(area_lamp(s),)), method, samples=4, light_samples=2**15)
        for s in (size, 1e-3)
    )
    return difference(a, b)


def sun_error(method: str, angle: float) -> float:
    a, b = (
        picture(
            replace(SPHERE, lamps=(Lamp(SUN, direction=(0.1, 0.2, -1), more={"angle": x}),)),
            method,
            samples=4,
            light_samples=2**15,
        )
        for x in (angle, 0.0)
    )
    return difference(a, b)


def far_lamp(method: str, distance: float) -> float:
    """A lamp that far away of as much irradiance as a sun."""
    axis = np.array([0.36, 0.48, 0.8])
    far = Lamp(POINT, color=distance**2, position=axis * distance)
    sun = Lamp(SUN, direction=-axis)
    a, b = (
        picture(replace(SPHERE, lamps=(x,)), method, samples=4, light_samples=2**15)
        for x in (far, sun)
    )
    return difference(a, b)


def spot_flux(method: str, size: float) -> float:
    """Flux that a cone of this full angle brings: its solid angle, 1 W/sr."""
    lamp = Lamp(
        SPOT,
        position=(0.05, 0.02, 3),
        direction=(0, 0, -1),
        more={"spot_size": size, "spot_blend": 0.0, "spot_cosine": 0.0},
    )
    setup = replace(SPHERE, lamps=(lamp,), size=1)
    params = {"threads": 1, "light_samples": 2**14}
    report = render(setup.build, 1, **(params | METHODS[method])).report["light"]
    return relative(report["flux_incident"][0], 4 * np.pi * np.sin(size / 4) ** 2)


def trapped_light(method: str, ior: float) -> float:
    """The picture of walls that keep the light in for sixteen reflections; points are the truth."""
    body = Body(bumpy_sphere(3), ior, (0.4, 0.5, 0.3), 0.2)
    setup = replace(SPHERE, bodies=(body,), lamps=(Lamp(POINT, position=(2, 1, 3)),))
    found, truth = (
        mean(setup, m, samples=8, light_samples=2**18, light_bounces=16, kernel_size=4.0)
        for m in (method, "POINTS_COVARIANCE")
    )
    return relative(found, truth)


# ---- Cameras -------------------------------------------------------------------------------------


def far_camera(method: str, distance: float, is_perspective: bool) -> float:
    """A camera that far away against an orthographic one nearby."""
    d = np.array([1.0, 0, 0])  # in floats, so that the library is given the same view
    lamps = (Lamp(POINT, color=10.0, position=(0.5, 0.4, 4)),)
    near = replace(SPHERE, lamps=lamps, camera=Camera(5 * d, -d, (0, 0, 1), window=1.5))
    window = 1.5 / distance if is_perspective else 1.5
    far = replace(
        near,
        camera=Camera(
            distance * d,
            -d,
            (0, 0, 1),
            window=window,
            is_perspective=is_perspective,
            clip=(1e-3, 1e9),
        ),
    )
    return difference(*(picture(s, method, samples=4) for s in (far, near)))


def camera_in_medium(method: str) -> float:
    """Inside a slab of index 1.5, looking up to where the light comes in."""
    n, depth, cosine = 1.5, 0.6, 0.8
    d = np.array([0.6, 0, cosine])
    camera = Camera((0, 0, -depth), d, window=1e-3, clip=(1e-6, 1e3))
    light_out = np.cos(np.radians(30))
    light = (0.5, 0, -light_out)
    setup = Setup((Body(large_slab(1.0, 4.0), n),), (Lamp(SUN, direction=light),), camera)
    inside = float(refracted_cosine(light_out, 1, n))
    enters = float(1 - fresnel(light_out, 1, n)) * light_out / inside
    # Light at depth z: exp(-sigma z / inside); z = depth - t cosine.
    k = 0.5 * (1 - cosine / inside)
    path = depth / cosine
    gathered = np.exp(-0.5 * depth / inside) * (path if k == 0 else -np.expm1(-k * path) / k)
    truth = 0.4 / (4 * np.pi) * enters * gathered
    return relative(mean(setup, method, samples=4), truth)


def shifted(method: str, shift: float) -> float:
    """A lens shifted by ten windows against a camera that looks there."""
    lamps = (Lamp(POINT, color=10.0, position=(0.5, 0.4, 4)),)
    aside = np.array([0.0, 0.4 * shift, 0.0])
    straight = replace(
        SPHERE,
        lamps=lamps,
        size=1,
        camera=Camera(
            (4, 0, 0) - aside, aside - (4, 0, 0), (0, 0, 1), window=1e-3, is_perspective=True
        ),
    )
    # tan of the angle to the middle, in windows of a thousandth.
    tan = float(np.linalg.norm(aside) / 4)
    lens = replace(
        straight,
        camera=Camera(
            (4, 0, 0) - aside,
            (-1, 0, 0),
            (0, 0, 1),
            window=1e-3,
            shift=(tan / 1e-3, 0),
            is_perspective=True,
        ),
    )
    values = [mean(s, method, samples=16) for s in (lens, straight)]
    return relative(*values)


def one_pixel(method: str) -> float:
    """The mean of a picture of 16 x 16 and its one pixel."""
    lamps = (Lamp(POINT, color=10.0, position=(0.5, 0.4, 4)),)
    setup = replace(SPHERE, lamps=lamps)
    a = mean(replace(setup, size=1), method, samples=1024)
    return relative(a, mean(replace(setup, size=16), method, samples=4))


QUADRATURE = "quadrature, matched box; relative"
AS_POINT = "the picture under a point; rel_rmse"
CASES = [
    *(
        Case(
            f"lamp {z:g} m above the surface",
            QUADRATURE,
            b,
            lambda m, z=z: lamp_at(m, z),
            bound_points=4e-2,
        )
        for z, b in ((1e-1, 1e-2), (1e-2, 1e-2), (1e-4, 1e-2), (1e-6, 0.5))
    ),
    Case(
        "lamp on the surface",
        QUADRATURE,
        2e-2,
        lambda m: lamp_at(m, 0.0),
        POINTS,
        bound_points=8e-2,
    ),
    *(
        Case(
            f"lamp {z:g} m inside",
            QUADRATURE,
            2e-2,
            lambda m, z=z: lamp_at(m, -z),
            POINTS,
            bound_points=4e-2,
        )
        for z in (1e-6, 1e-2, 0.5)
    ),
    Case("lamp inside, tubes", "refused, by its name", 0.0, lambda m: refused(m, -0.5), TRIANGLES),
    *(
        Case(
            f"lamp {x:g} m away",
            "the picture under a sun; rel_rmse",
            b,
            lambda m, x=x: far_lamp(m, x),
            bound_points=max(b, 3e-2),
        )
        for x, b in ((1e4, 2e-3), (1e6, 2e-3))
    ),
    *(
        Case(
            f"disc of radius {r:g} m",
            AS_POINT,
            1e-3,
            lambda m, r=r: as_point(m, disc_lamp(r)),
            (*POINTS, "TUBES"),
            bound_points=3e-2,
        )
        for r in (1e-3, 1e-6, 1e-20)
    ),
    *(
        Case(
            f"area of {s:g} m",
            "the picture of one of 1 mm; rel_rmse",
            1e-3,
            lambda m, s=s: area_error(m, s),
            (*POINTS, "TUBES"),
            bound_points=3e-2,
        )
        for s in (1e-2, 1e-5, 1e-10)
    ),
    *(
        Case(
            f"sun of {a:g} rad",
            "the picture under a sun without extent; rel_rmse",
            1e-3,
            lambda m, a=a: sun_error(m, a),
            (*POINTS, "TUBES"),
            bound_points=3e-2,
        )
        for a in (1e-3, 1e-6, 1e-20)
    ),
    *(
        Case(
            f"spot of {a:g} rad",
            "flux = its solid angle; relative",
            4e-2,
            lambda m, a=a: spot_flux(m, a),
            ms,
            bound_points=1e-5,
        )
        for a, ms in ((1e-1, ALL), (1e-3, ALL), (1e-5, POINTS), (1e-6, POINTS))
    ),
    *(
        Case(
            f"light trapped at index {n:g}, tubes and points",
            "sixteen reflections by points alone, mean; relative",
            1e-2,
            lambda m, n=n: trapped_light(m, n),
            ("TUBES",),
        )
        for n in (1.01, 1.5, 2.4, 4.0)
    ),
    *(
        Case(
            f"orthographic camera {x:g} m away",
            "the picture from nearby; rel_rmse",
            b,
            lambda m, x=x: far_camera(m, x, False),
            bound_points=b,
        )
        for x, b in ((1e3, 1e-4), (1e6, 1e-4))
    ),
    *(
        Case(
            f"camera {x:g} m away",
            "an orthographic one; rel_rmse",
            b,
            lambda m, x=x: far_camera(m, x, True),
            bound_points=b,
        )
        for x, b in ((1e4, 1e-3), (1e6, 1e-3))
    ),
    Case(
        "camera in the medium, index 1.5",
        "closed form; relative",
        1e-3,
        camera_in_medium,
        bound_points=3e-2,
    ),
    Case(
        "lens shift of 10",
        "a camera turned there; relative",
        1e-3,
        lambda m: shifted(m, 10.0),
        bound_points=5e-3,
    ),
    Case("one pixel", "the mean of 256; relative", 2e-2, one_pixel, bound_points=3e-2),
]
