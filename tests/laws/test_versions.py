# SPDX-License-Identifier: GPL-3.0-or-later
"""One version number, written where each tool looks for it."""

import ast
import re

import pytest
from sources import ROOT


def find(path: str, pattern: str) -> str:
    match = re.search(pattern, (ROOT / path).read_text(), re.MULTILINE)
    assert match, f"no version in {path}"
    return match[1]


HEADER = find("native/include/amberlight/amberlight.h", r'^#define AMB_VERSION_STRING "([^"]+)"')


def test_cmake() -> None:
    assert find("CMakeLists.txt", r"^project\(amberlight VERSION ([\d.]+)") == HEADER


def test_add_on() -> None:
    path = ROOT / "addon" / "amberlight" / "__init__.py"
    if not path.is_file():
        pytest.skip("no add-on")
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Assign) and node.targets[0].id == "bl_info":
            info = ast.literal_eval(node.value)
            assert ".".join(map(str, info["version"])) == HEADER
            return
    pytest.fail("no bl_info")


def test_manifest() -> None:
    path = ROOT / "addon" / "amberlight" / "blender_manifest.toml"
    if not path.is_file():
        pytest.skip("no manifest")
    assert find("addon/amberlight/blender_manifest.toml", r'^version = "([^"]+)"') == HEADER


@pytest.mark.parametrize("name", ["AMB_ABI_VERSION", "AMB_VERSION_STRING"])
def test_binding_mirrors_the_header(name: str) -> None:
    pattern = rf'^(?:#define )?{name}(?: =)? "?([\d.]+)"?$'
    header = find("native/include/amberlight/amberlight.h", pattern)
    assert find("addon/amberlight/binding/_ffi.py", pattern) == header
