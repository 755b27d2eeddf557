# SPDX-License-Identifier: GPL-3.0-or-later
"""The reference cases through Blender: import, export, engine, passes, pixels.

The twin of tests/images/test_cases.py, with the same bars: what differs between the two is the
way of the scene through Blender. AMBERLIGHT_BLENDER names another Blender.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(ROOT / "tests/images"))

import metrics  # noqa: E402
from api import LIBRARY, render  # noqa: E402
from cases import load_case, sphere_interior  # noqa: E402

BLENDER = os.environ.get("AMBERLIGHT_BLENDER", "blender")
SIZE = 128
SETTINGS = {"light_samples": 2**21, "kernel_size": 4.0, "samples": 4}

pytestmark = [
    pytest.mark.skipif(shutil.which(BLENDER) is None, reason="no Blender"),
    pytest.mark.skipif(not LIBRARY.is_file(), reason=f"{LIBRARY} is not built"),
]


@pytest.fixture(scope="module")
def scripts(tmp_path_factory):
    """A folder of scripts that holds the add-on of this checkout."""
    folder = tmp_path_factory.mktemp("scripts")
    (folder / "addons").mkdir()
    (folder / "addons" / "amberlight").symlink_to(ROOT / "addon" / "amberlight")
    return folder


@pytest.fixture
def blender_image(scripts, tmp_path):
    """Renders a case in Blender; (SIZE, SIZE, 4) float32, row 0 = top."""

    def run(case, estimator):
        out = tmp_path / "image.npy"
        settings = SETTINGS | {"estimator": estimator}
        command = [
            BLENDER, "-b", "--factory-startup", "--addons", "amberlight",
            "--python", str(HERE / "import_case.py"), "--", str(case.folder), str(out), str(SIZE),
            *(f"{name}={value}" for name, value in settings.items()),
        ]  # fmt: skip
        environment = {
            **os.environ,
            "BLENDER_USER_SCRIPTS": str(scripts),
            "AMBERLIGHT_LIBRARY": str(LIBRARY),
        }
        done = subprocess.run(
            command, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=300
        )
        assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
        return np.load(out)

    return run


@pytest.mark.parametrize("estimator", ["POINTS_FIXED", "POINTS_COVARIANCE"])
@pytest.mark.parametrize(("name", "bar"), [("bumpy", 0.005), ("slab", 0.003), ("sphere", 0.003)])
def test_case_in_blender(name, bar, estimator, blender_image):
    case = load_case(name)
    image = blender_image(case, estimator)
    mask = image[..., 3] > 0
    if name == "bumpy":
        truth = (case.reference("ref_128_A") + case.reference("ref_128_B")) / 2
    else:
        truth = case.reference("analytic_128")
    if name == "sphere":
        mask &= sphere_interior(SIZE, case)
    assert metrics.mean_ratio(image[..., :3], truth, mask) == pytest.approx(np.ones(3), abs=bar)
    assert metrics.floored_rel(image[..., :3], truth, mask) < 0.10


@pytest.mark.parametrize("name", ["bumpy", "slab"])
def test_blender_changes_nothing(name, blender_image):
    """The same numbers go in, so the image is that of the C API but for rounding and its noise."""
    case = load_case(name)
    through = blender_image(case, "POINTS_COVARIANCE")
    direct = render(case.build, SIZE, estimator=2, **SETTINGS)
    assert np.mean((through[..., 3] > 0) != (direct.cover > 0)) < 1e-3
    ratio = metrics.mean_ratio(through[..., :3], direct.pixels, direct.cover > 0)
    assert ratio == pytest.approx(np.ones(3), abs=1e-3)
