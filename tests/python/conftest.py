# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on without Blender, over a stand-in for the library."""

import ctypes
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
INCLUDE = ROOT / "native" / "include"
HEADER = INCLUDE / "amberlight" / "amberlight.h"
sys.path.insert(0, str(ROOT / "addon"))


@pytest.fixture(scope="session")
def build_fake(tmp_path_factory):
    """Compiles the stand-in: build_fake(FAKE_ABI_VERSION=0) -> its path. Every call makes another
    file: a process keeps what it has loaded."""

    def build(**definitions):
        path = tmp_path_factory.mktemp("fake") / "libamberlight.so"
        flags = [f"-D{name}={value}" for name, value in definitions.items()]
        source = Path(__file__).with_name("fake_library.c")
        command = ["gcc", "-std=c11", "-D_GNU_SOURCE", "-fPIC", "-shared", f"-I{INCLUDE}", *flags]
        subprocess.run([*command, str(source), "-o", str(path)], check=True)
        return path

    return build


@pytest.fixture(scope="session")
def fake_path(build_fake):
    return build_fake()


@pytest.fixture
def fake(monkeypatch, fake_path):
    """The stand-in as a loaded Library; nothing may be alive in it at the end."""
    from amberlight.binding import library

    monkeypatch.setenv("AMBERLIGHT_LIBRARY", str(fake_path))
    loaded = library.load()
    yield loaded
    assert alive(loaded) == (0, 0)


def alive(loaded):
    """(scenes, renders) that exist in the stand-in."""
    dll = ctypes.CDLL(str(loaded.path))
    return dll.fake_scenes_alive(), dll.fake_renders_alive()
