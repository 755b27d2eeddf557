# SPDX-License-Identifier: GPL-3.0-or-later
"""The metrics on images whose errors are known by construction."""

from __future__ import annotations

import metrics
import numpy as np
import pytest

SHAPE = (64, 64, 3)


def test_constant_offset() -> None:
    reference = np.full(SHAPE, 2.0)
    assert metrics.mse(reference + 0.2, reference) == pytest.approx(0.04)
    assert metrics.rel_rmse(reference + 0.2, reference) == pytest.approx(0.1)
    assert metrics.floored_rel(reference + 0.2, reference) == pytest.approx(0.2 / 2.1)


def test_mean_ratio_is_per_channel() -> None:
    reference = np.random.default_rng(1).random(SHAPE) + 0.5
    scaled = reference * np.array([1.0, 1.01, 0.97])
    assert metrics.mean_ratio(scaled, reference) == pytest.approx([1.0, 1.01, 0.97])


def test_mask_leaves_the_rest_out() -> None:
    reference = np.ones(SHAPE)
    image = reference.copy()
    image[:32] = 7
    mask = np.zeros(SHAPE[:2], dtype=bool)
    mask[32:] = True
    assert metrics.mse(image, reference, mask) == 0
    assert metrics.mse(image, reference) == pytest.approx(18)


def test_cross_mse_cancels_the_noise_of_the_references() -> None:
    rng = np.random.default_rng(2)
    truth = rng.random((256, 256, 3))
    first, second = (truth + rng.normal(0, 0.3, truth.shape) for _ in range(2))
    image = truth + 0.05
    assert metrics.mse(image, first) == pytest.approx(0.09, rel=0.05)
    assert metrics.cross_mse(image, first, second) == pytest.approx(0.0025, abs=6e-4)


def test_peak_is_the_highest_in_ten_thousand() -> None:
    reference = np.zeros((200, 200, 1))
    image = reference.copy()
    # 4 of 40000 values may lie above the percentile: five fireflies reach it, four do not.
    image.ravel()[:4] = 100
    assert metrics.peak(image, reference) == pytest.approx(0.01, abs=0.02)
    image.ravel()[:6] = 100
    assert metrics.peak(image, reference) == 100


def test_all_errors_against_one_reference() -> None:
    reference = np.full(SHAPE, 2.0)
    found = metrics.errors(reference + 0.2, [reference])
    assert found.mse == pytest.approx(0.04)
    assert found.rel_rmse == pytest.approx(0.1)
    assert found.floored_rel == pytest.approx(0.2 / 2.1)
    assert found.mean_ratio == pytest.approx([1.1] * 3)
    assert found.peak == pytest.approx(0.2)


def test_all_errors_against_two_noisy_references() -> None:
    rng = np.random.default_rng(3)
    truth = np.full((256, 256, 3), 2.0)
    noisy = [truth + rng.normal(0, 0.1, truth.shape) for _ in range(2)]
    found = metrics.errors(truth + 0.2, noisy)
    assert found.mse == pytest.approx(0.04, rel=0.05)
    assert found.rel_rmse == pytest.approx(0.1, rel=0.03)
    # Its weights are as noisy as the references, which adds a little.
    assert found.floored_rel == pytest.approx(0.2 / 2.1, rel=0.05)
    # Less than nothing: between the two references there is no error to be seen.
    assert np.isnan(metrics.errors((noisy[0] + noisy[1]) / 2, noisy).rel_rmse)


def test_box_down() -> None:
    image = np.arange(16.0).reshape(4, 4, 1)
    assert metrics.box_down(image, 2)[..., 0].tolist() == [[2.5, 4.5], [10.5, 12.5]]
