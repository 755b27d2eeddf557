# SPDX-License-Identifier: GPL-3.0-or-later
"""Finding and checking the library: every failure is one sentence that says what to do."""

import os

import pytest
from amberlight.binding import library
from amberlight.binding.errors import AmberlightError, AmbLibraryError


def message_of(monkeypatch, path):
    monkeypatch.setenv("AMBERLIGHT_LIBRARY", str(path))
    with pytest.raises(AmbLibraryError) as caught:
        library.load()
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_default_is_inside_the_add_on(monkeypatch):
    monkeypatch.delenv("AMBERLIGHT_LIBRARY", raising=False)
    assert library.library_path().parts[-3:] == ("amberlight", "lib", "libamberlight.so")


def test_missing(monkeypatch, tmp_path):
    text = message_of(monkeypatch, tmp_path / "nowhere.so")
    assert "nowhere.so is missing" in text and "build it" in text


def test_not_a_library(monkeypatch, tmp_path):
    path = tmp_path / "libamberlight.so"
    path.write_text("not a library")
    assert "cannot be loaded" in message_of(monkeypatch, path)


def test_another_library(monkeypatch, tmp_path):
    path = next(p for p in map(str, library_candidates()) if os.path.exists(p))
    assert "is not an Amberlight library" in message_of(monkeypatch, path)


def library_candidates():
    import ctypes.util

    name = ctypes.util.find_library("m")
    return [
        f"/lib/x86_64-linux-gnu/{name}",
        f"/usr/lib/x86_64-linux-gnu/{name}",
        f"/usr/lib/{name}",
    ]


@pytest.mark.parametrize(("abi", "word"), [(0, "older"), (99, "newer")])
def test_other_version(monkeypatch, build_fake, abi, word):
    text = message_of(monkeypatch, build_fake(FAKE_ABI_VERSION=abi))
    assert f"is {word} than this add-on" in text and "install both" in text


def test_other_struct(monkeypatch, build_fake):
    text = message_of(monkeypatch, build_fake(FAKE_STRUCT_SIZE=8))
    assert "another amberlight.h" in text and "AmbLight has 8 bytes" in text


def test_missing_function(monkeypatch, build_fake):
    text = message_of(monkeypatch, build_fake(FAKE_LACKS_SELF_TEST=1))
    assert "lacks amb_self_test" in text and "same Amberlight version" in text


def test_self_test(monkeypatch, build_fake):
    text = message_of(monkeypatch, build_fake(FAKE_SELF_TEST_FAILS=1))
    assert "fails its self-test (Embree 3 was compiled in, Embree 4 answers)" in text


def test_failure_is_not_remembered(monkeypatch, tmp_path, fake_path):
    path = tmp_path / "libamberlight.so"
    message_of(monkeypatch, path)
    path.write_bytes(fake_path.read_bytes())
    assert library.load().version == "0.1.0"


def test_loaded_once_and_notices_replacement(monkeypatch, build_fake):
    path = build_fake()
    monkeypatch.setenv("AMBERLIGHT_LIBRARY", str(path))
    loaded = library.load()
    assert library.load() is loaded and not loaded.is_replaced
    other = path.with_suffix(".new")
    other.write_bytes(path.read_bytes())
    other.replace(path)
    assert library.load() is loaded and loaded.is_replaced


def test_flags(monkeypatch, fake_path):
    """DEEPBIND against the host's own Embree, unless a sanitizer forbids it."""
    modes = []
    real = library.ctypes.CDLL

    def spy(path, mode):
        modes.append(mode)
        return real(path, mode=mode)

    monkeypatch.setattr(library.ctypes, "CDLL", spy)
    monkeypatch.delenv("AMBERLIGHT_NO_DEEPBIND", raising=False)
    library._open(fake_path)
    monkeypatch.setenv("AMBERLIGHT_NO_DEEPBIND", "1")
    library._open(fake_path)
    base = os.RTLD_NOW | os.RTLD_LOCAL
    assert modes == [base | os.RTLD_DEEPBIND, base]


def test_without_numpy(monkeypatch):
    import sys

    from amberlight.binding.handles import import_numpy

    monkeypatch.setitem(sys.modules, "numpy", None)
    with pytest.raises(AmberlightError, match="install python3-numpy"):
        import_numpy()
