# SPDX-License-Identifier: GPL-3.0-or-later
"""The planner's table of scenes: thin to thick, dark to white, matched to 2.4, point to
environment, nested, and nothing at all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from api import _ffi, handles, look, rgb
from meshes import Mesh, box, bumpy_sphere, icosphere
from numpy.typing import ArrayLike

Place = tuple[float, float, float]
AddLamp = Callable[[handles.Scene], None]


def sphere() -> Mesh:
    return icosphere(3)


def cube() -> Mesh:
    return box((-0.8, -0.8, -0.8), (0.8, 0.8, 0.8))


def pane() -> Mesh:
    return box((-2.0, -0.1, -2.0), (2.0, 0.1, 2.0))


def bumpy() -> Mesh:
    return bumpy_sphere(4)


@dataclass(frozen=True)
class Body:
    """A translucent object; coefficients are RGB or one number, 1/m."""

    sigma_s: ArrayLike = 0.0
    sigma_a: ArrayLike = 0.0
    ior: float = 1.5
    g: float = 0.0
    mesh: Callable[[], Mesh] = sphere
    place: Place = (0.0, 0.0, 0.0)
    size: float = 1.0

    def add(self, scene: handles.Scene, name: str) -> None:
        material = scene.add_material(
            name,
            surface=_ffi.AMB_SURFACE_DIELECTRIC,
            ior=self.ior,
            sigma_a=rgb(self.sigma_a),
            lobes=[(rgb(self.sigma_s), self.g)],
        )
        add_mesh(scene, name, self.mesh(), material, self.place, self.size)


def add_mesh(
    scene: handles.Scene, name: str, mesh: Mesh, material: int, place: Place, size: float
) -> None:
    domain = _ffi.AMB_NORMALS_NONE if mesh.normals is None else _ffi.AMB_NORMALS_VERTEX
    shape = scene.add_mesh(name, mesh.positions, mesh.triangles, mesh.normals, domain)
    to_world = np.diag([size, size, size, 1.0])
    to_world[:3, 3] = place
    scene.add_object(name, shape, to_world.tolist(), [material])


def point(position: Place = (3.0, -1.0, 2.0), intensity: float = 20.0) -> AddLamp:
    return lambda scene: void(
        scene.add_light(_ffi.AMB_LIGHT_POINT, "point", color=rgb(intensity), position=rgb(position))
    )


def sun(direction: Place = (-1.0, 0.5, -1.0), irradiance: float = 2.0) -> AddLamp:
    return lambda scene: void(
        scene.add_light(_ffi.AMB_LIGHT_SUN, "sun", color=rgb(irradiance), direction=rgb(direction))
    )


def spot(position: Place, direction: Place, size: float = 0.5) -> AddLamp:
    return lambda scene: void(
        scene.add_light(
            _ffi.AMB_LIGHT_SPOT,
            "spot",
            color=rgb(20.0),
            position=rgb(position),
            direction=rgb(direction),
            spot_size=size,
            spot_blend=0.2,
        )
    )


def area(position: Place, direction: Place, size: float = 1.0) -> AddLamp:
    return lambda scene: void(
        scene.add_light(
            _ffi.AMB_LIGHT_AREA,
            "area",
            color=rgb(10.0),
            position=rgb(position),
            direction=rgb(direction),
            tangent=(0.0, 1.0, 0.0),
            size=(size, size),
        )
    )


def void(_: object) -> None:
    """For what is called for its effect."""


@dataclass(frozen=True)
class PlannerScene:
    name: str
    bodies: tuple[Body, ...]
    lamps: tuple[AddLamp, ...] = (point(),)
    world: ArrayLike = 0.2
    floor: bool = False

    def build(self, scene: handles.Scene) -> None:
        for i, body in enumerate(self.bodies):
            body.add(scene, f"body {i}")
        for lamp in self.lamps:
            lamp(scene)
        if self.floor:
            grey = scene.add_material("floor", albedo=rgb(0.5))
            add_mesh(scene, "floor", box((-5, -5, -1.6), (5, 5, -1.5)), grey, (0, 0, 0), 1.0)
        scene.set_world(rgb(self.world))
        scene.set_camera(
            _ffi.AMB_CAMERA_PERSPECTIVE,
            look((0.0, -5.0, 0.8), (0.0, 5.0, -0.8), (0.0, 0.0, 1.0)).tolist(),
            window=(-0.3, 0.3, -0.3, 0.3),
            clip_start=1e-3,
            clip_end=1e3,
        )


RESIN = Body(0.5, (0.05, 0.1, 0.2))
GLASS = Body(0.0, 0.0)

SCENES = (
    PlannerScene("thin resin", (Body(0.05, 0.02),)),
    PlannerScene("faint haze in a bright room", (Body(0.003, 0.0),), world=1.0),
    PlannerScene("resin", (RESIN,)),
    PlannerScene("resin in the dark", (RESIN,), world=0.0),
    PlannerScene("resin on a floor", (RESIN,), floor=True),
    PlannerScene("bumpy resin", (replace(RESIN, mesh=bumpy),)),
    PlannerScene("cube of resin", (replace(RESIN, mesh=cube),)),
    PlannerScene("clear cube with haze", (Body(0.1, 0.005, mesh=cube),)),
    PlannerScene("wax", (Body((5.0, 4.8, 4.0), (0.02, 0.05, 0.2), 1.44),)),
    PlannerScene("thick and white", (Body(15.0, 0.01, 1.4),)),
    PlannerScene("ink", (Body(0.02, 5.0),)),
    PlannerScene("thick and dark", (Body(0.5, 10.0),)),
    PlannerScene("dim amber", (Body(0.05, (0.5, 1.0, 3.0), 1.54),)),
    PlannerScene("matched, white", (Body(0.5, 0.0, 1.0),)),
    PlannerScene("matched, dark", (Body(0.1, 1.0, 1.0),)),
    PlannerScene("matched, thick", (Body(5.0, 0.05, 1.0),)),
    PlannerScene("almost matched", (Body(0.5, 0.1, 1.05),)),
    PlannerScene("diamond", (Body(0.05, 0.01, 2.4),)),
    PlannerScene("index 2.4, thick", (Body(4.0, 0.1, 2.4),)),
    PlannerScene("less than outside", (Body(0.5, 0.1, 0.75),)),
    PlannerScene("forward", (Body(1.0, 0.05, g=0.9),)),
    PlannerScene("backward", (Body(1.0, 0.05, g=-0.5),)),
    PlannerScene("sun", (RESIN,), (sun(),), world=0.0),
    PlannerScene("spot", (RESIN,), (spot((3.0, -1.0, 2.0), (-3.0, 1.0, -2.0)),), world=0.02),
    PlannerScene("area lamp", (RESIN,), (area((3.0, 0.0, 2.0), (-3.0, 0.0, -2.0)),)),
    PlannerScene("environment alone", (RESIN,), (), world=1.0),
    PlannerScene("clear glass", (GLASS,), floor=True),
    PlannerScene("coloured glass", (Body(0.0, (0.1, 1.0, 3.0)),), (sun(),), floor=True),
    PlannerScene("lamp turned away", (RESIN,), (spot((3.0, 0.0, 2.0), (1.0, 0.0, 1.0)),)),
    PlannerScene(
        "air bubble in resin", (RESIN, Body(0.0, 0.0, 1.0, size=0.4, place=(0.1, -0.2, 0.1)))
    ),
    PlannerScene("glass around a core", (GLASS, Body(2.0, 0.1, 1.33, size=0.6))),
    PlannerScene(
        "resin behind a pane",
        (RESIN, replace(GLASS, mesh=pane, place=(0.0, -1.8, 0.0))),
        (point((1.0, -4.0, 2.0)),),
    ),
    PlannerScene(
        "one behind the camera", (GLASS, replace(RESIN, place=(0.0, -12.0, 0.0))), floor=True
    ),
    PlannerScene(
        "beads", (RESIN, *(replace(RESIN, size=0.1, place=(x, -1.3, -0.7)) for x in (-0.4, 0.5)))
    ),
    PlannerScene("floor alone", (), floor=True),
    PlannerScene("nothing at all", (), ()),
)
