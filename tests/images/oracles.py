# SPDX-License-Identifier: GPL-3.0-or-later
"""Closed forms and quadratures of single scattering, in float64, independent of the C library.

Everything here is either a formula or a one-dimensional integral whose integrand is exact, so that
the renderer has something to converge *to*. Conventions: index 1 outside and ``n`` inside,
``sigma_t = sigma_s + sigma_a`` in 1/m, the phase function is Henyey-Greenstein with its argument
the cosine between the directions of travel before and after, radiance in W m^-2 sr^-1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


# ---- Optics -------------------------------------------------------------------------------------


def henyey_greenstein(cosine: ArrayLike, g: float) -> Array:
    """Phase function in 1/sr; ``cosine`` between travel before and after the event."""
    c = np.asarray(cosine, dtype=np.float64)
    return (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * c) ** 1.5)


def refracted_cosine(cosine: ArrayLike, n_from: float, n_to: float) -> Array:
    """Cosine behind the boundary; NaN where the light is totally reflected."""
    c = np.asarray(cosine, dtype=np.float64)
    square = (n_from / n_to) ** 2
    # Not 1 - square (1 - c^2), which loses a grazing cosine to rounding at index 1.
    squared = (1 - square) + square * c * c
    return np.sqrt(np.where(squared >= 0, squared, np.nan))


def fresnel(cosine: ArrayLike, n_from: float, n_to: float) -> Array:
    """Unpolarised reflectance of a smooth dielectric, in [0, 1]; 1 where totally reflected."""
    ci = np.asarray(cosine, dtype=np.float64)
    ct = refracted_cosine(ci, n_from, n_to)
    rs = (n_from * ci - n_to * ct) / (n_from * ci + n_to * ct)
    rp = (n_to * ci - n_from * ct) / (n_to * ci + n_from * ct)
    return np.where(np.isnan(ct), 1.0, (rs * rs + rp * rp) / 2)


def refract(direction: Array, normal: Array, n_from: float, n_to: float) -> Array:
    """Refracted unit directions, shape (..., 3); NaN where totally reflected.

    ``normal`` is the unit normal on the side that ``direction`` comes from.
    """
    eta = n_from / n_to
    ci = -np.sum(direction * normal, axis=-1, keepdims=True)
    ct = refracted_cosine(ci, n_from, n_to)
    return eta * direction + (eta * ci - ct) * normal


# ---- Slab ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Slab:
    """An infinite slab lit by a sun, seen from the lit side.

    Angles in radians, outside the slab, measured from the normal; the light travels towards +x
    and the camera stands on the +x side. ``irradiance`` is the sun's, perpendicular to its beam.
    """

    thickness: float = 1.0
    n: float = 1.5
    sigma_s: float = 0.4
    sigma_t: float = 0.5
    g: float = 0.0
    light_angle: float = np.radians(30.0)
    camera_angle: float = np.radians(45.0)
    irradiance: float = 1.0

    def _cosines(self) -> tuple[float, float, float, float]:
        """Cosines outside (light, camera), then inside (light, camera)."""
        out_l, out_c = np.cos(self.light_angle), np.cos(self.camera_angle)
        in_l = float(refracted_cosine(out_l, 1, self.n))
        in_c = float(refracted_cosine(out_c, 1, self.n))
        return out_l, out_c, in_l, in_c

    def radiance(self) -> float:
        """First passes only: refract in, scatter once, refract out."""
        out_l, out_c, mu_l, mu_c = self._cosines()
        transmitted = (1 - fresnel(out_l, 1, self.n)) * (1 - fresnel(out_c, 1, self.n))
        sines = np.sqrt((1 - mu_l**2) * (1 - mu_c**2))
        phase = henyey_greenstein(sines - mu_l * mu_c, self.g)
        depth = self.sigma_t * self.thickness * (1 / mu_l + 1 / mu_c)
        albedo = self.sigma_s / self.sigma_t
        source = albedo * phase * self.irradiance * out_l * transmitted
        return float(source / (self.n**2 * (mu_l + mu_c)) * -np.expm1(-depth))

    def radiance_all_reflections(self, light: bool = True, camera: bool = True) -> float:
        """Single scattering with every internal reflection before (``light``) and after the event.

        Without reflections on either side it is ``radiance``.
        """
        out_l, out_c, mu_l, mu_c = self._cosines()
        sigma_t, tau = self.sigma_t, self.sigma_t * self.thickness
        albedo = self.sigma_s / sigma_t
        r_l = fresnel(mu_l, self.n, 1) if light else 0.0
        r_c = fresnel(mu_c, self.n, 1) if camera else 0.0
        a_l, a_c = np.exp(-tau / mu_l), np.exp(-tau / mu_c)
        series_l, series_c = 1 / (1 - (r_l * a_l) ** 2), 1 / (1 - (r_c * a_c) ** 2)
        sines = np.sqrt((1 - mu_l**2) * (1 - mu_c**2))
        opposed = henyey_greenstein(sines - mu_l * mu_c, self.g)
        along = henyey_greenstein(sines + mu_l * mu_c, self.g)
        entering = self.irradiance * out_l * (1 - fresnel(out_l, 1, self.n)) / mu_l

        def ramp(k: float) -> float:
            """Integral of exp(-sigma_t k x) over the thickness."""
            return float(self.thickness if k == 0 else -np.expm1(-tau * k) / (sigma_t * k))

        same = opposed * ramp(1 / mu_l + 1 / mu_c) * (1 + r_l * r_c * a_l * a_c)
        crossed = along * (
            r_l * a_l**2 * ramp(1 / mu_c - 1 / mu_l) + r_c * a_c**2 * ramp(1 / mu_l - 1 / mu_c)
        )
        inside = albedo * sigma_t * entering / mu_c * series_l * series_c * (same + crossed)
        return float(inside * (1 - fresnel(out_c, 1, self.n)) / self.n**2)


# ---- Index-matched sphere -----------------------------------------------------------------------


def matched_sphere(
    origin: Array,
    direction: Array,
    light: Array,
    sigma_s: float,
    sigma_t: float,
    g: float,
    radius: float = 1.0,
    irradiance: float = 1.0,
    nodes: int = 64,
) -> float:
    """Radiance of a sphere at the origin with index 1 under a sun; ``light`` = travel, unit.

    Light reaches x after x.l + sqrt(R^2 - |x|^2 + (x.l)^2) in the medium, so one Gauss rule along
    the chord of the camera ray is exact to rounding (the integrand is analytic inside).
    """
    b = origin @ direction
    half = np.sqrt(radius**2 - (origin @ origin - b * b))
    u, weight = _gauss(nodes)
    t = half * (1 + u)
    x = origin + (-b - half + t)[:, None] * direction
    along = x @ light
    depth = along + np.sqrt(radius**2 - np.sum(x * x, axis=1) + along**2)
    source = sigma_s * henyey_greenstein(light @ direction * -1, g) * irradiance
    return float(source * np.sum(weight * np.exp(-sigma_t * (depth + t))) * half)


# ---- Refracting sphere --------------------------------------------------------------------------


@dataclass(frozen=True)
class SphereLight:
    """A light on the axis of a unit-index surround.

    ``axis``: unit vector from the sphere's centre towards the light. ``distance`` from the centre
    in metres, infinite for a sun; ``power`` is then the irradiance, else the radiant intensity.
    ``cone`` limits a point light to this half angle around the axis (a hard-edged spot).
    """

    axis: Array
    distance: float = np.inf
    power: float = 1.0
    cone: float = np.pi


@dataclass(frozen=True)
class SphereMedium:
    """A sphere at the origin and what fills it."""

    n: float
    sigma_s: float
    sigma_t: float
    g: float = 0.0
    radius: float = 1.0


def _gauss(nodes: int) -> tuple[Array, Array]:
    return np.polynomial.legendre.leggauss(nodes)


def _entry(theta: Array, light: SphereLight, medium: SphereMedium) -> tuple[Array, ...]:
    """Light entering at polar angle theta from the axis, in the meridional plane (axial, radial).

    Returns z0, r0 (m), wz, wr (refracted direction) and dPhi/(dtheta dphi) in W/rad^2.
    """
    cos, sin = np.cos(theta), np.sin(theta)
    radius = medium.radius
    if np.isinf(light.distance):
        dz, dr, spread = -np.ones_like(theta), np.zeros_like(theta), np.ones_like(theta)
    else:
        dz, dr = radius * cos - light.distance, radius * sin
        square = dz * dz + dr * dr
        dz, dr, spread = dz / np.sqrt(square), dr / np.sqrt(square), 1 / square
    cosine = np.clip(-(dz * cos + dr * sin), 0, 1)
    bent = refracted_cosine(cosine, 1, medium.n)
    wz = dz / medium.n + (cosine / medium.n - bent) * cos
    wr = dr / medium.n + (cosine / medium.n - bent) * sin
    enters = 1 - fresnel(cosine, 1, medium.n)
    flux = light.power * spread * cosine * enters * radius**2 * sin
    return radius * cos, radius * sin, wz, wr, flux


def _last_entry_angle(light: SphereLight, medium: SphereMedium) -> float:
    """Largest polar angle that the light reaches: the terminator or the edge of its cone."""
    if np.isinf(light.distance):
        return np.pi / 2
    terminator = float(np.arccos(medium.radius / light.distance))
    widest = np.arcsin(medium.radius / light.distance)
    if light.cone >= widest:
        return terminator
    # Law of sines: the ray of half angle c meets the near side at theta = asin(d sin c / R) - c.
    return float(np.arcsin(light.distance * np.sin(light.cone) / medium.radius) - light.cone)


def _bisect(function: Callable[[Array], Array], low: Array, high: Array) -> Array:
    """Zeros of ``function`` in brackets with a sign change, elementwise."""
    low, high = low.copy(), high.copy()
    sign = np.sign(function(low))
    for _ in range(60):
        middle = (low + high) / 2
        left = np.sign(function(middle)) == sign
        low, high = np.where(left, middle, low), np.where(left, high, middle)
    return (low + high) / 2


def refracting_sphere(
    origin: Array,
    direction: Array,
    light: SphereLight,
    medium: SphereMedium,
    nodes: int = 48,
    scan: int = 4001,
) -> float:
    """Radiance along the camera ray: refract in, scatter once, refract out (no reflections).

    All light that enters at polar angle theta fills one cone around the axis, and a line meets a
    cone where a quadratic says. With x(theta, phi, s) the light's own coordinates, the integral
    along the camera ray becomes one over theta,

        L = T_c/n^2 sigma_s  sum_roots  int dtheta  Phi'(theta) p e^{-sigma_t (s+t)}
                                                    / |d . (dx/dphi x w)|,

    with no density estimate and no light ray to search for: folds of the caustic only add roots.
    The integrand has inverse square-root ends where the ray touches a cone; each interval is
    mapped by theta = mid + half sin(pi v / 2), which makes them smooth.
    """
    b = float(origin @ direction)
    inside = medium.radius**2 - (float(origin @ origin) - b * b)
    if inside <= 0:
        return 0.0
    entry = origin + (-b - np.sqrt(inside)) * direction
    normal = entry / medium.radius
    cosine = -float(direction @ normal)
    d = refract(direction, normal, 1, medium.n)
    length = -2 * float(entry @ d)
    pz, dz = float(entry @ light.axis), float(d @ light.axis)

    def roots(theta: Array) -> tuple[Array, Array]:
        """The discriminant, and both t where the ray meets the cone of theta; shape (2, n)."""
        z0, r0, wz, wr, _ = _entry(theta, light, medium)
        slope = wr / wz
        # (r0 + (pz + t dz - z0) slope)^2 = |entry + t d|^2 - (pz + t dz)^2
        c0, c1 = r0 + (pz - z0) * slope, dz * slope
        qa = c1 * c1 - 1 + dz * dz
        qb = c0 * c1 - float(entry @ d) + pz * dz
        qc = c0 * c0 - medium.radius**2 + pz * pz
        disc = qb * qb - qa * qc
        root = np.sqrt(np.maximum(disc, 0))
        # The stable pair of roots: no difference of nearly equal numbers.
        q = -(qb + np.where(qb >= 0, root, -root))
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second = q / qa, qc / q
        return disc, np.stack([np.fmin(first, second), np.fmax(first, second)])

    def integrand(theta: Array) -> Array:
        z0, r0, wz, wr, flux = _entry(theta, light, medium)
        disc, both = roots(theta)
        total = np.zeros_like(theta)
        for t in both:
            with np.errstate(divide="ignore", invalid="ignore"):
                x = entry + t[:, None] * d
                axial = x @ light.axis
                s = (axial - z0) / wz
                radial = r0 + s * wr
                outward = x - axial[:, None] * light.axis
                outward = outward / radial[:, None]  # unit; radial < 0 beyond the axis
                w = wz[:, None] * light.axis + wr[:, None] * outward
                around = radial[:, None] * np.cross(light.axis, outward)
                area = np.abs(np.cross(around, w) @ d)
                phase = henyey_greenstein(-(w @ d), medium.g)
                value = flux * phase * np.exp(-medium.sigma_t * (s + t)) / area
            seen = (disc > 0) & (t > 0) & (t < length) & (s > 0)
            total += np.where(seen, value, 0.0)
        return total

    # Cut the range wherever a root appears, vanishes or leaves the segment.
    last = _last_entry_angle(light, medium)
    grid = last * (np.arange(scan) + 0.5) / scan
    events = [
        lambda a: roots(a)[0],
        lambda a: roots(a)[1][0],
        lambda a: roots(a)[1][1],
        lambda a: roots(a)[1][0] - length,
        lambda a: roots(a)[1][1] - length,
    ]
    cuts = [np.array([0.0, last])]
    for event in events:
        value = event(grid)
        change = np.nonzero(np.sign(value[:-1]) * np.sign(value[1:]) < 0)[0]
        cuts.append(_bisect(event, grid[change], grid[change + 1]))
    edges = np.unique(np.concatenate(cuts))
    u, weight = _gauss(nodes)
    bend, jacobian = np.sin(np.pi / 2 * u), np.pi / 2 * np.cos(np.pi / 2 * u)
    total = 0.0
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        half = (high - low) / 2
        theta = (low + high) / 2 + half * bend
        total += half * float(np.sum(weight * jacobian * integrand(theta)))
    leaves = float(1 - fresnel(cosine, 1, medium.n))
    return leaves / medium.n**2 * medium.sigma_s * total


def refracting_sphere_by_points(
    origin: Array,
    direction: Array,
    light: SphereLight,
    medium: SphereMedium,
    steps: int = 4000,
    scan: int = 2001,
) -> float:
    """The same radiance by another route: march the segment, find the light rays through each x.

    In the meridional plane of x every sign change over theta of the distance of x from the
    refracted ray is one light path; its irradiance is Phi' / (rho |dh/dtheta|). Slow, and only
    as good as its midpoint rule near caustics; it exists to check ``refracting_sphere``.
    """
    b = float(origin @ direction)
    inside = medium.radius**2 - (float(origin @ origin) - b * b)
    if inside <= 0:
        return 0.0
    entry = origin + (-b - np.sqrt(inside)) * direction
    normal = entry / medium.radius
    d = refract(direction, normal, 1, medium.n)
    length = -2 * float(entry @ d)
    last = _last_entry_angle(light, medium)
    t = length * (np.arange(steps) + 0.5) / steps
    x = entry + t[:, None] * d
    axial = x @ light.axis
    across = x - axial[:, None] * light.axis
    rho = np.linalg.norm(across, axis=1)
    outward = across / rho[:, None]

    def miss(theta: Array, z: Array, r: Array) -> Array:
        z0, r0, wz, wr, _ = _entry(np.abs(theta), light, medium)
        side = np.where(theta < 0, -1.0, 1.0)
        return (r - side * r0) * wz - (z - z0) * side * wr

    grid = np.linspace(-last, last, scan)
    total = 0.0
    for begin in range(0, steps, 500):
        part = slice(begin, begin + 500)
        z, r = axial[part, None], rho[part, None]
        value = miss(grid, z, r)
        row, column = np.nonzero(np.sign(value[:, :-1]) * np.sign(value[:, 1:]) < 0)
        z, r = z[row, 0], r[row, 0]
        theta = _bisect(lambda a, z=z, r=r: miss(a, z, r), grid[column], grid[column + 1])
        z0, r0, wz, wr, flux = _entry(np.abs(theta), light, medium)
        wr = np.where(theta < 0, -wr, wr)
        s = (z - z0) / wz
        step = 1e-6
        slope = (miss(theta + step, z, r) - miss(theta - step, z, r)) / (2 * step)
        w = wz[:, None] * light.axis + wr[:, None] * outward[part][row]
        phase = henyey_greenstein(-(w @ d), medium.g)
        fade = np.exp(-medium.sigma_t * (s + t[part][row]))
        found = flux / (r * np.abs(slope)) * phase * fade
        total += float(np.sum(np.where(s > 0, found, 0.0)))
    leaves = float(1 - fresnel(-float(direction @ normal), 1, medium.n))
    return leaves / medium.n**2 * medium.sigma_s * total * length / steps


# ---- Focusing on the axis -----------------------------------------------------------------------


def axis_spread(s: ArrayLike, distance: float, n: float, radius: float = 1.0) -> Array:
    """B(s) = d position / d angle on the axis, metres per radian.

    A point light at ``distance`` metres from the vertex of a sphere, s metres inside it. The
    irradiance is I T0 e^{-sigma_t s} / B^2 with T0 = 4n/(n+1)^2.
    """
    s = np.asarray(s, dtype=np.float64)
    return distance + s / n - s * (n - 1) * distance / (n * radius)


def slab_spread(s: ArrayLike, height: float, n: float, angle: float) -> tuple[Array, Array]:
    """Sagittal and meridional spread (m/rad) s metres inside a slab, light ``height`` above it."""
    s = np.asarray(s, dtype=np.float64)
    ci = np.cos(angle)
    ct = float(refracted_cosine(ci, 1, n))
    return height / ci + s / n, height / ci * ct / ci + s / n * ci / ct


# ---- Flux ---------------------------------------------------------------------------------------


def sphere_flux(optical_radius: float, n: float, reflections: bool, nodes: int = 400) -> float:
    """Fraction of the sun's flux on a sphere that scatters or is absorbed inside it.

    ``optical_radius`` = sigma_t R; infinite gives the fraction that enters. The angle inside
    stays the same after every internal reflection in a sphere, so all of them are one geometric
    series. Integrated over the sine squared of the angle of incidence.
    """
    u, weight = _gauss(nodes)
    # cosine = v^2 removes the square root of the Fresnel term at grazing incidence.
    v = (1 + u) / 2
    cosine = v * v
    measure = weight / 2 * 2 * cosine * 2 * v
    enters = 1 - fresnel(cosine, 1, n)
    bent = refracted_cosine(cosine, 1, n)
    kept = -np.expm1(-2 * optical_radius * bent) if np.isfinite(optical_radius) else 1.0
    back = 1 - enters  # reciprocity: the same reflectance from inside
    series: ArrayLike = 1.0
    if reflections:
        series = 1 / (1 - back * (1 - kept))
    return float(np.sum(measure * enters * kept * series))


def matched_sphere_flux(optical_radius: float) -> float:
    """The closed form of ``sphere_flux`` for n = 1."""
    t = optical_radius
    return float(1 - (1 - (1 + 2 * t) * np.exp(-2 * t)) / (2 * t * t))


# ---- More than one scattering -------------------------------------------------------------------


def sun_disc(axis: ArrayLike, radius: float, nodes: int = 24) -> tuple[Array, Array]:
    """Directions (n, 3) of a sun of this angular radius and their shares of its irradiance across
    the axis, which sum to 1 when weighted with the cosine from it; its radiance is uniform."""
    z = np.asarray(axis, dtype=np.float64)
    z = z / np.linalg.norm(z)
    x = np.cross(z, (0.0, 1.0, 0.0) if abs(z[1]) < 0.9 else (1.0, 0.0, 0.0))
    x /= np.linalg.norm(x)
    u, weight = _gauss(nodes)
    half = (1 - np.cos(radius)) / 2
    cosine = (1 - half + half * u)[:, None]
    turn = 2 * np.pi * (np.arange(2 * nodes) + 0.5)[None] / (2 * nodes)
    sine = np.sqrt(1 - cosine**2)
    parts = (sine * np.cos(turn), sine * np.sin(turn), cosine + 0 * turn)
    basis = (x, np.cross(z, x), z)
    directions = sum(p[..., None] * b for p, b in zip(parts, basis, strict=True))
    solid = np.repeat(half * weight * np.pi / nodes, 2 * nodes)
    return np.asarray(directions).reshape(-1, 3), solid / (np.pi * np.sin(radius) ** 2)


def chandrasekhar_h(mu: ArrayLike, albedo: float, nodes: int = 64) -> Array:
    """H of the isotropic half-space: 1/H = sqrt(1 - a) + a/2 int x H(x) / (mu + x) dx."""
    u, weight = _gauss(nodes)
    x, w = (1 + u) / 2, weight / 2
    h = np.ones(nodes)
    start = np.sqrt(1 - albedo)
    for _ in range(100):
        # The mean: plain iteration turns a wrong scale of H at albedo 1 into its inverse for ever.
        h = np.sqrt(h / (start + albedo / 2 * np.sum(w * x * h / (x[:, None] + x), axis=1)))
    m = np.atleast_1d(np.asarray(mu, dtype=np.float64))
    return 1 / (start + albedo / 2 * np.sum(w * x * h / (m[:, None] + x), axis=1))


def half_space(mu: float, mu0: ArrayLike, albedo: float) -> tuple[Array, Array, Array]:
    """Radiance of an isotropic half-space of index 1 under a sun of unit irradiance: order 1,
    order 2 and all orders; cosines outside of view and light."""
    m0 = np.atleast_1d(np.asarray(mu0, dtype=np.float64))
    one = m0 * albedo / (4 * np.pi * (mu + m0))
    two = one * albedo / 2 * (mu * np.log1p(1 / mu) + m0 * np.log1p(1 / m0))
    every = one * chandrasekhar_h(mu, albedo) * chandrasekhar_h(m0, albedo)
    return one, two, every


def slab_orders_of_world(tau: float, albedo: float, mu: float, last: int) -> list[float]:
    """Radiance by order, 0 .. last, of an isotropic slab of index 1 in a surround of radiance 1.

    The source function of order k is S_k(t) = albedo/2 int S_(k-1)(t') E1|t - t'| dt', with
    S_1(t) = albedo/2 (E2(t) + E2(tau - t)); cosine mu of the view.
    """
    nodes = 200
    u, weight = _gauss(nodes)
    t, w = tau * (1 + u) / 2, tau * weight / 2
    # E1 is singular where t' = t: the source at t is taken out, and its integral is elementary.
    kernel = _exponential_integral(np.abs(t[:, None] - t) + np.eye(nodes)) * w
    np.fill_diagonal(kernel, 0.0)
    whole = 2 - _second_integral(t) - _second_integral(tau - t)
    source = albedo / 2 * (_second_integral(t) + _second_integral(tau - t))
    orders = [float(np.exp(-tau / mu))]
    for _ in range(last):
        orders.append(float(np.sum(w * source * np.exp(-t / mu)) / mu))
        source = albedo / 2 * (kernel @ source + (whole - kernel.sum(axis=1)) * source)
    return orders


def _exponential_integral(x: Array) -> Array:
    """E1(x) = int_0^1 exp(-x/m) / m dm, by m = exp(-v): int exp(-x e^v) dv."""
    u, weight = _gauss(160)
    # exp(-x e^v) is done for where x e^v = 40.
    top = np.maximum(np.log(40 / np.maximum(x, 1e-300)), 0.0)
    v = top[..., None] * (1 + u) / 2
    return np.sum(weight / 2 * np.exp(-x[..., None] * np.exp(v)), axis=-1) * top


def _second_integral(x: Array) -> Array:
    """E2(x) = exp(-x) - x E1(x)."""
    return np.exp(-x) - x * _exponential_integral(x)


def infinite_medium(offset: float, start: float, albedo: float) -> tuple[float, float]:
    """Orders 1 and 2 seen along the line (-start, offset) -> +x in an infinite isotropic medium of
    sigma_t = 1 and index 1, around a point of one watt at the origin.

    phi_1(r) = albedo/(2 r) int r' phi_0(r') [E1|r - r'| - E1(r + r')] dr', phi_0 = e^-r/(4 pi r^2);
    order k + 1 is the integral of albedo phi_k e^-t / (4 pi) along the line.
    """
    u, weight = _gauss(64)
    x, w = (1 + u) / 2, weight / 2

    def once(r: Array) -> Array:
        # Split at r' = r, where E1 has a logarithm: r' = r -+ r x^2 on both sides.
        total = np.zeros_like(r)
        for i, radius in enumerate(r):
            inner, inner_weight = radius * (1 - x**4), radius * 4 * x**3 * w
            outer = radius + 40 * x**4
            outer_weight = 40 * 4 * x**3 * w
            for q, q_weight in ((inner, inner_weight), (outer, outer_weight)):
                bracket = _exponential_integral(np.abs(radius - q)) - _exponential_integral(
                    radius + q
                )
                total[i] += np.sum(q_weight * np.exp(-q) / (4 * np.pi * q) * bracket)
        return albedo / (2 * r) * total

    v, path = _gauss(96)
    along = 20 * (1 + v) / 2
    place = np.hypot(offset, along - start)
    path = albedo / (4 * np.pi) * 10 * path * np.exp(-along)
    return (
        float(np.sum(path * np.exp(-place) / (4 * np.pi * place**2))),
        float(np.sum(path * once(place))),
    )
