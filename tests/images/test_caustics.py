# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that reaches opaque surfaces through translucent objects, against closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from api import Medium, add_body, add_sun, render, rgb, set_orthographic
from api import _ffi as ffi
from meshes import Mesh, box, icosphere

CAUSTICS = ffi.AMB_EFFECT_CAUSTICS
ALBEDO = 0.5
CLEAR = Medium(1.5, 0, 0)


def add_floor(scene: Any, half: float = 50.0) -> None:  # noqa: ANN401
    """A square around the origin that faces up."""
    points = np.array([(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)])
    triangles = np.array([(0, 1, 2), (0, 2, 3)], np.uint32)
    white = scene.add_material("floor", surface=ffi.AMB_SURFACE_DIFFUSE, albedo=rgb(ALBEDO))
    shape = scene.add_mesh("floor", points, triangles, None, ffi.AMB_NORMALS_NONE, None)
    scene.add_object("floor", shape, np.eye(4).tolist(), [white])


def look_down(scene: Any, width: float, height: float = 0.02) -> None:  # noqa: ANN401
    """From under the objects at the floor around the origin."""
    set_orthographic(scene, (0, 0, height), (0, 0, -1), (0, 1, 0), width)


def irradiance(build: Any, size: int = 32, **params: Any) -> np.ndarray:  # noqa: ANN401
    """On the floor, (size, size, 3), W/m^2."""
    settings = {"effects": CAUSTICS, "samples": 4, "light_samples": 2**20} | params
    image = render(build, size, "Surface", **settings)
    return image.pixels.astype(np.float64) * np.pi / ALBEDO


def raised(mesh: Mesh, height: float) -> Mesh:
    return Mesh(mesh.positions + np.array((0, 0, height)), mesh.triangles, mesh.normals)


def fresnel(cos_i: np.ndarray, n: float) -> tuple[np.ndarray, np.ndarray]:
    """Reflectance on entering index n from vacuum, and the cosine inside."""
    cos_t = np.sqrt(1 - (1 - cos_i**2) / n**2)
    s = (cos_i - n * cos_t) / (cos_i + n * cos_t)
    p = (n * cos_i - cos_t) / (n * cos_i + cos_t)
    return (s**2 + p**2) / 2, cos_t


@pytest.mark.parametrize("bounces", [0, 2])
@pytest.mark.parametrize("tilt", [0.0, 0.6])
def test_a_pane_takes_its_reflections_from_the_sun(tilt: float, bounces: int) -> None:
    sigma_a = np.array((0.2, 0.5, 2.0))
    thickness = 0.4

    def build(scene: Any) -> None:  # noqa: ANN401
        add_sun(scene, (np.sin(tilt), 0, -np.cos(tilt)), 3.0)
        add_body(scene, box((-4, -4, 0.1), (4, 4, 0.1 + thickness)), Medium(1.5, 0, sigma_a))
        add_floor(scene)
        look_down(scene, 0.5)

    reflected, cos_t = fresnel(np.array(np.cos(tilt)), 1.5)
    once = np.exp(-sigma_a * thickness / cos_t)
    series = sum((reflected * once) ** (2 * k) for k in range(bounces // 2 + 1))
    expected = 3.0 * np.cos(tilt) * (1 - reflected) ** 2 * once * series
    measured = irradiance(build, light_bounces=bounces)
    assert measured.mean(axis=(0, 1)) == pytest.approx(expected, rel=2e-3)
    assert measured.std(axis=(0, 1)) / expected == pytest.approx(0.0, abs=0.03)


def sphere_paths(b: np.ndarray, centre: float, n: float, bounces: int) -> list[Any]:
    """(radius on the floor, share of the flux, where it lands) of light that falls at distance b
    from the axis on a unit sphere above the floor: reflected, then after 0, 1 .. reflections."""
    cos_i = np.sqrt(1 - b**2)
    reflected, cos_t = fresnel(cos_i, n)
    theta_i, theta_t = np.arccos(cos_i), np.arccos(cos_t)
    paths = []

    def land(angle: np.ndarray, turn: np.ndarray, share: np.ndarray) -> None:
        # From the point at `angle` from +z of the circle, along a direction turned by `turn` from
        # straight down, towards +x.
        x, z = np.sin(angle), np.cos(angle) + centre
        down = np.cos(turn)
        falls = down > 1e-9
        radius = np.abs(x + z * np.sin(turn) / np.where(falls, down, 1))
        paths.append((np.where(falls, radius, np.inf), share))

    land(theta_i, np.pi - 2 * theta_i, reflected)
    angle, turn = theta_i, -(theta_i - theta_t)
    share = 1 - reflected
    for _ in range(bounces + 1):
        # A chord spans pi - 2 theta_t of the circle, and a reflection at its end turns by as much.
        angle = angle + np.pi - 2 * theta_t
        land(angle, turn - (theta_i - theta_t), share * (1 - reflected))
        turn = turn - (np.pi - 2 * theta_t)
        share = share * reflected
    return paths


@pytest.mark.parametrize("bounces", [0, 2])
def test_a_ball_focuses_the_sun(bounces: int) -> None:
    """Flux through squares of the floor, smaller than the shadow and beyond the focus."""
    centre = 1.6
    window = 1.4

    def build(scene: Any) -> None:  # noqa: ANN401
        add_sun(scene, (0, 0, -1), 1.0)
        add_body(scene, raised(icosphere(5), centre), CLEAR)
        add_floor(scene)
        look_down(scene, window, 0.3)

    b = (np.arange(200000) + 0.5) / 200000
    measured = irradiance(build, 96, light_bounces=bounces, samples=16).mean(axis=2)
    for share in (0.25, 0.5, 1.0):
        w = share * window / 2
        expected = 0.0
        for radius, part in sphere_paths(b, centre, 1.5, bounces):
            inside = 1 - 4 / np.pi * np.arccos(np.clip(w / np.maximum(radius, w), 0, 1))
            expected += np.sum(2 * np.pi * b * part * np.clip(inside, 0, 1)) / len(b)
        rim = round(96 * (1 - share) / 2)
        part = measured[rim : 96 - rim, rim : 96 - rim]
        assert part.mean() * (2 * w) ** 2 == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("sigma_s", [0.0, 0.6])
def test_a_block_of_index_1_casts_the_shadow_of_its_medium(sigma_s: float) -> None:
    """What neither absorbs nor scatters goes straight on: Beer and Lambert's law, without noise."""
    sigma_a = np.array((0.2, 1.0, 3.0))
    tilt = 0.4

    def build(scene: Any) -> None:  # noqa: ANN401
        add_sun(scene, (np.sin(tilt), 0, -np.cos(tilt)), 2.0)
        add_body(scene, box((-3, -3, 0.1), (3, 3, 0.6)), Medium(1.0, sigma_s, sigma_a))
        add_floor(scene)
        look_down(scene, 0.5)

    expected = 2 * np.cos(tilt) * np.exp(-(sigma_a + sigma_s) * 0.5 / np.cos(tilt))
    measured = irradiance(build, 8, effects=CAUSTICS)
    assert measured == pytest.approx(np.broadcast_to(expected, measured.shape), rel=1e-4)


def test_switched_off_shadows_are_black() -> None:
    def build(scene: Any) -> None:  # noqa: ANN401
        add_sun(scene, (0, 0, -1), 2.0)
        add_body(scene, box((-3, -3, 0.1), (3, 3, 0.6)), CLEAR)
        add_floor(scene)
        look_down(scene, 0.5)
        scene.set_world(rgb(0))

    assert np.all(irradiance(build, 8, effects=0) == 0.0)


def test_the_world_shines_through_a_pane() -> None:
    """Each direction passes the pane with all its reflections inside: (1 - F) / (1 + F)."""

    def build(scene: Any) -> None:  # noqa: ANN401
        add_body(scene, box((-400, -400, 0.1), (400, 400, 0.3)), CLEAR)
        add_floor(scene)
        look_down(scene, 0.5, 0.05)
        scene.set_world(rgb(1))

    cos_i = np.sqrt((np.arange(4000) + 0.5) / 4000)  # even in cos^2: E = int 1 d(cos^2) pi
    reflected, _ = fresnel(cos_i, 1.5)
    expected = np.pi * np.mean((1 - reflected) / (1 + reflected))
    measured = irradiance(build, 64, samples=64)
    assert measured.mean() == pytest.approx(expected, rel=3e-3)


def test_clear_glass_casts_no_shadow_in_an_even_world() -> None:
    """A small target under a ball: from wherever light comes to it, the world is as bright."""

    def build(scene: Any) -> None:  # noqa: ANN401
        add_body(scene, raised(icosphere(4), 1.3), CLEAR)
        add_floor(scene, 0.02)
        look_down(scene, 0.04)
        scene.set_world(rgb(1))

    measured = irradiance(build, 32, samples=64)
    assert measured.mean() == pytest.approx(np.pi, rel=3e-3)


def test_objects_out_of_sight_throw_light() -> None:
    """AUTO renders the floor under a pane as everything on does."""

    def build(scene: Any) -> None:  # noqa: ANN401
        add_sun(scene, (0.3, 0, -1), 3.0)
        add_body(scene, box((-4, -4, 0.1), (4, 4, 0.5)), CLEAR)
        add_floor(scene)
        look_down(scene, 0.5)

    every = irradiance(build, 8, effects=0xFF, light_bounces=2, light_samples=2**16)
    auto = irradiance(build, 8, effects=0xFF, effects_are_auto=1, light_samples=2**16)
    assert every.mean() > 1
    assert auto.mean() == pytest.approx(every.mean(), rel=0.01)


def test_report_says_what_effects_take() -> None:
    """Time is booked where something happens, each moment once; the shares of caustics and time
    are there for what is simulated and for nothing else."""

    def build(scene: Any) -> None:  # noqa: ANN401
        add_sun(scene, (0.2, 0, -1), 1.0)
        add_body(scene, raised(icosphere(3), 1.6), Medium(1.5, 0.4, 0.1))
        add_floor(scene, 3.0)
        set_orthographic(scene, (0, -5, 4), (0, 1, -0.7), (0, 0, 1), 4.0)

    effects = (
        CAUSTICS
        | ffi.AMB_EFFECT_SINGLE_SCATTERING
        | ffi.AMB_EFFECT_DOUBLE_SCATTERING
        | ffi.AMB_EFFECT_BACKGROUND
    )
    report = render(
        build, 64, effects=effects, camera_bounces=1, samples=16, light_samples=2**14
    ).report
    costs = {effect["name"]: effect for effect in report["effects"]}
    simulated = (
        "single scattering",
        "double scattering",
        "camera-side internal reflection",
        "background through objects",
        "caustics on opaque surfaces",
        "light through objects onto opaque surfaces",
    )
    for name, effect in costs.items():
        if name in simulated:
            assert effect["cpu_s"] > 0, name
        else:
            assert effect["cpu_s"] is None, name
    assert 0.1 < costs["caustics on opaque surfaces"]["measured"]
    total = sum(costs[name]["cpu_s"] for name in simulated)
    assert total < sum(stage["cpu_s"] for stage in report["stages"])
    camera = next(stage for stage in report["stages"] if stage["name"] == "camera")["cpu_s"]
    inside = [costs[name]["objects"][0]["camera_cpu_s"] for name in simulated]
    assert all(seconds > 0 for seconds in inside[:4]) and sum(inside) < camera
    # What is found behind an object is its way's, with the caustics that are seen there.
    assert costs["caustics on opaque surfaces"]["cpu_s"] > inside[4] > 0


def test_resin_glows_on_the_floor() -> None:
    """What scatters once in a thin ball of index 1 reaches the floor below as from a small lamp of
    its power: sigma_s times the integral of the sun over the ball, without extinction."""
    sigma_s, radius, height, window = 1e-3, 0.1, 2.0, 4.0

    def build(scene: Any) -> None:  # noqa: ANN401
        ball = icosphere(4)
        add_sun(scene, (0, 1, 0), 1.0)
        body = Mesh(
            ball.positions * radius + np.array((0, 0, height)), ball.triangles, ball.normals
        )
        add_body(scene, body, Medium(1.0, sigma_s, 0))
        add_floor(scene)
        look_down(scene, window)

    power = sigma_s * 4 / 3 * np.pi * radius**3
    image = render(
        build,
        64,
        effects=CAUSTICS | ffi.AMB_EFFECT_SINGLE_SCATTERING,
        samples=4,
        light_samples=2**20,
    )
    half = 50.0  # of the floor, which is seen under a solid angle from the ball
    floor = 4 * np.arctan(half**2 / (height * np.sqrt(2 * half**2 + height**2)))
    landed = power * floor / (4 * np.pi)
    assert image.report["glow"]["flux_landed"][0] == pytest.approx(landed, rel=0.01)
    measured = image.pixels.astype(np.float64).mean(axis=2) * np.pi / ALBEDO
    x = (np.arange(64) + 0.5) / 64 * window - window / 2
    square = x**2 + x[:, None] ** 2 + height**2
    expected = power * height / (4 * np.pi * square**1.5)
    assert measured.mean() == pytest.approx(expected.mean(), rel=0.02)
    assert measured / expected == pytest.approx(np.ones((64, 64)), abs=0.5)
    assert np.sqrt(np.mean((measured / expected - 1) ** 2)) < 0.1


def test_glow_stays_within_its_walls() -> None:
    """A lamp in a ball that absorbs nothing, in a box: every watt that scatters lands on a wall of
    it, up to the corners, by the same law as that of a small lamp in the middle."""
    sigma_s = 1.5

    def build(scene: Any) -> None:  # noqa: ANN401
        scene.add_light(
            ffi.AMB_LIGHT_POINT, "lamp", color=rgb(1.0), position=rgb((0, 0, 0)), radius=0.0
        )
        ball = icosphere(4)
        add_body(
            scene,
            Mesh(ball.positions * 0.3, ball.triangles, ball.normals),
            Medium(1.0, sigma_s / 0.3, 0),
        )
        walls = box((-2, -2, -2), (2, 2, 2))
        white = scene.add_material("walls", surface=ffi.AMB_SURFACE_DIFFUSE, albedo=rgb(ALBEDO))
        shape = scene.add_mesh(
            "walls", walls.positions, walls.triangles, None, ffi.AMB_NORMALS_NONE, None
        )
        scene.add_object("walls", shape, np.eye(4).tolist(), [white])
        set_orthographic(scene, (0, 0, -1), (0, 0, -1), (0, 1, 0), 4.0)

    scattering = (
        ffi.AMB_EFFECT_SINGLE_SCATTERING
        | ffi.AMB_EFFECT_DOUBLE_SCATTERING
        | ffi.AMB_EFFECT_MULTIPLE_SCATTERING
    )
    settings = {"effects": CAUSTICS | scattering, "samples": 4, "light_samples": 2**19}
    image = render(build, 64, "Combined", **settings)
    direct = render(build, 64, "Surface", **settings)
    scattered = 4 * np.pi * (1 - np.exp(-sigma_s))
    assert image.report["glow"]["flux_landed"][0] == pytest.approx(scattered, rel=5e-3)
    glow = (image.pixels[..., :3] - direct.pixels[..., :3]).astype(np.float64).mean(axis=2)
    measured = glow * np.pi / ALBEDO
    x = (np.arange(64) + 0.5) / 64 * 4 - 2
    expected = scattered * 2 / (4 * np.pi * (x**2 + x[:, None] ** 2 + 4) ** 1.5)
    assert measured.mean() == pytest.approx(expected.mean(), rel=0.02)
    edges = [measured[0], measured[-1], measured[:, 0], measured[:, -1]]
    assert np.mean(edges) == pytest.approx(np.mean([expected[0]] * 4), rel=0.2)
