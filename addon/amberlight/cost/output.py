# SPDX-License-Identifier: GPL-3.0-or-later
"""The files of a measurement: numbers, pictures, a figure."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..binding.errors import AmberlightError
from . import curve, exr, plots, tables
from .bench import PASS
from .measurement import Measurement
from .plots import DIFFERENCE_FACTOR
from .rows import Row

NAMES = ("cost.csv", "cost.md", "cost.png")


def shown_rows(measurement: Measurement) -> dict[str, Row]:
    """For each estimator the row nearest to equal time."""
    target = measurement.target_time
    if target is None:
        return {}
    return {
        name: curve.nearest(front, target) for name, front in measurement.fronts.items() if front
    }


def write_all(measurement: Measurement, folder: Path) -> tuple[list[Path], str]:
    """Writes everything; the files, and a sentence where the figure could not be drawn."""
    said = ""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        files = [folder / name for name in NAMES[:2]]
        files[0].write_text(tables.csv_text(measurement), encoding="utf-8")
        files[1].write_text(tables.markdown_text(measurement), encoding="utf-8")
        files += _write_images(measurement, folder)
        figure = folder / NAMES[2]
        try:
            plots.draw(measurement, shown_rows(measurement), figure)
            files.append(figure)
        except ImportError:
            said = (
                "no picture: Blender's Python has no matplotlib, install python3-matplotlib or "
                "use a Blender that runs on the system's Python"
            )
            figure.unlink(missing_ok=True)
    except OSError as error:
        raise AmberlightError(f"the measurement is complete but not written: {error}") from error
    return files, said


def _write_images(measurement: Measurement, folder: Path) -> list[Path]:
    """The reference, and for each estimator its image and the difference that is shown."""
    truth = measurement.reference.image
    files = [folder / "cost_reference.exr"]
    exr.write(files[0], {PASS: truth})
    for name, row in shown_rows(measurement).items():
        image = measurement.image(row.setting)
        difference = DIFFERENCE_FACTOR * np.abs(image - truth)
        files.append(folder / f"cost_{name.lower()}.exr")
        exr.write(files[-1], {PASS: image, f"Difference x{DIFFERENCE_FACTOR:g}": difference})
    return files
