# SPDX-License-Identifier: GPL-3.0-or-later
"""What needs no Blender imports no Blender."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT

ADDON = ROOT / "addon" / "amberlight"
FILES = sorted(path.relative_to(ADDON) for path in ADDON.rglob("*.py"))
MAY_IMPORT_BPY = {"__init__", "engine", "properties", "ui", "operators", "preferences"}
# The cost report has files of its own for what it shows; all else of it is in cost/, without bpy.
MAY_IMPORT_BPY |= {"properties_cost", "operators_cost", "ui_cost"}
# Blender's own Cycles evaluates the nodes of worlds.
MAY_IMPORT_BPY |= {"operators_world", "world_bake"}


def imported(path):
    """Names of the modules that a file imports, relative ones with their dots."""
    for node in ast.walk(ast.parse((ADDON / path).read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield "." * node.level + (node.module or "")


@pytest.mark.parametrize("path", FILES, ids=str)
def test_bpy_only_where_allowed(path):
    allowed = path.stem in MAY_IMPORT_BPY and path.parent == Path(".")
    allowed = allowed or path.stem.startswith("extract")
    names = {name.split(".")[0] for name in imported(path)}
    assert allowed or not names & {"bpy", "mathutils", "bpy_extras"}


@pytest.mark.parametrize("path", FILES, ids=str)
def test_own_modules_are_imported_relatively(path):
    """As an extension the package has another name."""
    assert not [name for name in imported(path) if name.split(".")[0] == "amberlight"]


def test_nothing_prints():
    """One function speaks to users of a headless render; the rest logs."""
    prints = [
        str(path)
        for path in FILES
        for node in ast.walk(ast.parse((ADDON / path).read_text()))
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "print"
    ]
    assert prints == ["engine.py"]


def test_numpy_is_imported_late():
    """Without numpy Blender must start, and say what is missing only when a render needs it."""
    code = (
        "import sys; sys.modules['numpy'] = None\n"
        "import amberlight.render_job, amberlight.report, amberlight.export.extract_mesh\n"
        "import amberlight.cost\n"
        "import amberlight.export.node_tree, amberlight.export.extract_material\n"
    )
    command = [sys.executable, "-c", code]
    subprocess.run(command, check=True, cwd=ADDON.parent)
