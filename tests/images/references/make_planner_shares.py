#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes planner_shares.json beside this file: the shares of effects in the planner's scenes by
brute force. Takes a while; names of scenes as arguments measure those again.

    python3 tests/images/references/make_planner_shares.py [NAME ...]
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

from api import POINTS_COVARIANCE  # noqa: E402
from planner_scenes import SCENES  # noqa: E402
from planner_shares import shares  # noqa: E402

SIZE = 24
SETTINGS = {"samples": 16, "light_samples": 1 << 14, "estimator": POINTS_COVARIANCE}
# Where nothing scatters samples cost next to nothing.
CLEAR_SAMPLES = 256
FILE = HERE / "planner_shares.json"


def main() -> None:
    wanted = sys.argv[1:]
    known = json.loads(FILE.read_text()) if FILE.exists() else {}
    for scene in SCENES:
        if not wanted or scene.name in wanted:
            scatters = any(np.any(np.asarray(body.sigma_s) > 0) for body in scene.bodies)
            settings = SETTINGS if scatters else SETTINGS | {"samples": CLEAR_SAMPLES}
            known[scene.name] = shares(scene, SIZE, **settings)
            print(scene.name, known[scene.name], flush=True)
        FILE.write_text(json.dumps(known, indent=1) + "\n")


if __name__ == "__main__":
    main()
