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


def test_scenes_that_cannot_start_are_a_failure(monkeypatch):
    monkeypatch.setattr(random_scenes, "BLENDER", "true")
    with pytest.raises(RuntimeError, match="did not come to scene 7"):
        random_scenes.run(7, 2)
