# SPDX-License-Identifier: GPL-3.0-or-later
"""The oracles against published digits, against each other and against traced rays.

An oracle that is wrong makes every test above it worthless, so each number here comes from
somewhere else: a table of independently computed values, a second quadrature, finite differences.
"""

from __future__ import annotations

import numpy as np
import pytest
from oracles import (
    Slab,
    SphereLight,
    SphereMedium,
    axis_spread,
    fresnel,
    half_space,
    henyey_greenstein,
    infinite_medium,
    matched_sphere,
    matched_sphere_flux,
    refract,
    refracting_sphere,
    refracting_sphere_by_points,
    slab_orders_of_world,
    slab_spread,
    sphere_flux,
    sun_disc,
)

DOWN = np.array([0.0, 0.0, 1.0])
SUN = SphereLight(axis=-DOWN)


def test_phase_function_is_normalised_and_has_mean_cosine_g() -> None:
    cosine, weight = np.polynomial.legendre.leggauss(200)
    for g in (-0.6, 0.0, 0.9):
        p = henyey_greenstein(cosine, g)
        assert 2 * np.pi * np.sum(weight * p) == pytest.approx(1, abs=1e-10)
        assert 2 * np.pi * np.sum(weight * p * cosine) == pytest.approx(g, abs=1e-10)


def test_fresnel_means() -> None:
    """Cosine-weighted reflectance at n = 1.5: .596346 from inside, .091778 from outside."""
    mu = (np.arange(1_000_000) + 0.5) / 1_000_000
    assert np.mean(2 * mu * fresnel(mu, 1, 1.5)) == pytest.approx(0.091778, abs=6e-7)
    assert np.mean(2 * mu * fresnel(mu, 1.5, 1)) == pytest.approx(0.596346, abs=6e-7)


def test_slab_numbers() -> None:
    assert Slab().radiance() == pytest.approx(0.0081441314, abs=5e-11)
    assert Slab(g=0.5).radiance() == pytest.approx(0.0022881357, abs=5e-11)
    full = Slab(g=0.5).radiance_all_reflections()
    assert full == pytest.approx(0.00459842323, abs=5e-12)
    none = Slab(g=0.5).radiance_all_reflections(light=False, camera=False)
    assert none == pytest.approx(Slab(g=0.5).radiance(), rel=1e-12)


def test_matched_sphere_backscatter_and_forward() -> None:
    """Camera ray along the light axis: both integrals are elementary."""
    offset, sigma = 0.4, 0.5
    chord = 2 * np.sqrt(1 - offset**2)
    start = np.array([offset, 0, -5])
    facing = matched_sphere(start, DOWN, -DOWN, sigma, sigma, 0.3)
    expected = sigma * henyey_greenstein(1, 0.3) * chord * np.exp(-sigma * chord)
    assert facing == pytest.approx(float(expected), rel=1e-12)
    away = matched_sphere(start, DOWN, DOWN, sigma, sigma, 0.3)
    expected = sigma * henyey_greenstein(-1, 0.3) * -np.expm1(-2 * sigma * chord) / (2 * sigma)
    assert away == pytest.approx(float(expected), rel=1e-12)


@pytest.mark.parametrize(
    ("n", "g", "y", "z", "golden"),
    [
        (1.5, 0.0, 0.2, 0.3, 0.02001703),
        (1.5, 0.5, 0.2, 0.3, 0.01290408),
        (1.5, 0.0, 0.3, 0.0, 0.01898588),
        (1.5, 0.5, 0.3, 0.0, 0.01045594),
        (1.0, 0.0, 0.2, 0.3, 0.02807292),
    ],
)
def test_refracting_sphere_numbers(n: float, g: float, y: float, z: float, golden: float) -> None:
    origin, direction = np.array([5.0, y, z]), np.array([-1.0, 0, 0])
    value = refracting_sphere(origin, direction, SUN, SphereMedium(n, 0.5, 0.5, g))
    assert value == pytest.approx(golden, abs=6e-9)
    if n == 1:
        matched = matched_sphere(origin, direction, DOWN, 0.5, 0.5, g)
        assert value == pytest.approx(matched, rel=1e-9)


@pytest.mark.parametrize(("x", "y"), [(0.1, 0.2), (-0.4, 0.1)])
def test_two_quadratures_agree_for_a_point_light(x: float, y: float) -> None:
    place = np.array([-4.5, 1.5, -1.6])
    distance = float(np.linalg.norm(place))
    light = SphereLight(place / distance, distance, 100.0)
    medium = SphereMedium(1.5, 0.21, 0.46, 0.9)
    origin, direction = np.array([0, 0, 5.0]), np.array([x, y, -5.0])
    direction /= np.linalg.norm(direction)
    first = refracting_sphere(origin, direction, light, medium)
    assert first == pytest.approx(
        refracting_sphere(origin, direction, light, medium, nodes=96, scan=8001), rel=1e-10
    )
    assert first == pytest.approx(
        refracting_sphere_by_points(origin, direction, light, medium), rel=1e-6
    )


def test_axis_spread_is_the_derivative_of_traced_rays() -> None:
    distance, angle = 3.0, 1e-5
    direction = np.array([np.sin(angle), 0, np.cos(angle)])
    light = np.array([0, 0, -1 - distance])
    b = float(light @ direction)
    entry = light + (-b - np.sqrt(1 - (float(light @ light) - b * b))) * direction
    inside = refract(direction, entry, 1, 1.5)
    for s in (0.3, 1.0, 1.7):
        x = entry + s * inside
        assert x[0] / angle == pytest.approx(float(axis_spread(s, distance, 1.5)), rel=1e-6)


def test_slab_spread_is_the_derivative_of_traced_rays() -> None:
    height, angle, s, step = 2.0, 0.7, 0.6, 1e-5

    def hit(direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        entry = np.array([0, 0, height]) + direction * (-height / direction[2])
        inside = refract(direction, np.array([0, 0, 1.0]), 1, 1.5)
        return entry + s * inside, inside

    def aim(polar: float, sideways: float) -> np.ndarray:
        d = np.array([np.sin(polar), 0, -np.cos(polar)]) + sideways * np.array([0, 1.0, 0])
        return d / np.linalg.norm(d)

    centre, along = hit(aim(angle, 0))
    sagittal, meridional = slab_spread(s, height, 1.5, angle)
    for shifted, expected in (
        (hit(aim(angle, step))[0], sagittal),
        (hit(aim(angle + step, 0))[0], meridional),
    ):
        offset = shifted - centre
        offset -= along * (offset @ along)
        assert np.linalg.norm(offset) / step == pytest.approx(float(expected), rel=1e-4)


def test_flux_fractions() -> None:
    for t, golden in ((0.5, 0.47151776), (1, 0.70300292), (2, 0.88644727)):
        assert matched_sphere_flux(t) == pytest.approx(golden, abs=6e-9)
        assert sphere_flux(t, 1, reflections=False) == pytest.approx(golden, abs=6e-9)
        assert sphere_flux(t, 1, reflections=True) == pytest.approx(golden, abs=6e-9)
    assert sphere_flux(np.inf, 1.5, reflections=False) == pytest.approx(0.90822204, abs=6e-9)
    assert sphere_flux(1, 1.5, reflections=False) == pytest.approx(0.75181435, abs=6e-9)
    assert sphere_flux(1, 1.5, reflections=True) == pytest.approx(0.76337431, abs=6e-9)


def test_half_space_numbers() -> None:
    one, two, every = (float(x[0]) for x in half_space(0.7, 0.5, 1.0))
    assert one == pytest.approx(0.03315728, abs=5e-9)
    assert two == pytest.approx(0.01940394, abs=5e-9)
    # H of the conservative half-space, printed in every textbook: H(.5) 2.01278, H(.7) 2.37397.
    assert every == pytest.approx(one * 2.01278 * 2.37397, rel=1e-4)
    # Few scatterings are all where albedo is small.
    one, two, every = (float(x[0]) for x in half_space(0.7, 0.5, 0.01))
    assert every == pytest.approx(one + two, rel=1e-4)


def test_infinite_medium_numbers() -> None:
    one, two = infinite_medium(offset=0.5, start=2.0, albedo=1.0)
    assert one == pytest.approx(0.002542684, abs=2e-9)
    assert two == pytest.approx(0.00245407, abs=1e-8)


def test_orders_of_the_world_sum_to_it() -> None:
    """A white slab cannot be told from its surround."""
    orders = slab_orders_of_world(tau=2.0, albedo=1.0, mu=0.7, last=150)
    assert min(orders) > 0
    assert sum(orders) == pytest.approx(1, abs=1e-10)


def test_sun_disc() -> None:
    direction, share = sun_disc((0.6, 0.0, -0.8), 0.3)
    mean = share @ direction
    assert np.allclose(mean, (0.6, 0, -0.8), atol=1e-12)
    assert np.allclose(np.linalg.norm(direction, axis=1), 1)
