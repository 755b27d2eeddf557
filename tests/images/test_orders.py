# SPDX-License-Identifier: GPL-3.0-or-later
"""Orders of scattering of the library against the independent path tracer.

The stored references are made by references/make_orders.py. The same comparison with more samples,
as a table: tests/bench/bench_orders.py.
"""

from __future__ import annotations

import numpy as np
import pytest
from order_scenes import ORDERS, RADII, library_orders, reference_scene, stored_orders, whole

SIZE, RUNS = 16, 16
SIGMAS = 4.0
# Where free paths are short, kernels must be narrower: bumps of light a kernel wide are 4 % of the
# later orders of the slab at 2^15.
VOLUME_SAMPLES = {0.3: 2**15, 2.0: 2**15, 10.0: 2**17}
# The most that the standard error of the picture's mean may be, of references and of both.
KNOWN = {0.3: 0.01, 2.0: 0.01, 10.0: 0.02}
ERROR = 0.05
# The field's own error at so few volume samples: its kernel.
BIAS = 0.015


@pytest.mark.parametrize("radius", RADII)
@pytest.mark.parametrize("shape", ["sphere", "slab", "bumpy"])
def test_orders(shape: str, radius: float) -> None:
    """Orders 1, 2, 3, 4 and up, in the picture and in each quarter of it."""
    known, scene = stored_orders(shape, radius), reference_scene(shape, radius)
    found = library_orders(scene, SIZE, RUNS, light_samples=VOLUME_SAMPLES[radius])
    mean, error = whole(known)
    ours, our_error = whole(found)
    for order in ("1", "2", "3", "4+", "1+"):
        k = ORDERS.index(order)
        assert error[k] < KNOWN[radius] * mean[k]
        sigma = np.hypot(error[k], our_error[k])
        assert order == "4+" or sigma < ERROR * mean[k], order
        assert abs(ours[k] - mean[k]) < SIGMAS * sigma + BIAS * mean[k], order
        off = np.abs(found.mean - known.mean)[..., k]
        sigmas = np.hypot(found.error, known.error)[..., k]
        assert np.all(off < SIGMAS * sigmas + BIAS * known.mean[..., k]), order
