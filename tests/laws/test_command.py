# SPDX-License-Identifier: GPL-3.0-or-later
"""./amberlight does what its help and README.md say."""

import csv
import json
import subprocess
import zipfile
from pathlib import Path

import pytest
from sources import ROOT

TINY = ["samples=1", "light_samples=2000", "scene.render.resolution_percentage=6"]


def amberlight(*arguments: str, cwd: Path = ROOT) -> subprocess.CompletedProcess:
    command = [str(ROOT / "amberlight"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd)


def complaint(result: subprocess.CompletedProcess) -> str:
    """The last line of a command that had to fail."""
    assert result.returncode == 1, result.stdout + result.stderr
    return result.stderr.strip().splitlines()[-1]


def test_help_names_every_action() -> None:
    said = amberlight("help").stdout
    for action in ("render", "cost", "blender", "build", "test", "lint", "package"):
        assert f"\n  {action} " in said


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["frobnicate"], "no such action: frobnicate"),
        (["render"], "which .blend?"),
        (["render", "no.blend"], "no file no.blend"),
        (["render", "a.blend", "b.blend"], "one .blend at a time"),
        (["render", "-x"], "unknown option -x"),
        (["render", "-o"], "-o needs a directory"),
        (["cost"], "cost: which .blend?"),
        (["cost", "-x"], "cost: unknown option -x"),
    ],
)
def test_wrong_use_is_one_sentence(arguments: list[str], expected: str) -> None:
    assert expected in complaint(amberlight(*arguments))


def test_render_writes_picture_passes_and_report(tmp_path: Path) -> None:
    scene = str(ROOT / "scenes_blend" / "sphere.blend")
    result = amberlight("render", scene, "-o", "pictures", *TINY, cwd=tmp_path)
    assert result.returncode == 0, result.stdout + result.stderr
    folder = tmp_path / "pictures"
    assert sorted(path.name for path in folder.iterdir()) == [
        "sphere.exr",
        "sphere.json",
        "sphere.png",
    ]
    assert (folder / "sphere.exr").read_bytes()[:4] == b"\x76\x2f\x31\x01"
    assert (folder / "sphere.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    report = json.loads((folder / "sphere.json").read_text())
    assert (report["width"], report["height"], report["samples"]) == (30, 30, 1)
    for said in ("simulated", "skipped", "memory", "wrote pictures/sphere.png"):
        assert said in result.stdout


def test_cost_writes_tables_figure_and_images(tmp_path: Path) -> None:
    scene = str(ROOT / "scenes_blend" / "sphere.blend")
    quick = ["size=16", "samples=1", "time_limit=25", "repeats=1"]
    result = amberlight("cost", scene, "-o", "cost", *quick, cwd=tmp_path)
    assert result.returncode == 0, result.stdout + result.stderr
    folder = tmp_path / "cost"
    names = ["csv", "md", "png", *("reference", "points_fixed", "points_covariance", "tubes")]
    files = [folder / (f"cost.{n}" if len(n) < 4 else f"cost_{n}.exr") for n in names]
    # SPECULAR may take longer than its share of the time.
    assert {*folder.iterdir()} - {folder / "cost_specular.exr"} == {*files}
    assert (folder / "cost.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    with (folder / "cost.csv").open() as file:
        rows = list(csv.DictReader(file))
    for estimator in ("POINTS_FIXED", "POINTS_COVARIANCE", "TUBES"):
        found = [row for row in rows if row["estimator"] == estimator and row["role"] == "row"]
        assert found and all(0 < float(row["rel_rmse"]) < 1 for row in found)
        assert all(float(row["total_cpu_s"]) > 0 for row in found)
    assert (folder / "cost.md").read_text() in result.stdout
    assert "wrote cost/cost.png" in result.stdout


@pytest.mark.parametrize(
    ("setting", "expected"),
    [
        ("light_samples=4", "light_samples: the sweep sets it; there are equal_error, "),
        ("size=-1", "size=-1: not between 0 and "),
        ("reference=no.npy", "the reference cannot be read"),
        ("sampels=4", "unknown setting sampels"),
    ],
)
def test_wrong_setting_of_cost_is_one_sentence(tmp_path: Path, setting: str, expected: str) -> None:
    scene = str(ROOT / "scenes_blend" / "slab.blend")
    result = amberlight("cost", scene, "-o", str(tmp_path / "out"), setting)
    assert expected in complaint(result)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("setting", "expected"),
    [
        ("sampels=4", "unknown setting sampels: there are accuracy, "),
        ("samples=four", "samples=four: not a whole number"),
        ("samples=0", "samples=0: not between 1 and "),
        ("use_background=perhaps", "use_background=perhaps: neither true nor false"),
        ("estimator=LUCK", 'enum "LUCK" not found'),
        ("scene.render.resolution=4", "do you mean resolution_"),
    ],
)
def test_wrong_setting_is_one_sentence(tmp_path: Path, setting: str, expected: str) -> None:
    scene = str(ROOT / "scenes_blend" / "slab.blend")
    result = amberlight("render", scene, "-o", str(tmp_path / "out"), setting)
    assert expected in complaint(result)
    assert not (tmp_path / "out").exists()


def test_package_holds_the_add_on() -> None:
    result = amberlight("package")
    assert result.returncode == 0, result.stderr
    archive = ROOT / result.stdout.split()[-1]
    first = archive.read_bytes()
    names = zipfile.ZipFile(archive).namelist()
    for name in ("__init__.py", "blender_manifest.toml", "LICENSE", "lib/libamberlight.so"):
        assert f"amberlight/{name}" in names
    assert not [name for name in names if "__pycache__" in name]
    amberlight("package")
    assert archive.read_bytes() == first, "the same sources make the same archive"
