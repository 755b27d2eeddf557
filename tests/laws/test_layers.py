# SPDX-License-Identifier: GPL-3.0-or-later
"""Who may include whom: the floors of the C library and of the add-on."""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from sources import ROOT, files, name

# Each floor may include itself and what stands before it.
FLOORS = "base math optics scene light field camera plan render api".split()
# film stands on math, beside scene; only those who own a film use it.
FILM_MAY_INCLUDE = {"base", "math", "film"}
MAY_INCLUDE_FILM = {"film", "render", "api"}
# A library behind one file: replacing it is the work of one file.
ONLY_HERE = {
    "embree3/": "scene/intersect_embree.c",
    "embree4/": "scene/intersect_embree.c",
    "openexr": "film/film_exr.c",
    "OpenEXR/": "film/film_exr.c",
}
PUBLIC_HEADER = "amberlight/amberlight.h"

SRC = ROOT / "native" / "src"
SOURCES = files(".c", ".h", under="native/src")


Include = tuple[str, str]  # '"' or '<', and what is included


def includes(path: Path) -> list[Include]:
    return re.findall(r'^\s*#\s*include\s*([<"])([^>"]+)[>"]', path.read_text(), re.MULTILINE)


def our_includes() -> Iterator[tuple[Path, str]]:
    """Every pair of a file of native/src and the header of ours that it includes."""
    for path in SOURCES:
        for quote, target in includes(path):
            if quote == '"' and target != PUBLIC_HEADER:
                yield path, target


def floor(path: Path) -> str:
    return path.relative_to(SRC).parts[0]


def allowed(floor: str) -> set[str]:
    if floor == "film":
        return FILM_MAY_INCLUDE
    below = set(FLOORS[: FLOORS.index(floor) + 1])
    return below | ({"film"} if floor in MAY_INCLUDE_FILM else set())


def test_every_source_stands_on_a_floor() -> None:
    assert SOURCES
    assert not [name(path) for path in SOURCES if floor(path) not in {*FLOORS, "film"}]


def test_headers_are_included_by_their_path_below_src() -> None:
    assert not [
        f"{name(path)}: {target}" for path, target in our_includes() if not (SRC / target).is_file()
    ]


def test_includes_go_down() -> None:
    assert not [
        f"{name(path)}: {target}"
        for path, target in our_includes()
        if Path(target).parts[0] not in allowed(floor(path))
    ]


def test_a_library_is_used_in_one_file() -> None:
    assert not [
        f"{name(path)}: {target}"
        for path in SOURCES
        for _, target in includes(path)
        for prefix, home in ONLY_HERE.items()
        if target.startswith(prefix) and path != SRC / home
    ]


def test_own_header_comes_first() -> None:
    """Proves that the header stands alone."""
    assert not [
        name(path)
        for path in SOURCES
        if path.suffix == ".c" and path.with_suffix(".h").is_file()
        if includes(path)[0] != ('"', str(path.with_suffix(".h").relative_to(SRC)))
    ]


def test_public_header_stands_alone() -> None:
    header = ROOT / "native" / "include" / PUBLIC_HEADER
    assert includes(header) == [("<", "stdint.h")]


def imports(path: Path) -> set[str]:
    """Top-level modules that a Python file imports, relative imports left out."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found.add(node.module.split(".")[0])
    return found


BLENDER_MODULES = {"bpy", "bgl", "gpu", "gpu_extras", "mathutils", "bpy_extras", "bl_ui", "blf"}


def test_binding_knows_no_blender() -> None:
    binding = files(".py", under="addon/amberlight/binding")
    assert not [name(path) for path in binding if imports(path) & BLENDER_MODULES]


def test_addon_needs_only_blender_and_numpy() -> None:
    """Nothing to install with pip: Blender's Python differs with every release."""
    known = BLENDER_MODULES | {"numpy", "addon_utils", "nodeitems_utils"} | sys.stdlib_module_names
    assert [
        f"{name(path)}: {module}"
        for path in files(".py", under="addon/amberlight")
        for module in sorted(imports(path) - known)
        # The figure of the cost report, which is left out where there is no matplotlib.
    ] == ["addon/amberlight/cost/plots.py: matplotlib"]
