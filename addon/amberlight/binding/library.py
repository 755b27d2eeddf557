# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds, loads and checks the shared library. Every failure is one sentence that says what to do.

AMBERLIGHT_LIBRARY names another file than the add-on's own; AMBERLIGHT_NO_DEEPBIND loads it
without RTLD_DEEPBIND, which the address sanitizer does not survive.
"""

from __future__ import annotations

import ctypes
import os
import threading
from pathlib import Path
from typing import Any

from . import _ffi
from .errors import AmberlightError, AmbLibraryError, make_errcheck

FILE_NAME = "libamberlight.so"

_lock = threading.Lock()
_loaded: dict[Path, Library] = {}


class Library:
    """The loaded library: its functions as attributes, typed and checked."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.stamp = _stamp(path)
        self._dll = _open(path)
        _check_version(self._dll, path)
        self._bind()
        _check_structs(self._dll, path)
        try:
            self._dll.amb_self_test()
        except AmberlightError as error:
            raise AmbLibraryError(
                f"the library {path} fails its self-test ({error.message}): reinstall Amberlight "
                "built for this Blender"
            ) from error

    def __getattr__(self, name: str) -> Any:
        if name.startswith("amb_"):
            return getattr(self._dll, name)
        raise AttributeError(name)

    @property
    def version(self) -> str:
        return str(self._dll.amb_version_string().decode())

    @property
    def is_replaced(self) -> bool:
        """True if the file was exchanged since it was loaded: Blender needs a restart."""
        return _stamp(self.path) != self.stamp

    def _bind(self) -> None:
        check = make_errcheck(self._dll.amb_last_error)
        for name, (restype, argtypes) in _ffi.FUNCTIONS.items():
            try:
                function = getattr(self._dll, name)
            except AttributeError:
                raise AmbLibraryError(
                    f"the library {self.path} lacks {name}: install the library and the add-on "
                    f"of the same Amberlight version ({_ffi.AMB_VERSION_STRING})"
                ) from None
            function.restype = restype
            function.argtypes = argtypes
            if restype is _ffi.AmbStatus:
                function.errcheck = check


def library_path() -> Path:
    """AMBERLIGHT_LIBRARY if set, else the file inside the add-on."""
    override = os.environ.get("AMBERLIGHT_LIBRARY")
    if override:
        return Path(override).resolve()
    return Path(__file__).resolve().parent.parent / "lib" / FILE_NAME


def load() -> Library:
    """The library, loaded and checked once per file; raises AmbLibraryError."""
    path = library_path()
    with _lock:
        library = _loaded.get(path)
        if library is None:
            # Kept for the life of the process: a library with running threads and live objects
            # must never be unmapped.
            library = _loaded[path] = Library(path)
        return library


def _stamp(path: Path) -> tuple[int, int, int]:
    try:
        info = path.stat()
    except OSError:
        return (0, 0, 0)
    return (info.st_ino, info.st_size, info.st_mtime_ns)


def _open(path: Path) -> ctypes.CDLL:
    if not path.is_file():
        raise AmbLibraryError(
            f"the library {path} is missing: build it with ./amberlight (see the README) or set "
            "AMBERLIGHT_LIBRARY to its file"
        )
    mode = os.RTLD_NOW | os.RTLD_LOCAL
    if not os.environ.get("AMBERLIGHT_NO_DEEPBIND"):
        # Blender carries its own Embree in the global scope, which is searched before a local
        # library's own dependencies; DEEPBIND (glibc only) turns that order round.
        mode |= getattr(os, "RTLD_DEEPBIND", 0)
    try:
        return ctypes.CDLL(str(path), mode=mode)
    except OSError as error:
        raise AmbLibraryError(
            f"the library cannot be loaded ({error}): install what it needs (see the README) or "
            "build it again on this machine"
        ) from error


def _check_version(dll: ctypes.CDLL, path: Path) -> None:
    try:
        dll.amb_abi_version.restype = ctypes.c_uint32
        dll.amb_version_string.restype = ctypes.c_char_p
        abi = int(dll.amb_abi_version())
        version = (dll.amb_version_string() or b"?").decode("utf-8", "replace")
    except AttributeError:
        raise AmbLibraryError(
            f"the file {path} is not an Amberlight library: set AMBERLIGHT_LIBRARY to the right "
            "file or unset it"
        ) from None
    if abi != _ffi.AMB_ABI_VERSION:
        age = "older" if abi < _ffi.AMB_ABI_VERSION else "newer"
        raise AmbLibraryError(
            f"the library {path} is {age} than this add-on (its interface is {abi} of version "
            f"{version}, the add-on needs {_ffi.AMB_ABI_VERSION} of {_ffi.AMB_VERSION_STRING}): "
            "install both from the same Amberlight version and restart Blender"
        )


def _check_structs(dll: ctypes.CDLL, path: Path) -> None:
    for struct_id, struct in _ffi.STRUCT_IDS.items():
        size = int(dll.amb_struct_size(struct_id))
        if size != ctypes.sizeof(struct):
            raise AmbLibraryError(
                f"the library {path} was built from another amberlight.h than this add-on "
                f"({struct.__name__} has {size} bytes there and {ctypes.sizeof(struct)} here): "
                "install both from the same Amberlight version and restart Blender"
            )
