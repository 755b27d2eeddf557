# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors of an image against a reference; the definitions are those of docs/accuracy.md.

Images are (height, width, 3) linear radiance; `mask` is (height, width) bool, true where the
primary ray hits a translucent object. Everything is computed in float64.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Image = NDArray[Any]
Mask = NDArray[np.bool_]

# The share of pixels and channels that `peak` leaves above itself: fireflies.
PEAK_PERCENTILE = 99.99
# Of the reference's mean, added below each pixel by `floored_rel`.
FLOOR = 0.05


def _masked(image: Image, mask: Mask | None) -> NDArray[np.float64]:
    """The compared values, shape (pixels, channels)."""
    values = np.asarray(image, dtype=np.float64)
    return values.reshape(-1, values.shape[-1]) if mask is None else values[mask]


def mse(image: Image, reference: Image, mask: Mask | None = None) -> float:
    """Mean squared difference over pixels and channels."""
    return float(np.mean((_masked(image, mask) - _masked(reference, mask)) ** 2))


def rel_rmse(image: Image, reference: Image, mask: Mask | None = None) -> float:
    """Root of `mse` over the reference's mean."""
    return float(np.sqrt(mse(image, reference, mask)) / np.mean(_masked(reference, mask)))


def floored_rel(image: Image, reference: Image, mask: Mask | None = None) -> float:
    """Relative error pixel by pixel, with 5 % of the mean added below: it sees dark regions."""
    target, truth = _masked(image, mask), _masked(reference, mask)
    floor = FLOOR * np.mean(truth)
    return float(np.sqrt(np.mean(((target - truth) / (truth + floor)) ** 2)))


def mean_ratio(image: Image, reference: Image, mask: Mask | None = None) -> NDArray[np.float64]:
    """Mean over mean for each channel: bias."""
    means = [np.mean(_masked(values, mask), axis=0) for values in (image, reference)]
    return np.asarray(means[0] / means[1])


def peak(image: Image, reference: Image, mask: Mask | None = None) -> float:
    """99.99th percentile of |T - R| over pixels and channels: fireflies."""
    difference = np.abs(_masked(image, mask) - _masked(reference, mask))
    return float(np.percentile(difference, PEAK_PERCENTILE))


def cross_mse(image: Image, first: Image, second: Image, mask: Mask | None = None) -> float:
    """Mean squared error against two independent noisy references: their noise cancels."""
    target = _masked(image, mask)
    return float(np.mean((target - _masked(first, mask)) * (target - _masked(second, mask))))


def cross_floored_rel(image: Image, first: Image, second: Image, mask: Mask | None = None) -> float:
    """`floored_rel` against two independent noisy references; not a number where the mean of
    the products is negative: then the error is below what the references can show."""
    target = _masked(image, mask)
    a, b = _masked(first, mask), _masked(second, mask)
    truth = (a + b) / 2
    weight = truth + FLOOR * np.mean(truth)
    return _root(float(np.mean((target - a) * (target - b) / weight**2)))


def box_down(image: Image, factor: int) -> NDArray[np.float64]:
    """Average of factor x factor blocks, which is what a box filter on larger pixels sees."""
    height, width = image.shape[:2]
    blocks = np.asarray(image, dtype=np.float64).reshape(
        height // factor, factor, width // factor, factor, *image.shape[2:]
    )
    return np.asarray(blocks.mean(axis=(1, 3)))


@dataclass(frozen=True)
class Errors:
    """All errors of one image; `mean_ratio` for each channel."""

    mse: float
    rel_rmse: float
    floored_rel: float
    mean_ratio: tuple[float, ...]
    peak: float


def errors(image: Image, references: Sequence[Image], mask: Mask | None = None) -> Errors:
    """Against one reference, or against two whose noise is independent."""
    if len(references) == 1:
        truth = references[0]
        square = mse(image, truth, mask)
        floored = floored_rel(image, truth, mask)
    else:
        truth = (np.asarray(references[0], np.float64) + references[1]) / 2
        square = cross_mse(image, references[0], references[1], mask)
        floored = cross_floored_rel(image, references[0], references[1], mask)
    return Errors(
        square,
        _root(square) / float(np.mean(_masked(truth, mask))),
        floored,
        tuple(float(v) for v in mean_ratio(image, truth, mask)),
        peak(image, truth, mask),
    )


def _root(square: float) -> float:
    return math.sqrt(square) if square >= 0.0 else math.nan
