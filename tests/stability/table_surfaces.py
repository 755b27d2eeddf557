# SPDX-License-Identifier: GPL-3.0-or-later
"""Opaque surfaces: meshes that shine, whatever their faces and their radiance are, images with
any coordinates, and rooms that keep their light."""

from __future__ import annotations

from typing import Any

import numpy as np
from api import Medium, _ffi, add_body, errors, render, rgb
from hard import ONE, Case
from meshes import Mesh, box, icosphere
from numpy.typing import ArrayLike, NDArray
from scenes import Body, Camera, Setup, difference, relative

Array = NDArray[np.float64]
EVERYTHING = (1 << 10) - 1


def square(half: float, height: float) -> Mesh:
    corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
    points = np.array([(x, y, height) for x, y in corners])
    return Mesh(points, np.array([(0, 1, 2), (0, 2, 3)], dtype=np.uint32))


def together(*meshes: Mesh) -> Mesh:
    first = np.cumsum([0, *(len(mesh.positions) for mesh in meshes)])
    faces = [mesh.triangles + start for mesh, start in zip(meshes, first[:-1], strict=True)]
    points = np.concatenate([mesh.positions for mesh in meshes])
    return Mesh(points, np.concatenate(faces).astype(np.uint32))


# ---- Meshes that shine ---------------------------------------------------------------------------

HALF, HEIGHT, RADIANCE = 0.5, 1.0, 8.0
LAMP = square(HALF, HEIGHT)
FLAT = Mesh(
    np.array([(0, 0, 2), (1, 0, 2), (2, 0, 2), (0, 0, 0.8), (0, 0, 0.8), (0, 0, 0.8)]),
    np.array([(0, 1, 2), (3, 4, 5), (0, 0, 0), (1, 1, 2)], dtype=np.uint32),
)


def form_factor(half: float, height: float) -> float:
    """Of a square from the point below its middle."""
    a = half / height
    return float(4 * a / (np.pi * np.sqrt(1 + a * a)) * np.arctan(a / np.sqrt(1 + a * a)))


def floor_error(
    mesh: Mesh, truth: float, radiance: float = RADIANCE, has_ball: bool = False, **placed: Any
) -> float:
    """Radiance of a grey floor right below a mesh that shines, ``truth`` for a radiance of 1; a
    ball of resin may lie aside."""
    bodies = [
        Body(square(8.0, 0.0), is_opaque=True, albedo=0.5),
        Body(mesh, is_opaque=True, emission=radiance),
    ]
    if has_ball:
        ball = icosphere(2)
        bodies.append(Body(Mesh(0.2 * ball.positions + (2, 0, 0.3), ball.triangles), 1.3))
    setup = Setup(tuple(bodies), (), Camera((0, 0, 0.5), window=1e-3), size=4).placed(**placed)
    settings = {"threads": 1, "samples": 4096, "light_samples": 2**12}
    settings["effects"] = _ffi.AMB_EFFECT_INTERREFLECTION
    image = render(setup.build, setup.size, "Surface", **settings)
    return relative(image.pixels.astype(np.float64).mean() / radiance, truth)


BELOW = 0.5 * form_factor(HALF, HEIGHT)


def tiny_faces() -> Mesh:
    ball = icosphere(6)
    return Mesh(1e-4 * ball.positions + (0.3, 0.3, 1.5), ball.triangles)


# ---- Images --------------------------------------------------------------------------------------

PIXELS = np.random.default_rng(1).random((3, 4, 3)).astype(np.float32)
TURNED = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)


def floor_with_image(
    pixels: ArrayLike, uvs: ArrayLike, to_texture: ArrayLike, extension: int, is_closest: bool
) -> Array:
    """The floor below a lamp mesh, in a medium's company; what is seen, (8, 8, 3)."""

    def build(scene: Any) -> None:
        image = np.asarray(pixels, np.float32)
        kind = _ffi.AMB_INTERPOLATION_CLOSEST if is_closest else _ffi.AMB_INTERPOLATION_LINEAR
        texture = scene.add_texture("image", image, extension, kind)
        paint = scene.add_material(
            "paint",
            surface=_ffi.AMB_SURFACE_DIFFUSE,
            albedo=rgb(1),
            texture=texture,
            uv_to_texture=list(np.asarray(to_texture, np.float64)),
        )
        shine = scene.add_material(
            "shine", surface=_ffi.AMB_SURFACE_DIFFUSE, albedo=rgb(0), emission=rgb(RADIANCE)
        )
        level = square(8.0, 0.0)
        placed = np.broadcast_to(np.asarray(uvs, np.float32), (2, 3, 2)).copy()
        for name, mesh, material, places in (
            ("floor", level, paint, placed),
            ("lamp", square(HALF, HEIGHT), shine, None),
        ):
            shape = scene.add_mesh(name, mesh.positions, mesh.triangles, uvs=places)
            scene.add_object(name, shape, np.eye(4).tolist(), [material])
        ball = icosphere(2)
        body = Mesh(0.2 * ball.positions + (0.2, 0, 0.3), ball.triangles)
        add_body(scene, body, Medium(1.3, 1.0, 0.1))
        Setup((), (), Camera((0, 0, 0.9), window=1.0)).build(scene)

    settings = {"threads": 1, "samples": 4, "light_samples": 2**10, "effects": EVERYTHING}
    return render(build, 8, "Combined", **settings).pixels[..., :3].astype(np.float64)


def seen(uvs: ArrayLike, to_texture: ArrayLike = TURNED, **how: Any) -> Array:
    fields = {"extension": _ffi.AMB_EXTENSION_REPEAT, "is_closest": True} | how
    return floor_with_image(PIXELS, uvs, to_texture, **fields)


def one_color(color: ArrayLike) -> Array:
    pixel = np.asarray(color, np.float32).reshape(1, 1, 3)
    return floor_with_image(pixel, 0.3, TURNED, _ffi.AMB_EXTENSION_EDGE, False)


def no_numbers(value: float) -> float:
    """Coordinates that are no numbers count as 0: the first pixel, for each way to go on."""
    truth = one_color(PIXELS[0, 0])
    return max(
        difference(seen(value, extension=extension), truth)
        for extension in range(_ffi.AMB_EXTENSION_MIRROR + 1)
    )


def beyond_numbers(uvs: ArrayLike, to_texture: ArrayLike) -> float:
    """Whatever the place, no colour is brighter than the brightest: what it exceeds it by."""
    brightest = one_color(PIXELS.max(axis=(0, 1)))
    images = [
        seen(uvs, to_texture, extension=extension, is_closest=is_closest)
        for extension in range(_ffi.AMB_EXTENSION_MIRROR + 1)
        for is_closest in (True, False)
    ]
    return float(max(np.max(image - brightest) for image in images) / brightest.mean())


def refused(pixels: ArrayLike) -> float:
    """0 where an image is refused by its name."""
    try:
        floor_with_image(pixels, 0.0, TURNED, 0, True)
    except errors.AmbArgumentError as error:
        return 0.0 if "image" in error.message else 1.0
    return 1.0


# ---- Rooms ---------------------------------------------------------------------------------------


def glowing_room(albedo: float) -> Array:
    """Mean radiance in a closed room whose walls shine."""
    walls = Body(box((-2, -2, -2), (2, 2, 2)), is_opaque=True, albedo=albedo, emission=0.5)
    camera = Camera((0.1, 0.2, 1.8), window=1.0, is_perspective=True)
    settings = {"threads": 1, "samples": 4096, "light_samples": 2**12, "effects": EVERYTHING}
    pixels = render(Setup((walls,), (), camera).build, 8, "Combined", **settings).pixels
    return pixels[..., :3].astype(np.float64).mean(axis=(0, 1))


def room_error(albedo: float) -> float:
    return relative(glowing_room(albedo), 0.5 / (1 - albedo))


FACTOR = "closed form; relative"
AT_RANDOM = "closed form, found by chance; relative"
CASES = [
    Case(
        "mesh lamp with faces of no area",
        FACTOR,
        2e-3,
        lambda _: floor_error(together(FLAT, LAMP, FLAT), BELOW),
        ONE,
    ),
    Case(
        "mesh lamp of a large face and 81 920 tiny ones",
        FACTOR,
        2e-3,
        lambda _: floor_error(together(tiny_faces(), LAMP), BELOW),
        ONE,
    ),
    *(
        Case(
            f"mesh lamp of radiance {x:g}",
            FACTOR if is_lamp else AT_RANDOM,
            2e-3 if is_lamp else 3e-2,
            lambda _, x=x: floor_error(LAMP, BELOW, x, has_ball=True),
            ONE,
        )
        for x, is_lamp in ((1e-38, 0), (1e-29, 1), (1e-10, 1), (1e10, 1), (1e29, 1), (1e30, 0))
    ),
    *(
        Case(
            f"mesh lamp of side {a:g} m",
            "closed form of a point; relative",
            2e-3,
            lambda _, a=a: floor_error(square(a / 2, HEIGHT), 0.5 * a**2 / np.pi, RADIANCE / a**2),
            ONE,
        )
        for a in (1e-3, 1e-10)
    ),
    *(
        Case(
            f"mesh lamp, world {s:g} times as large",
            FACTOR,
            2e-3,
            lambda _, s=s: floor_error(LAMP, BELOW, scale=s),
            ONE,
        )
        for s in (1e-6, 1e6)
    ),
    Case(
        "mesh lamp 1e5 from the origin",
        FACTOR,
        5e-3,
        lambda _: floor_error(LAMP, BELOW, move=(1e5, -1e5, 7e4)),
        ONE,
    ),
    Case(
        "image coordinates that are NaN",
        "the first pixel's colour; rel_rmse",
        1e-6,
        lambda _: no_numbers(np.nan),
        ONE,
    ),
    Case(
        "image placed by a matrix of zeros",
        "the first pixel's colour; rel_rmse",
        1e-6,
        lambda _: difference(seen(0.4, np.zeros(6)), one_color(PIXELS[0, 0])),
        ONE,
    ),
    *(
        Case(
            f"image coordinates of {x:g}",
            "no brighter than the brightest pixel; excess",
            5e-2,
            lambda _, x=x: beyond_numbers([(x, -x), (0, x), (x, 1)], TURNED),
            ONE,
        )
        for x in (1e10, 1e30, np.inf)
    ),
    Case(
        "image placed by a matrix of 3e38",
        "no brighter than the brightest pixel; excess",
        5e-2,
        lambda _: beyond_numbers([(0, 0), (1, 0), (0, 1)], (3e38, -3e38, 1, 3e38, 3e38, -3e38)),
        ONE,
    ),
    *(
        Case(
            f"image of {name}",
            "refused, by its name",
            0.0,
            lambda _, pixels=pixels: refused(pixels),
            ONE,
        )
        for name, pixels in (
            ("0 x 0 pixels", np.zeros((0, 0, 3))),
            ("4 x 0 pixels", np.zeros((0, 4, 3))),
            ("NaN", np.full((1, 1, 3), np.nan)),
            ("infinity", np.full((1, 1, 3), np.inf)),
            ("-1", np.full((1, 1, 3), -1.0)),
            ("2", np.full((1, 1, 3), 2.0)),
        )
    ),
    *(
        Case(
            f"room of albedo {a:g} that glows",
            "emission / (1 - albedo); relative",
            b,
            lambda _, a=a: room_error(a),
            ONE,
        )
        for a, b in ((0.5, 1e-2), (0.9, 2e-2))
    ),
    Case(
        "room of albedo 1 that glows",
        "grows with the samples, and is finite: 1 where it is not",
        0.0,
        lambda _: float(not np.all(np.isfinite(glowing_room(1.0)))),
        ONE,
    ),
]
