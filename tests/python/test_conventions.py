# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's and Cycles' conventions against numbers measured in Cycles and worked by hand."""

import math

import numpy as np
import pytest
from amberlight.export import conventions as conv
from amberlight.export.scene_data import PhaseLobe

V34, V43, V52 = (3, 4, 1), (4, 3, 2), (5, 2, 2)


def window(**changes):
    camera = {
        "is_orthographic": False, "lens": 50.0, "ortho_scale": 6.0, "sensor_fit": "AUTO",
        "sensor_width": 36.0, "sensor_height": 24.0, "shift": (0.0, 0.0),
        "resolution": (1920, 1080), "pixel_aspect": (1.0, 1.0),
    }  # fmt: skip
    return conv.camera_window(**{**camera, **changes})


def test_window_landscape():
    assert window() == pytest.approx((-0.36, 0.36, -0.2025, 0.2025))


def test_window_portrait_fits_the_height():
    assert window(resolution=(1080, 1920)) == pytest.approx((-0.2025, 0.2025, -0.36, 0.36))


def test_window_vertical_fit_uses_the_sensor_height():
    half = 0.5 * 24 / 50
    w = half * 16 / 9
    assert window(sensor_fit="VERTICAL") == pytest.approx((-w, w, -half, half))


def test_window_pixel_aspect_decides_the_longer_side():
    # 100 x 150 pixels that are twice as wide as high: a landscape image.
    got = window(resolution=(100, 150), pixel_aspect=(2.0, 1.0))
    assert got == pytest.approx((-0.36, 0.36, -0.27, 0.27))


def test_window_shift_is_in_units_of_the_fitted_side():
    got = window(shift=(0.5, -0.25))
    assert got == pytest.approx((0.0, 0.72, -0.2025 - 0.18, 0.2025 - 0.18))


def test_window_orthographic():
    got = window(is_orthographic=True, shift=(0.5, 0.0))
    assert got == pytest.approx((0.0, 6.0, -3 * 9 / 16, 3 * 9 / 16))


@pytest.mark.parametrize("orthographic", [False, True])
def test_projection_window_inverts_a_projection(orthographic):
    left, right, bottom, top = -0.3, 0.5, -0.1, 0.2
    p = np.zeros((4, 4))
    p[0, 0], p[1, 1] = 2 / (right - left), 2 / (top - bottom)
    shift = (right + left) / (right - left), (top + bottom) / (top - bottom)
    if orthographic:
        p[0, 3], p[1, 3], p[3, 3] = -shift[0], -shift[1], 1
    else:
        p[0, 2], p[1, 2], p[3, 2] = shift[0], shift[1], -1
    got = conv.projection_window(p, orthographic)
    assert got == pytest.approx((left, right, bottom, top))


def test_lens_radius():
    assert conv.lens_radius(50.0, 2.0, False) == pytest.approx(0.0125)
    assert conv.lens_radius(50.0, 2.0, True) == pytest.approx(0.25)
    assert conv.lens_radius(50.0, 0.0, False) < 1e4


def test_border_rectangle():
    # Measured in Blender: 53 x 21 pixels of 160 x 90.
    assert conv.border_rectangle((0.0, 1.0, 0.0, 1.0), (160, 90)) == (0, 0, 160, 90)
    border = (np.float32(0.3), np.float32(0.7), np.float32(0.1), np.float32(0.2))
    got = conv.border_rectangle(tuple(map(float, border)), (100, 100))
    assert got == (30, 10, 40, 10)
    assert conv.border_rectangle((0.5, 0.5, 0.9, 0.9), (10, 10))[2:] == (1, 1)


# ---- Lights --------------------------------------------------------------------------------------


def test_point_light():
    # 100 W: I = P / (4 pi).
    assert conv.point_intensity(100.0) == pytest.approx(7.957747)


def test_area_light():
    assert conv.area_radiance(100.0, 2.0, V34) == pytest.approx(12.5)
    assert conv.area_radiance(100.0, 2.0, V43) == pytest.approx(50 / math.pi)
    # A file of 3.x has its power converted on load (100 W -> 78.54 W): the same radiance.
    assert conv.area_radiance(78.5398, 2.0, V52) == pytest.approx(12.5)


def test_light_area():
    assert conv.light_area("POINT", 0.5, 0, (0, 0)) == pytest.approx(math.pi)
    assert conv.light_area("SPOT", 0.0, 0, (0, 0)) == 4.0
    assert conv.light_area("AREA", 0, 0, (2.0, 3.0)) == 6.0
    assert conv.light_area("ELLIPSE", 0, 0, (2.0, 2.0)) == pytest.approx(math.pi)
    assert conv.light_area("SUN", 0, 0.0, (0, 0)) == 1.0
    assert conv.light_area("SUN", 0, math.pi, (0, 0)) == pytest.approx(math.pi)


def test_spot_cosine():
    assert conv.spot_has_cosine(V34)
    assert not conv.spot_has_cosine((3, 6, 0)) and not conv.spot_has_cosine(V43)


# ---- Media ---------------------------------------------------------------------------------------


def test_scatter_adds_no_absorption():
    assert conv.scatter_coefficient((0.5, 0.25, -1.0), 2.0) == (1.0, 0.5, 0.0)
    assert conv.scatter_coefficient((0.5, 0.5, 0.5), -2.0) == (0.0, 0.0, 0.0)


def test_absorption():
    assert conv.absorption_coefficient((0.0, 0.25, 2.0), 2.0) == (2.0, 1.5, 0.0)


def test_principled_absorption():
    got = conv.principled_absorption((0.5, 0.5, 2.0), (0.0, 0.25, 0.0), 2.0)
    assert got == pytest.approx((1.0, 0.5, 0.0))


def test_anisotropy_stays_below_one():
    assert conv.clamp_anisotropy(1.0) == pytest.approx(0.999)
    assert conv.clamp_anisotropy(-5.0) == pytest.approx(-0.999)
    assert conv.clamp_anisotropy(0.9) == 0.9


def grey(value, g):
    return PhaseLobe((value, value, value), g)


def test_lobes_of_equal_g_add():
    lobes, approximate = conv.merge_lobes([grey(1.0, 0.5), grey(2.0, 0.5), grey(0.0, 0.1)])
    assert lobes == (grey(3.0, 0.5),) and not approximate


def test_lobes_beyond_the_maximum_merge_the_nearest():
    lobes, approximate = conv.merge_lobes(grey(1.0, g) for g in (0.9, 0.0, 0.1, -0.5, 0.5))
    assert approximate and [lobe.g for lobe in lobes] == pytest.approx([-0.5, 0.05, 0.5, 0.9])
    assert sum(lobe.sigma_s[0] for lobe in lobes) == pytest.approx(5.0)


def test_merged_lobe_keeps_the_mean_cosine():
    many = [grey(float(i), 0.1 * i) for i in range(1, 9)]
    lobes, _ = conv.merge_lobes(many)
    assert len(lobes) == 4
    want = sum(lobe.sigma_s[0] * lobe.g for lobe in many)
    assert sum(lobe.sigma_s[0] * lobe.g for lobe in lobes) == pytest.approx(want)


# ---- Boundary ------------------------------------------------------------------------------------


def test_principled_tint():
    # A slab of base colour .64 shows it twice before 4.0 and once since.
    assert conv.principled_transmit_color((0.64, 1.0, 0.0), V34) == (0.64, 1.0, 0.0)
    assert conv.principled_transmit_color((0.64, 1.0, 0.0), V43) == pytest.approx((0.8, 1.0, 0.0))
