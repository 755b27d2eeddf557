# SPDX-License-Identifier: GPL-3.0-or-later
"""The library shows the world the functions of its header and nothing else.

Blender has Embree, TBB and OpenEXR in the same process: a symbol that leaks can replace theirs.
"""

import re
import shutil
import subprocess

import pytest
from sources import ROOT

LIBRARY = ROOT / "build" / "release" / "lib" / "libamberlight.so"
HEADER = ROOT / "native" / "include" / "amberlight" / "amberlight.h"


@pytest.fixture(scope="module")
def exported() -> set[str]:
    if not LIBRARY.is_file():
        pytest.skip("not built: ./amberlight build")
    if shutil.which("nm") is None:
        pytest.skip("no nm")
    command = ["nm", "-D", "--defined-only", "--format=just-symbols", str(LIBRARY)]
    out = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return set(out.split())


def declared() -> set[str]:
    """Functions that the header marks with AMB_API."""
    text = re.sub(r"/\*.*?\*/", "", HEADER.read_text(), flags=re.DOTALL)
    return set(re.findall(r"^AMB_API [^(;]*?\b(\w+)\(", text, re.MULTILINE))


def test_only_our_prefix(exported: set[str]) -> None:
    assert exported
    assert not {symbol for symbol in exported if not symbol.startswith("amb_")}


def test_exactly_the_header(exported: set[str]) -> None:
    assert exported == declared()
