# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's and Cycles' conventions as arithmetic, each with its derivation. No Blender needed.

`version` is Blender's, (major, minor, ...), wherever a convention changed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from ctypes import c_float
from typing import Any

from .scene_data import RGB, PhaseLobe

Version = tuple[int, ...]
Window = tuple[float, float, float, float]

# Cycles clamps the mean cosine to keep the phase function finite.
ANISOTROPY_MAX = 1.0 - 1e-3
LOBE_MAX = 4
# Rec. 709 luminance, the role of Blender's default scene-linear space.
LUMINANCE: RGB = (0.2126, 0.7152, 0.0722)


def luminance(color: Sequence[float]) -> float:
    return sum(w * c for w, c in zip(LUMINANCE, color, strict=False))


def scaled(color: Sequence[float], factor: float) -> RGB:
    return (color[0] * factor, color[1] * factor, color[2] * factor)


def multiplied(a: Sequence[float], b: Sequence[float]) -> RGB:
    return (a[0] * b[0], a[1] * b[1], a[2] * b[2])


def added(a: Sequence[float], b: Sequence[float]) -> RGB:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


# ---- Colours -------------------------------------------------------------------------------------

# The CIE 1931 observer as sums of (weight, peak, widths below and above, nm): C. Wyman, P. Sloan,
# P. Shirley, Simple analytic approximations to the CIE XYZ color matching functions, JCGT 2(2).
OBSERVER = (
    ((1.056, 599.8, 37.9, 31.0), (0.362, 442.0, 16.0, 26.7), (-0.065, 501.1, 20.4, 26.2)),
    ((0.821, 568.8, 46.9, 40.5), (0.286, 530.9, 16.3, 31.1)),
    ((1.217, 437.0, 11.8, 36.0), (0.681, 459.0, 26.0, 13.8)),
)
XYZ_TO_RGB = (
    (3.2404542, -1.5371385, -0.4985314),
    (-0.9692660, 1.8760108, 0.0415560),
    (0.0556434, -0.2040259, 1.0572252),
)


def blackbody(temperature: float) -> RGB:
    """Colour of a black body, kelvin, of luminance 1; held between 800 and 12000 K as in Cycles.
    Planck's law seen by the observer: within 3 % of Cycles' own fit from 1500 K on, 10 % below."""
    temperature = min(max(temperature, 800.0), 12000.0)
    xyz = [0.0, 0.0, 0.0]
    for nm in range(380, 781, 5):
        # hc / k = 1.4388e7 nm K; the rest of Planck's constants cancels.
        planck = nm**-5.0 / math.expm1(1.4388e7 / (nm * temperature))
        for i, lobes in enumerate(OBSERVER):
            for weight, peak, below, above in lobes:
                x = (nm - peak) / (below if nm < peak else above)
                xyz[i] += planck * weight * math.exp(-0.5 * x * x)
    r, g, b = (sum(m * c for m, c in zip(row, xyz, strict=True)) / xyz[1] for row in XYZ_TO_RGB)
    return _positive((r, g, b))


# ---- Camera --------------------------------------------------------------------------------------


def camera_window(
    *,
    is_orthographic: bool,
    lens: float,
    ortho_scale: float,
    sensor_fit: str,
    sensor_width: float,
    sensor_height: float,
    shift: tuple[float, float],
    resolution: tuple[int, int],
    pixel_aspect: tuple[float, float],
) -> Window:
    """(left, right, bottom, top) of the image at distance 1, or in metres if orthographic.

    lens and sensor in mm; resolution in pixels, of the full image. The fitted side of the image
    (the longer one under AUTO, measured with the pixel's aspect) spans sensor / lens, or
    ortho_scale; the other side follows from square measure. The shift is in units of the fitted
    side. Evaluated in double: the library gets the last bit of float that there is.
    """
    width = resolution[0] * pixel_aspect[0]
    height = resolution[1] * pixel_aspect[1]
    horizontal = sensor_fit == "HORIZONTAL" or (sensor_fit == "AUTO" and width >= height)
    # Under AUTO the sensor's width is fitted to the longer side, whichever that is.
    sensor = sensor_height if sensor_fit == "VERTICAL" else sensor_width
    side = ortho_scale if is_orthographic else sensor / lens
    scale = side / (width if horizontal else height)
    half_x, half_y = 0.5 * width * scale, 0.5 * height * scale
    x, y = shift[0] * side, shift[1] * side
    return (x - half_x, x + half_x, y - half_y, y + half_y)


def projection_window(projection: Sequence[Sequence[float]], is_orthographic: bool) -> Window:
    """The window of a 4x4 projection matrix of OpenGL's form (a viewport's window_matrix).

    Perspective: x_ndc = (P00 x + P02 z) / -z, so at z = -1, x = (x_ndc + P02) / P00.
    Orthographic: x_ndc = P00 x + P03.
    """
    column, sign = (3, -1.0) if is_orthographic else (2, 1.0)
    p00, p11 = projection[0][0], projection[1][1]
    x, y = sign * projection[0][column], sign * projection[1][column]
    return ((x - 1.0) / p00, (x + 1.0) / p00, (y - 1.0) / p11, (y + 1.0) / p11)


def lens_radius(lens: float, fstop: float, is_orthographic: bool) -> float:
    """Radius of the aperture, metres: Cycles takes the lens in mm whatever the unit scale is, and
    a lens of one metre for an orthographic camera."""
    focal = 1.0 if is_orthographic else lens * 1e-3
    return focal / (2.0 * max(fstop, 1e-5))


def border_rectangle(
    border: tuple[float, float, float, float], resolution: tuple[int, int]
) -> tuple[int, int, int, int]:
    """Pixels (x, y, width, height), y = 0 at the bottom, of a render border (min_x, max_x, min_y,
    max_y in [0,1]), truncated as Blender truncates it; at least one pixel."""

    def pixel(fraction: float, size: int) -> int:
        # The product rounded to float as in Blender: 0.7 of 100 is 70 there, in double 69.99.
        return min(max(int(c_float(fraction * size).value), 0), size)

    x0, x1 = (pixel(b, resolution[0]) for b in border[:2])
    y0, y1 = (pixel(b, resolution[1]) for b in border[2:])
    return (x0, y0, max(x1 - x0, 1), max(y1 - y0, 1))


# ---- Lights --------------------------------------------------------------------------------------


def point_intensity(power: float) -> float:
    """W/sr of a point or spot light on its axis: the power of the whole sphere, whatever the
    cone."""
    return power / (4.0 * math.pi)


def area_radiance(power: float, area: float, version: Version) -> float:
    """W m^-2 sr^-1 of a one-sided Lambertian emitter. Before 4.0 Cycles divided by 4, not pi;
    newer versions convert the power of older files on load."""
    return power / ((4.0 if version < (4, 0) else math.pi) * area)


def light_area(kind: str, radius: float, angle: float, extent: tuple[float, float]) -> float:
    """The area that multiplies the power of a light that is not normalized (m^2; for a sun, of
    its disc on the unit sphere). extent: full size of an AREA light, round ones as 'ELLIPSE'.
    A light without extent has the area that Cycles gives it."""
    if kind == "AREA":
        return extent[0] * extent[1]
    if kind == "ELLIPSE":
        return 0.25 * math.pi * extent[0] * extent[1]
    if kind == "SUN":
        return math.pi * math.sin(0.5 * angle) ** 2 if angle > 0.0 else 1.0
    return 4.0 * math.pi * radius * radius if radius > 0.0 else 4.0


def spot_has_cosine(version: Version) -> bool:
    """Before 3.6 Cycles multiplied a spot by the cosine from its axis."""
    return version < (3, 6)


# ---- Media ---------------------------------------------------------------------------------------
# Coefficients in 1/m of world space: an object's scale does not change a density.


def _positive(color: Sequence[float]) -> RGB:
    return (max(color[0], 0.0), max(color[1], 0.0), max(color[2], 0.0))


def scatter_coefficient(color: Sequence[float], density: float) -> RGB:
    """sigma_s of Volume Scatter; its colour adds no absorption."""
    return scaled(_positive(color), max(density, 0.0))


def absorption_coefficient(color: Sequence[float], density: float) -> RGB:
    """sigma_a of Volume Absorption."""
    d = max(density, 0.0)
    return (d * max(1 - color[0], 0.0), d * max(1 - color[1], 0.0), d * max(1 - color[2], 0.0))


def principled_absorption(
    color: Sequence[float], absorption_color: Sequence[float], density: float
) -> RGB:
    """sigma_a of Principled Volume: what the scattering colour leaves, tinted by the square root
    of the absorption colour."""
    d = max(density, 0.0)
    rest = [
        d * max(1.0 - c, 0.0) * max(1.0 - math.sqrt(max(a, 0.0)), 0.0)
        for c, a in zip(color[:3], absorption_color[:3], strict=True)
    ]
    return (rest[0], rest[1], rest[2])


def clamp_anisotropy(g: float) -> float:
    return min(max(g, -ANISOTROPY_MAX), ANISOTROPY_MAX)


def join_lobes(lobes: Iterable[PhaseLobe]) -> tuple[PhaseLobe, ...]:
    """The same mixture with one lobe for each g, in their order; exact. Black ones vanish."""
    by_g: dict[float, RGB] = {}
    for lobe in lobes:
        if any(lobe.sigma_s):
            by_g[lobe.g] = added(by_g.get(lobe.g, (0.0, 0.0, 0.0)), lobe.sigma_s)
    return tuple(PhaseLobe(sigma_s, g) for g, sigma_s in sorted(by_g.items()))


def merge_lobes(lobes: Iterable[PhaseLobe]) -> tuple[tuple[PhaseLobe, ...], bool]:
    """The same mixture with at most LOBE_MAX lobes, and whether that needed an approximation.

    Lobes of equal g are joined. Beyond the maximum the two neighbours in g
    that lie closest are merged into one with the mean of g, weighted by luminance.
    """
    merged = list(join_lobes(lobes))
    approximate = len(merged) > LOBE_MAX
    while len(merged) > LOBE_MAX:
        i = min(range(len(merged) - 1), key=lambda k: merged[k + 1].g - merged[k].g)
        a, b = merged[i], merged[i + 1]
        wa, wb = luminance(a.sigma_s), luminance(b.sigma_s)
        share = wa / (wa + wb) if wa + wb > 0.0 else 0.5
        merged[i : i + 2] = [
            PhaseLobe(added(a.sigma_s, b.sigma_s), share * a.g + (1.0 - share) * b.g)
        ]
    return tuple(merged), approximate


# ---- World ---------------------------------------------------------------------------------------


def srgb_to_linear(values: Any) -> Any:
    """Numbers of an 8-bit sRGB image (0 .. 1) as scene-linear ones (IEC 61966-2-1); an array."""
    low = values / 12.92
    high = ((abs(values) + 0.055) / 1.055) ** 2.4
    dark = values <= 0.04045
    return low * dark + high * ~dark


# ---- Boundary ------------------------------------------------------------------------------------


def principled_transmit_color(base: Sequence[float], version: Version) -> RGB:
    """Factor of each refraction: the whole base colour before 4.0, its square root since, so that
    a slab shows the colour once."""
    base = _positive(base)
    if version < (4, 0):
        return (base[0], base[1], base[2])
    return (math.sqrt(base[0]), math.sqrt(base[1]), math.sqrt(base[2]))
