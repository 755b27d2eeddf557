# SPDX-License-Identifier: GPL-3.0-or-later
"""Reference images that were made elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..binding.errors import AmberlightError
from . import exr

# Of an OpenEXR file with several passes, the one that estimators differ in; else the whole.
PASSES = ("Single Scattering", "Combined")


@dataclass(frozen=True)
class ImageReference:
    """One image, or two of independent noise: (height, width, 3), row 0 at the bottom."""

    name: str
    images: tuple[NDArray[Any], ...]

    @property
    def size(self) -> tuple[int, int]:
        height, width = self.images[0].shape[:2]
        return width, height


def load_reference(path: Path) -> ImageReference:
    """An .npy array (height, width, 3), row 0 at the top; an .exr; or a reference case: its
    folder or case.json, with analytic_*.npy or ref_*_A.npy and ref_*_B.npy beside it."""
    try:
        if path.is_dir() or path.name == "case.json":
            return _load_case(path if path.is_dir() else path.parent)
        if path.suffix == ".npy":
            return _checked(ImageReference(path.name, (_load_array(path),)))
        if path.suffix == ".exr":
            return _checked(ImageReference(path.name, (exr.read_rgb(path, PASSES),)))
    except (OSError, ValueError) as error:
        raise AmberlightError(f"the reference cannot be read: {error}") from error
    raise AmberlightError(
        f"the reference {path} is not an .npy array, an .exr image or the case.json of a case"
    )


def _load_case(folder: Path) -> ImageReference:
    files = sorted(folder.glob("analytic_*.npy"))[:1]
    if not files:
        files = sorted(folder.glob("ref_*_A.npy"))[:1] + sorted(folder.glob("ref_*_B.npy"))[:1]
    if not files:
        raise AmberlightError(f"the case {folder} has no analytic_*.npy and no ref_*_A.npy")
    name = f"case {folder.resolve().name}, {' and '.join(file.name for file in files)}"
    return _checked(ImageReference(name, tuple(_load_array(file) for file in files)))


def _load_array(path: Path) -> NDArray[Any]:
    pixels = np.load(path)
    return np.asarray(pixels[::-1], np.float32)


def _checked(reference: ImageReference) -> ImageReference:
    for pixels in reference.images:
        if pixels.ndim != 3 or pixels.shape[2] != 3 or not np.isfinite(pixels).all():
            raise AmberlightError(
                f"the reference {reference.name} is not an image of three finite channels: "
                f"its shape is {pixels.shape}"
            )
    if len({pixels.shape for pixels in reference.images}) > 1:
        raise AmberlightError(f"the images of {reference.name} differ in size")
    return reference
