# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes that nobody would build on purpose, and places where floats are far apart."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from api import SINGLE, _ffi
from hard import POINTS, ROOT, Case
from meshes import Mesh, box, bumpy_sphere, icosphere, large_slab, read_obj, subdivide
from oracles import Slab
from scenes import POINT, SUN, Body, Camera, Lamp, Setup, difference, mean, picture, relative
from table_media import slab_setup

CUBE = box((-1, -1, -1), (1, 1, 1))
BUDDHA = ROOT.parent / "shared/meshes/buddha.obj"


# ---- The same surface, made of other triangles ---------------------------------------------------


def cube_setup(mesh: Mesh, ior: float = 1.3, **fields: object) -> Setup:
    """A cube under a lamp, seen askew, 8 x 8."""
    return Setup(
        (Body(mesh, ior, (0.4, 0.5, 0.3), 0.2, 0.2, **fields),),
        (Lamp(POINT, color=20.0, position=(0.7, 0.4, 3.1)),),
        Camera((3, 2, 4), (-3, -2, -4), window=3.2),
        size=8,
    )


@cache
def cube_picture(method: str, ior: float = 1.3) -> np.ndarray:
    return picture(cube_setup(CUBE, ior), method, samples=4)


def same_cube(method: str, mesh: Mesh, ior: float = 1.3, **fields: object) -> float:
    """Difference of the cube of other triangles to the cube of twelve."""
    return difference(
        picture(cube_setup(mesh, ior, **fields), method, samples=4), cube_picture(method, ior)
    )


def slivers(mesh: Mesh, share: float) -> Mesh:
    """Each triangle cut in three at a point that far from its first edge: one is a sliver."""
    a, b, c = (mesh.positions[mesh.triangles[:, k]] for k in range(3))
    points = (0.5 - share / 2) * (a + b) + share * c
    number = len(mesh.positions) + np.arange(len(points), dtype=np.uint32)
    i, j, k = mesh.triangles.T
    triangles = np.concatenate(
        [np.stack(corners, 1) for corners in ((i, j, number), (j, k, number), (k, i, number))]
    )
    return Mesh(np.concatenate([mesh.positions, points]), triangles.astype(np.uint32))


def with_degenerate_faces(mesh: Mesh) -> Mesh:
    """Triangles without area besides: a point, a line, two equal corners."""
    extra = np.array([[0, 0, 0], [0, 1, 0], [2, 5, 2], [3, 3, 6]], dtype=np.uint32)
    return Mesh(mesh.positions, np.concatenate([mesh.triangles, extra]))


def with_duplicates(mesh: Mesh) -> Mesh:
    return Mesh(mesh.positions, np.concatenate([mesh.triangles, mesh.triangles]))


def turned(mesh: Mesh) -> Mesh:
    return Mesh(mesh.positions, mesh.triangles[:, ::-1].copy(), mesh.normals)


def unshared(mesh: Mesh) -> Mesh:
    """No two triangles share a vertex."""
    corners = mesh.positions[mesh.triangles].reshape(-1, 3)
    return Mesh(corners, np.arange(len(corners), dtype=np.uint32).reshape(-1, 3))


def finer(mesh: Mesh, levels: int) -> Mesh:
    points, triangles = mesh.positions, mesh.triangles
    for _ in range(levels):
        points, triangles = subdivide(points, triangles)
    return Mesh(points, triangles)


def broken_normals(value: float) -> Mesh:
    """Normals that are no directions: replaced by the faces' own."""
    return Mesh(CUBE.positions, CUBE.triangles, np.full_like(CUBE.positions, value))


def fin() -> Mesh:
    """A cube with a quad that stands out of it, from edge to edge: three faces at an edge, and no
    volume behind. Its plane holds the lamp and no camera ray, so that nothing meets it."""
    points = np.array([[-1, -1, -1.5], [1, -1, -1.5]], dtype=np.float64)
    a, b = (
        int(np.argmin(np.linalg.norm(CUBE.positions - p, axis=1)))
        for p in ((-1, -1, -1), (1, -1, -1))
    )
    extra = np.array([[a, b, 8], [b, 9, 8]], dtype=np.uint32)
    return Mesh(np.concatenate([CUBE.positions, points]), np.concatenate([CUBE.triangles, extra]))


# ---- Open meshes ---------------------------------------------------------------------------------


def open_below(method: str) -> float:
    """A dense slab without a bottom: nothing is left of the light there."""
    slab = Slab(sigma_s=10.0, sigma_t=20.0)
    setup = slab_setup(slab, 10.0, 10.0)
    body = setup.bodies[0]
    z = body.mesh.positions[body.mesh.triangles][..., 2]
    keep = ~np.all(z < -0.5, axis=1)
    mesh = Mesh(body.mesh.positions, body.mesh.triangles[keep])
    body = replace(body, mesh=mesh, black=body.black[keep])
    value = mean(replace(setup, bodies=(body,)), method, samples=4)
    return relative(value, slab.radiance())


def one_triangle(method: str) -> float:
    """A single triangle, index 1, dense: half a space under it, as far as light gets."""
    mesh = Mesh(np.array([[-3.0, -3, 0], [4, -2, 0], [-1, 5, 0]]), np.array([[0, 1, 2]], np.uint32))
    light = np.array([0.6, 0, -0.8])
    setup = Setup((Body(mesh, 1.0, 30.0, 20.0),), (Lamp(SUN, direction=light),), Camera(window=0.1))
    truth = 0.6 / (4 * np.pi) * 0.8 / (0.8 + 1)
    return relative(mean(setup, method, samples=4), truth)


# ---- Objects that touch --------------------------------------------------------------------------

THROUGH = SINGLE | _ffi.AMB_EFFECT_BACKGROUND | _ffi.AMB_EFFECT_TRANSMITTED_LIGHT


def stack(method: str, gap: float, n: float) -> float:
    """Two slabs of half the thickness, one on the other, index 1: one slab."""
    slab = Slab(n=1.0)
    upper, lower = large_slab(0.5, 3.0), large_slab(0.5, 3.0)
    lower = Mesh(lower.positions - [0, 0, 0.5 + gap], lower.triangles)
    setup = slab_setup(slab, 0.4, 0.1)
    bodies = tuple(Body(mesh, n, 0.4, 0.1) for mesh in (upper, lower))
    value = mean(
        replace(setup, bodies=bodies), method, samples=16, effects=THROUGH, light_samples=2**15
    )
    return relative(value, slab.radiance())


def object_inside(method: str) -> float:
    """A ball of the same stuff and index inside of a cube changes nothing."""
    cube = cube_setup(CUBE, 1.0)
    ball = replace(cube.bodies[0], mesh=Mesh(0.5 * icosphere(3).positions, icosphere(3).triangles))
    both = replace(cube, bodies=(*cube.bodies, ball), size=1)
    alone = replace(cube, size=1)
    a, b = (
        mean(s, method, samples=256, effects=THROUGH, light_samples=2**16) for s in (both, alone)
    )
    return relative(a, b)


def crossing(method: str) -> float:
    """One mesh of two boxes that overlap, index 1, under a sun along x: light and view are in the
    medium wherever one of them is."""
    first, second = box((-1, -1, -1), (0.3, 1, 1)), box((-0.3, -0.8, -0.7), (1.2, 0.8, 0.6))
    mesh = Mesh(
        np.concatenate([first.positions, second.positions]),
        np.concatenate([first.triangles, second.triangles + 8]).astype(np.uint32),
    )
    setup = Setup(
        (Body(mesh),), (Lamp(SUN, direction=(1, 0, 0)),), Camera((0.1, 0.2, 5), window=2e-2)
    )
    # Down at x = 0.1 through the first box, which holds the second there; light came from -1.
    truth = 0.4 / (4 * np.pi) * np.exp(-0.5 * 1.1) * -np.expm1(-0.5 * 2) / 0.5
    value = mean(setup, method, samples=16, light_samples=2**16)
    return relative(value, truth)


# ---- Far from the origin, large, small -----------------------------------------------------------


def rotation(seed: int) -> np.ndarray:
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


BALL = Setup(
    (Body(bumpy_sphere(3), 1.5, (0.4, 0.5, 0.3), 0.2, 0.3),),
    (Lamp(POINT, color=20.0, position=(2.5, 1.5, 2.8)),),
    Camera((0, 0, 5), window=1.6),
    size=8,
)


@cache
def ball_picture(method: str) -> np.ndarray:
    return picture(BALL, method, samples=4)


def moved_ball(method: str, **placed: object) -> float:
    return difference(picture(BALL.placed(**placed), method, samples=4), ball_picture(method))


def rounded_ball(method: str, distance: float) -> float:
    """Vertices given in world coordinates that far out, against the same rounded vertices at the
    origin: what the format of the input loses is not the renderer's."""
    move = np.array([distance, -distance, 0.7 * distance]).astype(np.float32).astype(np.float64)
    body = BALL.bodies[0]
    rounded = (body.mesh.positions + move).astype(np.float32).astype(np.float64) - move
    body = replace(body, mesh=Mesh(rounded, body.mesh.triangles, body.mesh.normals))
    near = replace(BALL, bodies=(body,))
    far = near.placed(move=move, moves_vertices=True)

    # Lamp and camera are rounded too: take places that floats have there.
    def snap(place: object) -> np.ndarray:
        return (np.asarray(place) + move).astype(np.float32).astype(np.float64) - move

    lamps = tuple(replace(lamp, position=snap(lamp.position)) for lamp in BALL.lamps)
    camera = replace(BALL.camera, at=snap(BALL.camera.at))
    near, far = (replace(s, lamps=lamps, camera=camera) for s in (near, far))
    return difference(picture(far, method, samples=4), picture(near, method, samples=4))


def millions(method: str) -> float:
    """Each of 20 triangles halved nine times along its edges: 5 242 880."""
    solid = icosphere(0)
    flat = Mesh(solid.positions, solid.triangles)
    few, many = (cube_setup(mesh, 1.3) for mesh in (flat, finer(flat, 9)))
    return difference(*(picture(s, method, samples=4) for s in (many, few)))


def buddha(method: str) -> float:
    """A scanned mesh with 50 edges that three or more faces share: two estimators agree."""
    mesh = read_obj(BUDDHA)
    middle = (mesh.positions.min(0) + mesh.positions.max(0)) / 2
    size = float(np.ptp(mesh.positions, axis=0).max())
    mesh = Mesh((mesh.positions - middle) * (2 / size), mesh.triangles, mesh.normals)
    setup = Setup(
        (Body(mesh, 1.5, 1.0, 0.3),),
        (Lamp(POINT, color=20.0, position=(2.5, 3.5, 2.8)),),
        Camera((0, 0, 5), window=1.6),
        size=6,
    )
    values = [mean(setup, m, samples=16, light_samples=2**17) for m in (method, "SPECULAR")]
    return relative(*values)


SAME = "the picture of the cube of 12 triangles; rel_rmse"
MOVED = "the picture at the origin; rel_rmse"


def mesh_case(name: str, mesh: Mesh, bound: float = 2e-2) -> Case:
    """Tubes depend on how faces are cut, by their own error."""
    return Case(name, SAME, bound, lambda m: same_cube(m, mesh), bound_points=2e-2)


CASES = [
    mesh_case("slivers, aspect 1e3", slivers(CUBE, 1e-3)),
    mesh_case("slivers, aspect 1e6", slivers(CUBE, 1e-6)),
    mesh_case("degenerate faces", with_degenerate_faces(CUBE)),
    mesh_case("duplicate faces", with_duplicates(CUBE)),
    mesh_case("no vertex shared", unshared(CUBE)),
    mesh_case("inside out", turned(CUBE)),
    mesh_case("49 152 triangles", finer(CUBE, 6)),
    mesh_case("normals of zero", broken_normals(0.0)),
    mesh_case("normals that are not numbers", broken_normals(np.nan)),
    mesh_case("an edge of three faces", fin()),
    Case(
        "no bottom, dense", "closed form of the slab; relative", 1e-3, open_below, bound_points=4e-2
    ),
    Case(
        "one triangle, dense",
        "closed form of a half space; relative",
        1e-3,
        one_triangle,
        bound_points=0.3,
    ),
    Case(
        "two slabs face to face",
        "closed form of one slab; relative",
        1e-3,
        lambda m: stack(m, 0.0, 1.0),
        POINTS,
        bound_points=3e-2,
    ),
    Case(
        "two slabs 1e-5 m apart",
        "closed form of one slab; relative",
        1e-3,
        lambda m: stack(m, 1e-5, 1.0),
        POINTS,
        bound_points=3e-2,
    ),
    Case(
        "object of the same stuff inside",
        "the picture without it; relative",
        1e-3,
        object_inside,
        POINTS,
        bound_points=3e-2,
    ),
    Case(
        "mesh that crosses itself",
        "closed form of the union; relative",
        1e-3,
        crossing,
        POINTS,
        bound_points=3e-2,
    ),
    *(
        Case(
            f"world {s:g} times as large",
            MOVED,
            1e-3,
            lambda m, s=s: moved_ball(m, scale=s),
            bound_points=2e-2,
        )
        for s in (1e-6, 1e-3, 1e3, 1e6)
    ),
    Case(
        "turned at random", MOVED, 5e-3, lambda m: moved_ball(m, turn=rotation(3)), bound_points=0.1
    ),
    *(
        Case(
            f"moved by {x:g} by its matrix",
            MOVED,
            b,
            lambda m, x=x: moved_ball(m, move=(x, -x, 0.7 * x)),
            bound_points=b,
        )
        for x, b in ((1e2, 1e-3), (1e4, 1e-3), (1e5, 5e-3))
    ),
    *(
        Case(
            f"vertices {x:g} from the origin",
            "the same rounded mesh at the origin; rel_rmse",
            b,
            lambda m, x=x: rounded_ball(m, x),
            bound_points=b,
        )
        for x, b in ((1e3, 1e-3), (1e5, 1e-3))
    ),
    Case(
        "5 million triangles",
        "the picture of the icosahedron of 20; rel_rmse",
        2e-2,
        millions,
        ("POINTS_COVARIANCE", "TUBES"),
        bound_points=2e-2,
    ),
    Case(
        "non-manifold scan",
        "exact connections; relative",
        1e-2,
        buddha,
        ("POINTS_COVARIANCE", "TUBES"),
        bound_points=2e-2,
        needs=BUDDHA,
    ),
]
