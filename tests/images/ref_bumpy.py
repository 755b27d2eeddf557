# SPDX-License-Identifier: GPL-3.0-or-later
"""A slow, kernel-free renderer of single scattering inside one mesh, in float64 numpy.

It shares no code and no estimator with the C library, so that agreement means something. The
light side is a set of tubes, one for each lit triangle of the (refined) boundary; along a camera
segment o + t w the radiance is an integral over the curve on the boundary whose refracted light
lines x + s wl meet that segment:

    L_in = sigma_s  int dPhi  p(-wl.w)  e^{-sigma_t (s + t)}  delta(f),    f = (x - o).(wl x w)

f is linear in the Pluecker coordinates (m = x x wl, wl) of the light line and nearly linear
inside a small triangle, where the integral of delta(f) is the length of a chord over a gradient:

    int_T delta(f) dA / A_T = 2 |fa| / (|fa - fb| |fa - fc|),    a = the vertex of the other sign.

There is no kernel radius and no noise but that of the pixel samples; the error left is the
curvature of the refracted map inside a triangle, which `refinement` halves per step.

Paths: point light, refract in, scatter once, refract out, pinhole camera. Shading normals refract
and set the Fresnel terms; the geometric normal sets the intercepted flux. No adjoint factor.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from meshes import Mesh, subdivide
from numpy.typing import NDArray
from oracles import fresnel, henyey_greenstein, refract

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_NEAR = 1e-7  # metres: a ray that starts on the boundary does not hit it there
_PAIRS = 1_500_000  # pairs of (ray, node) alive at once: bounds memory


class BoxTree:
    """Binary tree of boxes in any dimension over items given by their own boxes.

    Built by median splits at the widest axis. All leaves lie on the last level and hold
    ``leaf`` items; the item count is padded by repeating the last one.
    """

    def __init__(self, low: Array, high: Array, leaf: int = 4) -> None:
        count = len(low)
        depth = max(0, int(np.ceil(np.log2(max(1, count) / leaf))))
        order = np.minimum(np.arange(leaf << depth), count - 1)[None]
        centres = (low + high) / 2
        for _ in range(depth):
            group = centres[order]
            axis = np.argmax(group.max(axis=1) - group.min(axis=1), axis=1)
            key = np.take_along_axis(group, axis[:, None, None], axis=2)[..., 0]
            order = np.take_along_axis(order, np.argsort(key, axis=1, kind="stable"), axis=1)
            order = order.reshape(2 * len(order), -1)
        self.leaves = order
        # A padded item must not be counted twice.
        flat = order.ravel()
        self.first = np.zeros(len(flat), dtype=bool)
        self.first[np.unique(flat, return_index=True)[1]] = True
        self.first = self.first.reshape(order.shape)
        self.levels: list[tuple[Array, Array]] = []
        lo, hi = low[order].min(axis=1), high[order].max(axis=1)
        while True:
            self.levels.insert(0, (lo, hi))
            if len(lo) == 1:
                break
            lo, hi = np.minimum(lo[::2], lo[1::2]), np.maximum(hi[::2], hi[1::2])


@dataclass(frozen=True)
class Hits:
    """Closest hits: distance (inf = none), triangle (-1 = none), barycentrics of corners 1, 2."""

    t: Array
    triangle: Index
    u: Array
    v: Array


class Surface:
    """Closest-hit queries on a triangle mesh."""

    def __init__(self, mesh: Mesh) -> None:
        if mesh.normals is None:
            raise ValueError("vertex normals are needed")
        self.corners = mesh.positions[mesh.triangles]
        self.normals = mesh.normals[mesh.triangles]
        cross = np.cross(
            self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0]
        )
        self.double_area = np.linalg.norm(cross, axis=1)
        self.flat = cross / self.double_area[:, None]
        a, b, c = (self.corners[:, k] for k in range(3))
        self.edges = (a, b - a, c - a)
        self.tree = BoxTree(self.corners.min(axis=1), self.corners.max(axis=1))

    def shading_normal(self, triangle: Index, u: Array, v: Array) -> Array:
        n = self.normals[triangle]
        n = n[:, 0] + u[:, None] * (n[:, 1] - n[:, 0]) + v[:, None] * (n[:, 2] - n[:, 0])
        return n / np.linalg.norm(n, axis=1, keepdims=True)

    def hit(self, origin: Array, direction: Array) -> Hits:
        """Closest hit at t > _NEAR metres; directions need not be unit, t is then in their unit."""
        count = len(origin)
        out = Hits(np.full(count, np.inf), np.full(count, -1), np.zeros(count), np.zeros(count))
        step = max(1, _PAIRS // 64)
        for begin in range(0, count, step):
            rays = np.arange(begin, min(begin + step, count))
            self._hit(origin, direction, rays, out)
        return out

    def _hit(self, origin: Array, direction: Array, rays: Index, out: Hits) -> None:
        with np.errstate(divide="ignore"):
            inverse = 1 / direction
        node = np.zeros(len(rays), dtype=np.int64)
        for level, (low, high) in enumerate(self.tree.levels):
            if level:
                rays = np.repeat(rays, 2)
                node = (2 * node[:, None] + [0, 1]).ravel()
            near, far = np.zeros(len(rays)), np.full(len(rays), np.inf)
            # Axis by axis: numpy reduces short rows slowly.
            for axis in range(3):
                o, inv = origin[rays, axis], inverse[rays, axis]
                with np.errstate(invalid="ignore"):
                    t0, t1 = (low[node, axis] - o) * inv, (high[node, axis] - o) * inv
                near = np.fmax(near, np.fmin(t0, t1))
                far = np.fmin(far, np.fmax(t0, t1))
            keep = near <= far * (1 + 1e-12)
            rays, node = rays[keep], node[keep]
        triangle = self.tree.leaves[node].ravel()
        rays = np.repeat(rays, self.tree.leaves.shape[1])
        a, e1, e2 = (edges[triangle].T for edges in self.edges)
        d, offset = direction[rays].T, origin[rays].T - a
        p, q = _cross(d, e2), _cross(offset, e1)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1 / _dot(e1, p)
            u, v, t = _dot(offset, p) * scale, _dot(d, q) * scale, _dot(e2, q) * scale
            # Edges belong to both triangles: a ray must not slip between them.
            keep = (u >= -1e-12) & (v >= -1e-12) & (u + v <= 1 + 1e-12) & (t > _NEAR)
        rays, triangle, t, u, v = rays[keep], triangle[keep], t[keep], u[keep], v[keep]
        order = np.lexsort((t, rays))
        closest, where = np.unique(rays[order], return_index=True)
        chosen = order[where]
        out.t[closest], out.triangle[closest] = t[chosen], triangle[chosen]
        out.u[closest], out.v[closest] = u[chosen], v[chosen]


def _cross(a: Array, b: Array) -> Array:
    """Cross products of columns."""
    return np.stack(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def _dot(a: Array, b: Array) -> Array:
    """Dot products of columns."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@dataclass(frozen=True)
class Scene:
    """One body in vacuum; RGB coefficients in 1/m, one point light of ``intensity`` W/sr."""

    mesh: Mesh
    n: float
    sigma_s: Array
    sigma_t: Array
    g: float
    light: Array
    intensity: float


def _rows(first: Array, second: Array) -> Array:
    """Dot products of rows."""
    return np.einsum("ij,ij->i", first, second)


class LightTubes:
    """The lit part of the boundary, refined, with its refracted light lines."""

    def __init__(self, scene: Scene, surface: Surface, refinement: int) -> None:
        self.scene, self.surface = scene, surface
        towards = scene.light - surface.corners[:, 0]
        lit = np.nonzero(_rows(towards, surface.flat) > 0)[0]
        # Shared vertices carry position and unnormalised normal; each refined triangle also
        # knows its parent and where in it its corners lie.
        normals = scene.mesh.normals
        assert normals is not None
        points = np.concatenate([scene.mesh.positions, normals], axis=1)
        triangles = scene.mesh.triangles[lit]
        bary, pattern = np.eye(3), np.array([[0, 1, 2]], dtype=np.uint32)
        for _ in range(refinement):
            points, triangles = subdivide(points, triangles)
            bary, pattern = subdivide(bary, pattern)
        used, corner = np.unique(triangles, return_inverse=True)
        self.corner = corner.reshape(-1, 3)
        self.share = 1.0 / len(pattern)
        self.parent = np.repeat(lit, len(pattern))
        self.bary = np.tile(bary[pattern], (len(lit), 1, 1))
        normal = points[used, 3:]
        normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        self.x = points[used, :3]
        self.wl, _ = self._enter(self.x, normal)
        shadow = surface.hit(self.x, scene.light - self.x)
        self.reach = surface.hit(self.x, self.wl).t
        seen = (shadow.t > 1)[self.corner]
        self.line = np.concatenate([np.cross(self.x, self.wl), self.wl], axis=1)
        # Where visibility or the exit jumps inside a tube, each crossing traces its own rays.
        self.reach = np.where(np.isfinite(self.reach), self.reach, 0.0)
        s = self.reach[self.corner]
        self.uncertain = ~seen.all(axis=1) | (s.max(axis=1) > 1.1 * s.min(axis=1))
        corners = self.line[self.corner]
        self.tree = BoxTree(corners.min(axis=1), corners.max(axis=1), leaf=8)

    def _enter(self, x: Array, normal: Array) -> tuple[Array, Array]:
        """Refracted directions at x and I T / r^2 there, W/m^2 across the light's ray.

        Light from behind the shading normal enters with T = 0, along the grazing direction.
        """
        ray = x - self.scene.light
        square = _rows(ray, ray)
        ray /= np.sqrt(square)[:, None]
        cosine = -_rows(ray, normal)
        grazing = ray + np.minimum(cosine, 0)[:, None] * normal
        grazing /= np.linalg.norm(grazing, axis=1, keepdims=True)
        enters = 1 - fresnel(np.maximum(cosine, 0), 1.0, self.scene.n)
        return refract(grazing, normal, 1.0, self.scene.n), self.scene.intensity * enters / square

    def refracted(self, triangle: Index, u: Array, v: Array) -> tuple[Array, Array, Array]:
        """Points on the boundary, refracted directions there, flux in W per whole triangle."""
        a, e1, e2 = (edges[triangle] for edges in self.surface.edges)
        x = a + u[:, None] * e1 + v[:, None] * e2
        wl, irradiance = self._enter(x, self.surface.shading_normal(triangle, u, v))
        flat = self.surface.flat[triangle]
        towards = self.scene.light - x
        cosine = _rows(towards, flat) / np.sqrt(_rows(towards, towards))
        # Shading and geometric normal may disagree on the side: such light does not enter.
        cosine = np.where(_rows(wl, flat) < 0, cosine, 0.0)
        return x, wl, irradiance * cosine * self.surface.double_area[triangle] / 2

    def traced(self, x: Array, wl: Array, s: Array) -> NDArray[np.bool_]:
        """Whether the light sees x and its refracted line stays inside for s metres."""
        shadow = self.surface.hit(x, self.scene.light - x)
        return (shadow.t > 1) & (s < self.surface.hit(x, wl).t)

    def crossings(self, pi: Array) -> Iterator[tuple[Index, Index, Array]]:
        """(ray, tube, f at its corners) of all tubes in which f changes sign; pi: (n, 6)."""
        step = 2048
        for begin in range(0, len(pi), step):
            rays = np.arange(begin, min(begin + step, len(pi)))
            yield from self._descend(pi, rays, np.zeros(len(rays), dtype=np.int64), 0)

    def _descend(
        self, pi: Array, rays: Index, node: Index, level: int
    ) -> Iterator[tuple[Index, Index, Array]]:
        if len(rays) > _PAIRS:
            half = len(rays) // 2
            yield from self._descend(pi, rays[:half], node[:half], level)
            yield from self._descend(pi, rays[half:], node[half:], level)
            return
        low, high = self.tree.levels[level]
        centre, extent = (low + high) / 2, (high - low) / 2
        p = pi[rays]
        bound = np.einsum("ij,ij->i", np.abs(p), extent[node])
        keep = np.abs(np.einsum("ij,ij->i", p, centre[node])) <= bound * (1 + 1e-9) + 1e-12
        rays, node = rays[keep], node[keep]
        if level + 1 < len(self.tree.levels):
            children = (2 * node[:, None] + [0, 1]).ravel()
            yield from self._descend(pi, np.repeat(rays, 2), children, level + 1)
            return
        size = self.tree.leaves.shape[1]
        for begin in range(0, len(rays), _PAIRS // size):
            part = slice(begin, begin + _PAIRS // size)
            tube = self.tree.leaves[node[part]]
            real = self.tree.first[node[part]]
            f = np.einsum("ij,iklj->ikl", pi[rays[part]], self.line[self.corner[tube]])
            positive = (f > 0).sum(axis=2)
            row, column = np.nonzero((positive > 0) & (positive < 3) & real)
            yield rays[part][row], tube[row, column], f[row, column]


def _closest(x: Array, wl: Array, o: Array, w: Array) -> tuple[Array, Array]:
    """s and t where the lines x + s wl and o + t w come closest."""
    d, c = x - o, _rows(wl, w)
    dw, dl = _rows(d, w), _rows(d, wl)
    scale = 1 / np.maximum(1 - c * c, 1e-12)
    return (dw * c - dl) * scale, (dw - dl * c) * scale


def _clip(value: tuple[Array, Array], high: tuple[Array, Array]) -> tuple[Array, Array]:
    """Part [q0, q1] of a chord on which 0 < value < high, both linear and given at its ends."""
    q0, q1 = np.zeros(len(value[0])), np.ones(len(value[0]))
    for a, b in (value, (high[0] - value[0], high[1] - value[1])):
        with np.errstate(divide="ignore", invalid="ignore"):
            zero = a / (a - b)
        q0 = np.where(a <= 0, np.where(b > 0, np.maximum(q0, zero), 1.0), q0)
        q1 = np.where(b <= 0, np.where(a > 0, np.minimum(q1, zero), 0.0), q1)
    return q0, q1


def gather(tubes: LightTubes, o: Array, w: Array, length: Array) -> Array:
    """Radiance inside the medium towards o along segments o + t w, 0 < t < length; (n, 3)."""
    scene = tubes.scene
    total = np.zeros((len(o), 3))
    pi = np.concatenate([w, np.cross(o, w)], axis=1)
    for ray, tube, f in tubes.crossings(pi):
        positive = (f > 0).sum(axis=1)
        # The corner whose sign differs comes first.
        odd = np.where(positive == 1, np.argmax(f, axis=1), np.argmin(f, axis=1))
        turn = (odd[:, None] + [0, 1, 2]) % 3
        fa, fb, fc = np.take_along_axis(f, turn, axis=1).T
        a, b, c = np.take_along_axis(tubes.corner[tube], turn, axis=1).T
        l1, l2 = fa / (fa - fb), fa / (fa - fc)
        density = 2 * np.abs(fa) / (np.abs(fa - fb) * np.abs(fa - fc))

        def between(values: Array, end: Index, share: Array, a: Index = a) -> Array:
            weight = share if values.ndim == 1 else share[:, None]
            return values[a] + weight * (values[end] - values[a])

        ends = []
        for end, share in ((b, l1), (c, l2)):
            s, t = _closest(
                between(tubes.x, end, share), between(tubes.wl, end, share), o[ray], w[ray]
            )
            ends.append((s, t, between(tubes.reach, end, share)))
        (s0, t0, reach0), (s1, t1, reach1) = ends
        far = length[ray]
        doubtful = tubes.uncertain[tube]
        reach0, reach1 = (np.where(doubtful, 1e9, r) for r in (reach0, reach1))
        q0, q1 = _clip((t0, t1), (far, far))
        r0, r1 = _clip((s0, s1), (reach0, reach1))
        q0, q1 = np.maximum(q0, r0), np.minimum(q1, r1)
        keep = q1 > q0
        ray, tube, density, doubtful = ray[keep], tube[keep], density[keep], doubtful[keep]
        l1, l2, q0, q1 = l1[keep], l2[keep], q0[keep], q1[keep]
        # Everything but the curve itself is evaluated exactly, at the middle of the chord.
        middle = (q0 + q1) / 2
        k1, k2 = l1 * (1 - middle), l2 * middle
        at, at_b, at_c = (tubes.bary[tube, turn[keep][:, k], 1:] for k in range(3))
        u, v = (at + k1[:, None] * (at_b - at) + k2[:, None] * (at_c - at)).T
        parent = tubes.parent[tube]
        x, wl, flux = tubes.refracted(parent, u, v)
        s, t = _closest(x, wl, o[ray], w[ray])
        flux = flux * tubes.share
        ask = np.nonzero(doubtful)[0]
        if len(ask):
            flux[ask] = np.where(tubes.traced(x[ask], wl[ask], s[ask]), flux[ask], 0)
        cosine = -_rows(wl, w[ray])
        value = flux * density * (q1 - q0) * henyey_greenstein(cosine, scene.g)
        for k in range(3):
            fade = np.exp(-scene.sigma_t[k] * (np.maximum(s, 0) + np.maximum(t, 0)))
            total[:, k] += np.bincount(ray, value * fade, minlength=len(o)) * scene.sigma_s[k]
    return total


def trace(tubes: LightTubes, origin: Array, direction: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Radiance of single scattering towards camera rays, (n, 3), and which of them hit."""
    surface, n = tubes.surface, tubes.scene.n
    hits = surface.hit(origin, direction)
    seen = hits.triangle >= 0
    where = np.nonzero(seen)[0]
    triangle = hits.triangle[where]
    normal = surface.shading_normal(triangle, hits.u[where], hits.v[where])
    d = direction[where]
    cosine = -_rows(d, normal)
    w = refract(d, normal, 1.0, n)
    good = (cosine > 0) & (_rows(w, surface.flat[triangle]) < 0)
    where, triangle, cosine, w = where[good], triangle[good], cosine[good], w[good]
    o = origin[where] + hits.t[where, None] * direction[where]
    length = surface.hit(o, w).t
    length = np.where(np.isfinite(length), length, 0.0)
    out = np.zeros((len(origin), 3))
    leaves = (1 - fresnel(cosine, 1.0, n)) / n**2
    out[where] = leaves[:, None] * gather(tubes, o, w, length)
    return out, seen


def pinhole(
    size: int, samples: int, eye_z: float, fov: float, rng: np.random.Generator
) -> tuple[Array, Index]:
    """Directions of jittered, stratified rays from (0, 0, eye_z) along -z, and their pixels.

    Row 0 is the top; ``samples`` is a square number; fov is the full angle in radians.
    """
    side = int(np.sqrt(samples))
    fine = size * side
    row, column = (index.ravel() for index in np.indices((fine, fine)))
    x = (column + rng.random(fine * fine)) / fine * 2 - 1
    y = 1 - (row + rng.random(fine * fine)) / fine * 2
    half = np.tan(fov / 2)
    d = np.stack([x * half, y * half, -np.ones_like(x)], axis=1)
    return d / np.linalg.norm(d, axis=1, keepdims=True), (row // side) * size + column // side


def render(
    scene: Scene,
    size: int,
    samples: int,
    refinement: int,
    eye_z: float = 5.0,
    fov: float = np.radians(30.0),
    seed: int = 1,
) -> tuple[Array, Array]:
    """Image (size, size, 3), row 0 = top, and the fraction of each pixel that the body covers."""
    tubes = LightTubes(scene, Surface(scene.mesh), refinement)
    direction, pixel = pinhole(size, samples, eye_z, fov, np.random.default_rng(seed))
    origin = np.broadcast_to(np.array([0.0, 0.0, eye_z]), direction.shape)
    value, seen = trace(tubes, origin, direction)
    count = size * size
    image = np.stack([np.bincount(pixel, value[:, k], minlength=count) for k in range(3)], axis=1)
    cover = np.bincount(pixel, seen, minlength=count) / samples
    return (image / samples).reshape(size, size, 3), cover.reshape(size, size)


def bumpy_scene(mesh: Mesh) -> Scene:
    """The medium and light of the bumpy case (BumpyS of Liang et al. 2020, table 3)."""
    sigma_a = np.array([0.0098988121, 0.10012399, 0.24977001])
    sigma_s = np.array([0.21007479, 0.20985741, 0.21021159])
    light = np.array([-4.5, 1.5, -1.6])
    return Scene(mesh, 1.5, sigma_s, sigma_s + sigma_a, 0.9, light, 100.0)
