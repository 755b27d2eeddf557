# SPDX-License-Identifier: GPL-3.0-or-later
"""One measurement from an exported scene to its files, step by step or on a thread of its own."""

from __future__ import annotations

import threading
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..binding.errors import AmberlightError
from ..binding.library import Library
from ..export.scene_data import SceneData
from .bench import Options, Status
from .measurement import Measurement
from .output import write_all
from .scenes import open_scenes
from .sweep import Sweep


@dataclass(frozen=True)
class Request:
    """`params`: members of AmbRenderParams; `remarks`: what the export could not follow;
    `equal_error`, `equal_time`: 0 for what all estimators reach."""

    data: SceneData
    name: str
    params: dict[str, Any]
    options: Options
    folder: Path
    remarks: tuple[str, ...] = ()
    equal_error: float = 0.0
    equal_time: float = 0.0


@dataclass(frozen=True)
class Outcome:
    """The files, and `said`: a sentence where one of them could not be made."""

    measurement: Measurement
    files: list[Path]
    said: str


def measure(library: Library, request: Request) -> Generator[Status, None, Outcome]:
    """Yields until all is written; closing the generator cancels and frees everything."""
    with open_scenes(library, request.data) as scenes:
        with Sweep(scenes, request.name, request.params, request.options) as sweep:
            yield from sweep.run()
            measurement = sweep.measurement
            assert measurement is not None
            measurement.notes += request.remarks
            measurement.wanted_error = request.equal_error
            measurement.wanted_time = request.equal_time
            yield Status(1.0, "writing", len(measurement.rows))
            files, said = write_all(measurement, request.folder)
    return Outcome(measurement, files, said)


class Worker(threading.Thread):
    """Measures beside a user interface, which asks for `status` and later for the result; nothing
    of Blender is touched here."""

    def __init__(self, library: Library, request: Request) -> None:
        super().__init__(name="amberlight cost", daemon=True)
        self.library = library
        self.request = request
        self.status = Status(0.0, "starting", 0)
        self.outcome: Outcome | None = None
        self.error: Exception | None = None
        self._is_cancelled = threading.Event()

    def run(self) -> None:
        steps = measure(self.library, self.request)
        try:
            while not self._is_cancelled.is_set():
                try:
                    self.status = next(steps)
                except StopIteration as end:
                    self.outcome = end.value
                    return
        except Exception as error:
            self.error = error
        finally:
            steps.close()

    def cancel(self) -> None:
        """Asks to stop; the thread ends within 0.3 s, unless it draws."""
        self._is_cancelled.set()

    @property
    def message(self) -> str:
        """The error in words."""
        error = self.error
        if isinstance(error, AmberlightError):
            return error.message
        return f"internal error: {type(error).__name__}: {error}"
