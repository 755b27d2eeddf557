# SPDX-License-Identifier: GPL-3.0-or-later
"""Exceptions of the library, one class per status."""

from __future__ import annotations

from collections.abc import Callable
from ctypes import byref
from typing import Any

from . import _ffi


class AmberlightError(Exception):
    """A failed call: `status` (AMB_*), `function` (public C name), `message` (one sentence)."""

    def __init__(self, message: str, status: int = _ffi.AMB_INTERNAL, function: str = "") -> None:
        super().__init__(message)
        self.status = status
        self.function = function
        self.message = message

    def __str__(self) -> str:
        return f"{self.function}: {self.message}" if self.function else self.message


class AmbLibraryError(AmberlightError):
    """The shared library is missing, of another version, or fails its self-test."""


class AmbArgumentError(AmberlightError, ValueError):
    pass


class AmbStateError(AmberlightError, RuntimeError):
    pass


class AmbMemoryError(AmberlightError, MemoryError):
    pass


class AmbUnsupported(AmberlightError, NotImplementedError):
    pass


class AmbIOError(AmberlightError, OSError):
    pass


class AmbCancelled(AmberlightError):
    """The render was cancelled: not an error to the user."""


CLASSES: dict[int, type[AmberlightError]] = {
    _ffi.AMB_INVALID_ARGUMENT: AmbArgumentError,
    _ffi.AMB_INVALID_STATE: AmbStateError,
    _ffi.AMB_OUT_OF_MEMORY: AmbMemoryError,
    _ffi.AMB_UNSUPPORTED: AmbUnsupported,
    _ffi.AMB_IO: AmbIOError,
    _ffi.AMB_CANCELLED: AmbCancelled,
    _ffi.AMB_INTERNAL: AmberlightError,
}


def make_errcheck(last_error: Callable[[Any], None]) -> Callable[..., None]:
    """The errcheck of every function that returns an AmbStatus; `last_error` is amb_last_error.

    The record belongs to the calling thread, so it must be read at once, here.
    """

    def check(status: _ffi.AmbStatus, function: Any, args: tuple[Any, ...]) -> None:
        if status.value == _ffi.AMB_OK:
            return
        info = _ffi.AmbErrorInfo()
        last_error(byref(info))
        message = info.message.decode("utf-8", "replace") or f"failed with status {status.value}"
        raise CLASSES.get(status.value, AmberlightError)(
            message, status.value, info.function.decode("utf-8", "replace")
        )

    return check
