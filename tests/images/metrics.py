# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors of an image against a reference; the definitions are those of docs/accuracy.md.

Images are (height, width, 3) linear radiance; ``mask`` is (height, width) bool, true where the
primary ray hits a translucent object. Everything is computed in float64.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.floating]
Mask = NDArray[np.bool_]


def _masked(image: Image, mask: Mask | None) -> NDArray[np.float64]:
    """The compared values, shape (pixels, channels)."""
    values = np.asarray(image, dtype=np.float64)
    return values.reshape(-1, values.shape[-1]) if mask is None else values[mask]


def mse(image: Image, reference: Image, mask: Mask | None = None) -> float:
    """Mean squared difference over pixels and channels."""
    return float(np.mean((_masked(image, mask) - _masked(reference, mask)) ** 2))


def rel_rmse(image: Image, reference: Image, mask: Mask | None = None) -> float:
    """Root of ``mse`` over the reference's mean."""
    return float(np.sqrt(mse(image, reference, mask)) / np.mean(_masked(reference, mask)))


def floored_rel(image: Image, reference: Image, mask: Mask | None = None) -> float:
    """Relative error pixel by pixel, with 5 % of the mean added below: it sees dark regions."""
    target, truth = _masked(image, mask), _masked(reference, mask)
    floor = 0.05 * np.mean(truth)
    return float(np.sqrt(np.mean(((target - truth) / (truth + floor)) ** 2)))


def mean_ratio(image: Image, reference: Image, mask: Mask | None = None) -> NDArray[np.float64]:
    """Mean over mean for each channel: bias."""
    return np.mean(_masked(image, mask), axis=0) / np.mean(_masked(reference, mask), axis=0)


def cross_mse(image: Image, first: Image, second: Image, mask: Mask | None = None) -> float:
    """Mean squared error against two independent noisy references: their noise cancels."""
    target = _masked(image, mask)
    return float(np.mean((target - _masked(first, mask)) * (target - _masked(second, mask))))


def box_down(image: Image, factor: int) -> NDArray[np.float64]:
    """Average of factor x factor blocks, which is what a box filter on larger pixels sees."""
    height, width = image.shape[:2]
    blocks = np.asarray(image, dtype=np.float64).reshape(
        height // factor, factor, width // factor, factor, *image.shape[2:]
    )
    return blocks.mean(axis=(1, 3))
