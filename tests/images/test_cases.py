# SPDX-License-Identifier: GPL-3.0-or-later
"""The shared cases through the public C API, compared as docs/accuracy.md says.

Bars: the mean within 0.5 % of SmallUPBP on the bumpy sphere and within 0.3 % of the quadrature on
slab and sphere, in every channel; 0.2 % on all for tubes and exact connections. The cases are of
the light-tracing kind: no adjoint factor, no internal reflection, single scattering alone.
"""

from __future__ import annotations

import metrics
import numpy as np
import pytest
from api import ESTIMATORS, LIBRARY, TRIANGLES, render
from cases import load_case, sphere_interior

pytestmark = [
    pytest.mark.skipif(not LIBRARY.is_file(), reason=f"{LIBRARY} is not built"),
]
# Kernels blur light past the edges of the slab: 0.2 % of its mean at 2^20 samples and size 8,
# 0.02 % at size 2.
SETTINGS = {"light_samples": 2**21, "kernel_size": 4.0, "tube_refinement": 1, "samples": 4}
TRIANGLES_BAR = 0.002


@pytest.mark.parametrize("estimator", ESTIMATORS.values(), ids=ESTIMATORS.keys())
@pytest.mark.parametrize(
    ("name", "bar", "pixels"),
    [("bumpy", 0.005, 0.10), ("slab", 0.003, 0.10), ("sphere", 0.003, 0.10)],
)
def test_case(name: str, bar: float, pixels: float, estimator: int) -> None:
    """``bar`` on the mean of points; ``pixels`` on floored_rel, which wrong shapes would exceed."""
    case = load_case(name)
    image = render(case.build, 128, estimator=estimator, **SETTINGS)
    mask = image.cover > 0
    first, second = case.reference("ref_128_A"), case.reference("ref_128_B")
    truth = (first + second) / 2 if name == "bumpy" else case.reference("analytic_128")
    if name == "sphere":
        mask &= sphere_interior(128, case)
    ratio = metrics.mean_ratio(image.pixels, truth, mask)
    is_exact = estimator in TRIANGLES.values()
    assert ratio == pytest.approx(np.ones(3), abs=TRIANGLES_BAR if is_exact else bar)
    assert metrics.floored_rel(image.pixels, truth, mask) < pixels
    # Nothing is drawn where the reference has nothing.
    assert np.all(image.pixels[image.cover == 0] == 0)
