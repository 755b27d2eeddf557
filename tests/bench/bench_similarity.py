# SPDX-License-Identifier: GPL-3.0-or-later
"""What similarity reduction and diffusion would save photons in thick media, and what they would
cost. Prints; never asserts.

    python3 tests/bench/bench_similarity.py [--photons N] [--g G] [--radius TAU ...]

A Monte Carlo of its own, in a ball of index 1.5 under a sun: no code of the library. Photons fly,
lose what is absorbed, scatter, are reflected or leave by lot, and survive by roulette below a
quarter of their weight, as the library's do; a collision adds weight / sigma_t to the fluence of a
cell, a band of latitude around the sun's axis and a layer of depth, and each photon that leaves
adds to its band. After `from` scatterings a reduced run takes g' = 0, sigma_s' = (1 - g) sigma_s.

It is compared with the full one in what leaves and in the fluence of the three layers under the
surface, of light that scattered twice and more: rel_rmse, from the product of the differences of
two pairs of runs, which has no noise in expectation and may be below zero. `gain` is collisions
saved; `at equal noise` is that times the variance of the fluence, from batches: fewer collisions
also say less. The last columns are for diffusion: of the collisions, and of the light that leaves,
what comes after 10 / (1 - g) scatterings, when light has forgotten where it came from.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

IOR = 1.5
BANDS, LAYERS, BATCHES = 12, 3, 16
LAYER = 1.0  # transport mean free paths
ALBEDOS = (0.99, 0.999, 0.9999)
FROM = (1, 3, 10, 30)
ROULETTE = 0.25


@dataclass
class Tally:
    """By batch, per photon that enters."""

    exitance: Array  # (BATCHES, BANDS)
    fluence: Array  # (BATCHES, LAYERS, BANDS)
    collisions: float
    late_collisions: float
    late_exitance: float


def fresnel(cos_i: Array, eta: float) -> Array:
    """Reflectance from inside (eta = n / 1) or outside (1 / n)."""
    sin_t2 = eta**2 * (1 - cos_i**2)
    cos_t = np.sqrt(np.maximum(1 - sin_t2, 0))
    parallel = (eta * cos_t - cos_i) / (eta * cos_t + cos_i)
    across = (eta * cos_i - cos_t) / (eta * cos_i + cos_t)
    return np.asarray(np.where(sin_t2 >= 1, 1.0, 0.5 * (parallel**2 + across**2)))


def turned(d: Array, cosine: Array, phi: Array) -> Array:
    """Unit vectors at an angle to d."""
    sign = np.where(d[:, 2] < 0, -1.0, 1.0)
    a = -1 / (sign + d[:, 2])
    b = d[:, 0] * d[:, 1] * a
    x = np.stack([1 + sign * d[:, 0] ** 2 * a, sign * b, -sign * d[:, 0]], axis=1)
    y = np.stack([b, sign + d[:, 1] ** 2 * a, -d[:, 1]], axis=1)
    sine = np.sqrt(np.maximum(1 - cosine**2, 0))
    out = (sine * np.cos(phi))[:, None] * x + (sine * np.sin(phi))[:, None] * y
    out += cosine[:, None] * d
    return np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True))


def henyey(g: float, u: Array) -> Array:
    if abs(g) < 1e-3:
        return 1 - 2 * u
    s = (1 - g * g) / (1 - g + 2 * g * u)
    return np.asarray(np.clip((1 + g * g - s * s) / (2 * g), -1, 1))


def trace(count: int, tau: float, albedo: float, g: float, reduce_from: int, seed: int) -> Tally:
    rng = np.random.default_rng(seed)
    sigma_s, sigma_a = tau * albedo, tau * (1 - albedo)
    transport = sigma_s * (1 - g) + sigma_a
    late = int(10 / (1 - g))

    # Uniform over the disc that the sun sees, refracted at the surface.
    r, phi = np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
    cos_i = np.sqrt(1 - r**2)
    p = np.stack([r * np.cos(phi), r * np.sin(phi), cos_i], axis=1)
    cos_t = np.sqrt(1 - (1 - cos_i**2) / IOR**2)
    d = np.array([0, 0, -1.0]) / IOR - p * (cos_t - cos_i / IOR)[:, None]
    weight = 1 - fresnel(cos_i, 1 / IOR)
    entered = weight.sum()
    worth = weight.copy()
    order = np.zeros(count, dtype=np.int64)
    batch = np.arange(count) % BATCHES

    tally = Tally(np.zeros((BATCHES, BANDS)), np.zeros((BATCHES, LAYERS, BANDS)), 0.0, 0.0, 0.0)
    while len(weight):
        reduced = order >= reduce_from
        scatters = np.where(reduced, sigma_s * (1 - g), sigma_s)
        sigma_t = scatters + sigma_a
        flight = -np.log1p(-rng.random(len(weight))) / sigma_t
        along = (p * d).sum(axis=1)
        wall = -along + np.sqrt(np.maximum(along**2 + 1 - (p**2).sum(axis=1), 0))
        hits = flight >= wall
        p = p + np.minimum(flight, wall)[:, None] * d

        # Walls.
        n = p[hits] / np.linalg.norm(p[hits], axis=1, keepdims=True)
        cosine = np.clip((n * d[hits]).sum(axis=1), 0, 1)
        out = rng.random(len(cosine)) >= fresnel(cosine, IOR)
        band = np.clip(((n[:, 2] + 1) / 2 * BANDS).astype(int), 0, BANDS - 1)
        leaves = out & (order[hits] > 1)
        np.add.at(tally.exitance, (batch[hits][leaves], band[leaves]), weight[hits][leaves])
        tally.late_exitance += weight[hits][leaves & (order[hits] > late)].sum()
        p[hits] = n
        d[hits] -= 2 * cosine[:, None] * n

        # Collisions.
        c = ~hits
        tally.collisions += c.sum()
        tally.late_collisions += (c & (order > late)).sum()
        depth = (1 - np.linalg.norm(p, axis=1)) * transport / LAYER
        kept = c & (order > 0) & (depth < LAYERS)
        band = np.clip(((p[:, 2] / np.linalg.norm(p, axis=1) + 1) / 2 * BANDS), 0, BANDS - 1)
        where = (batch[kept], depth[kept].astype(int), band[kept].astype(int))
        np.add.at(tally.fluence, where, weight[kept] / sigma_t[kept])
        weight[c] *= scatters[c] / sigma_t[c]
        cosines = np.where(reduced, 1 - 2 * rng.random(len(c)), henyey(g, rng.random(len(c))))
        d[c] = turned(d[c], cosines[c], 2 * np.pi * rng.random(c.sum()))
        order[c] += 1

        # Roulette, and what is left.
        alive = np.ones(len(weight), dtype=bool)
        alive[np.flatnonzero(hits)[out]] = False
        weak = alive & (weight < ROULETTE * worth)
        survives = rng.random(len(weight)) < weight / worth
        alive &= ~weak | survives
        weight = np.where(weak, worth, weight)
        p, d, weight, worth = p[alive], d[alive], weight[alive], worth[alive]
        order, batch = order[alive], batch[alive]
    late_exitance = tally.late_exitance / tally.exitance.sum()
    scale = BATCHES / entered
    return Tally(
        tally.exitance * scale,
        tally.fluence * scale,
        tally.collisions / count,
        tally.late_collisions / tally.collisions,
        late_exitance,
    )


def rel_rmse(full: list[Array], reduced: list[Array]) -> float:
    """From means over batches of two runs of each."""
    a, b = (full[i].mean(axis=0) - reduced[i].mean(axis=0) for i in (0, 1))
    square = float((a * b).mean())
    return float(np.sign(square) * np.sqrt(abs(square)) / np.mean([x.mean() for x in full]))


def variance(runs: list[Array]) -> float:
    """Of a cell's fluence by one photon, relative, mean over cells that have a tenth of the light
    of the mean one."""
    both = np.concatenate(runs)
    mean = both.mean(axis=0)
    cells = mean > 0.1 * mean.mean()
    return float((both.var(axis=0, ddof=1)[cells] / mean[cells] ** 2).mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--photons", type=int, default=40_000)
    parser.add_argument("--g", type=float, default=0.8)
    parser.add_argument("--radius", type=float, nargs="*", default=[20.0, 60.0])
    options = parser.parse_args()
    print(
        "| optical radius | albedo | from | leaves | fluence | collisions | gain "
        "| at equal noise | late collisions | late light |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    never = 1 << 40
    for tau in options.radius:
        for albedo in ALBEDOS:
            full = [trace(options.photons, tau, albedo, options.g, never, s) for s in (1, 2)]
            noise = variance([run.fluence for run in full])
            print(
                f"| {tau:g} | {albedo:g} | never | | | {full[0].collisions:.0f} | | | "
                f"{full[0].late_collisions:.0%} | {full[0].late_exitance:.0%} |",
                flush=True,
            )
            for first in FROM:
                some = [trace(options.photons, tau, albedo, options.g, first, s) for s in (3, 4)]
                leaves = rel_rmse([x.exitance for x in full], [x.exitance for x in some])
                fluence = rel_rmse([x.fluence for x in full], [x.fluence for x in some])
                gain = full[0].collisions / some[0].collisions
                equal = gain * noise / variance([x.fluence for x in some])
                print(
                    f"| {tau:g} | {albedo:g} | {first} | {leaves:+.1%} | {fluence:+.1%} | "
                    f"{some[0].collisions:.0f} | {gain:.1f} | {equal:.1f} | | |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
