# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes bumpy_32.npy: the bumpy case by ref_bumpy.py, converged; takes minutes.

(32, 32, 4) float32, row 0 = top: RGB radiance in W m^-2 sr^-1, and the part of each pixel that
the body covers. Run from anywhere: python3 tests/images/references/make_bumpy_32.py
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

from meshes import bumpy_sphere  # noqa: E402
from ref_bumpy import bumpy_scene, render  # noqa: E402

SIZE, SAMPLES, REFINEMENT = 32, 784, 1


def main() -> None:
    image, cover = render(bumpy_scene(bumpy_sphere(5)), SIZE, SAMPLES, REFINEMENT)
    np.save(HERE / "bumpy_32.npy", np.dstack([image, cover]).astype(np.float32))


if __name__ == "__main__":
    main()
