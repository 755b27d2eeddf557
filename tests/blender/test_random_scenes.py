# SPDX-License-Identifier: GPL-3.0-or-later
"""The first of the random scenes; more with random_scenes.py itself."""

import shutil

import pytest
import random_scenes

pytestmark = pytest.mark.skipif(shutil.which(random_scenes.BLENDER) is None, reason="no Blender")


def test_random_scenes():
    said = []
    outcomes = random_scenes.run(0, 20, said.append)
    assert outcomes[random_scenes.FAILED] == 0, "\n".join(said)
    # A generator of errors alone would show little.
    assert outcomes[random_scenes.PICTURE] >= 5
