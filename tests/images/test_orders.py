# SPDX-License-Identifier: GPL-3.0-or-later
"""Orders of scattering of the library against the independent path tracer.

The stored references are made by references/make_orders.py. The same comparison with more samples,
as a table: tests/bench/bench_orders.py.
"""

from __future__ import annotations

import numpy as np
import pytest
from order_scenes import ORDERS, RADII, library_orders, reference_scene, stored_orders, whole

SIZE, RUNS = 16, 8
# Of a pixel.
SAMPLES = 8
# Kernels carry light towards the walls, by 3 % of the later orders of the slab of optical radius 10
# at their default size: here they are a quarter of its area. Walks average over them.
KERNEL_SIZE = 1.0
VOLUME_SAMPLES = {0.3: 2**14, 2.0: 2**15, 10.0: 2**17}
SIGMAS, SIGMAS_OF_REGIONS = 3.0, 4.0
# The most that the standard errors of the picture's mean may be, of references and of both, the
# latter by order.
KNOWN = 0.01
ERRORS = {"1": 0.01, "2": 0.02, "3": 0.03, "4+": 0.05, "1+": 0.015}


@pytest.mark.parametrize("radius", RADII)
@pytest.mark.parametrize("shape", ["sphere", "slab", "bumpy"])
def test_orders(shape: str, radius: float) -> None:
    """Orders 1, 2, 3, 4 and up, in the picture and in each quarter of it."""
    known, scene = stored_orders(shape, radius), reference_scene(shape, radius)
    found = library_orders(
        scene,
        SIZE,
        RUNS,
        samples=SAMPLES,
        kernel_size=KERNEL_SIZE,
        light_samples=VOLUME_SAMPLES[radius],
    )
    mean, error = whole(known)
    ours, our_error = whole(found)
    for order, most in ERRORS.items():
        k = ORDERS.index(order)
        assert error[k] < KNOWN * mean[k], order
        sigma = np.hypot(error[k], our_error[k])
        assert sigma < most * mean[k], order
        assert abs(ours[k] - mean[k]) < SIGMAS * sigma, order
        off = np.abs(found.mean - known.mean)[..., k]
        sigmas = np.hypot(found.error, known.error)[..., k]
        assert np.all(off < SIGMAS_OF_REGIONS * sigmas), order
