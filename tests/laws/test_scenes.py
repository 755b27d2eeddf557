# SPDX-License-Identifier: GPL-3.0-or-later
"""Every .blend of scenes_blend/ is what its script builds."""

import json
import os
import subprocess
from pathlib import Path

import pytest
from sources import ROOT

SCENES = ROOT / "scenes_blend"
NAMES = ["bumpy_sphere", "caustics", "oil", "slab", "sphere", "still_life", "suzanne"]
GIVEN_MESH = ["buddha", "bunny"]  # built around a mesh that is not in this repository

# A closed octahedron, y up, with one of its triangles given twice.
OCTAHEDRON = """v 1 0 0\nv -1 0 0\nv 0 2 0\nv 0 -2 0\nv 0 0 1\nv 0 0 -1
f 1 3 5\nf 3 2 5\nf 2 4 5\nf 4 1 5\nf 3 1 6\nf 2 3 6\nf 4 2 6\nf 1 4 6\nf 6 1 4
"""

# The paper's BmpS resin, per unit of the scene.
SIGMA_S = [0.21007479, 0.20985741, 0.21021159]
SIGMA_A = [0.0098988121, 0.10012399, 0.24977001]


def blender(*arguments: str) -> None:
    command = [str(ROOT / "amberlight"), "blender", "-b", "--factory-startup"]
    command += ["--python-exit-code", "1", *arguments]
    result = subprocess.run(command, capture_output=True, text=True, env=dict(os.environ))
    assert result.returncode == 0, result.stdout + result.stderr


def describe(folder: Path, blends: list[str]) -> dict[str, dict]:
    script = Path(__file__).with_name("describe_scenes.py")
    blender("--python", str(script), "--", str(folder / "scenes.json"), *blends)
    return json.loads((folder / "scenes.json").read_text())


@pytest.fixture(scope="module")
def described(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[dict, dict]]:
    """name -> (what the script builds, what the repository has)."""
    folder = tmp_path_factory.mktemp("scenes")
    for name in NAMES:
        script = SCENES / f"build_{name}.py"
        blender("--python", str(script), "--", str(folder / f"{name}.blend"))
    built = [str(folder / f"{name}.blend") for name in NAMES]
    kept = [str(SCENES / f"{name}.blend") for name in NAMES]
    scenes = describe(folder, [*built, *kept])
    pairs = zip(built, kept, strict=True)
    return {name: (scenes[b], scenes[k]) for name, (b, k) in zip(NAMES, pairs, strict=True)}


@pytest.mark.parametrize("name", NAMES)
def test_file_is_what_the_script_builds(described: dict, name: str) -> None:
    built, kept = described[name]
    assert kept == built


@pytest.mark.parametrize("name", NAMES)
def test_file_stands_alone(described: dict, name: str) -> None:
    _, kept = described[name]
    assert kept["engine"] == "AMBERLIGHT"
    assert kept["external"] == []


@pytest.mark.parametrize("name", ["bumpy_sphere", "slab", "sphere"])
def test_resin_is_the_papers(described: dict, name: str) -> None:
    nodes = described[name][1]["materials"]["Bumpy resin"]
    color = nodes["ShaderNodeVolumeScatter/Color"][:3]
    density = nodes["ShaderNodeVolumeScatter/Density"]
    assert [density * c for c in color] == pytest.approx(SIGMA_S, abs=1e-5)
    color = nodes["ShaderNodeVolumeAbsorption/Color"][:3]
    density = nodes["ShaderNodeVolumeAbsorption/Density"]
    assert [density * (1 - c) for c in color] == pytest.approx(SIGMA_A, abs=1e-5)
    assert nodes["ShaderNodeVolumeScatter/Anisotropy"] == pytest.approx(0.9)
    assert nodes["ShaderNodeBsdfGlass/IOR"] == pytest.approx(1.5)


@pytest.mark.parametrize("name", ["bumpy_sphere", "sphere"])
def test_spheres_have_twenty_thousand_triangles(described: dict, name: str) -> None:
    about = described[name][1]["objects"][name.replace("_", " ").capitalize()]
    assert (about["vertices"], about["polygons"]) == (10242, 20480)
    assert about["smooth"]


@pytest.mark.parametrize("name", NAMES)
def test_translucent_meshes_are_closed_and_face_outward(described: dict, name: str) -> None:
    about = described[name][1]
    for item, values in about["objects"].items():
        nodes = [about["materials"][m] for m in values.get("materials", [])]
        if any("ShaderNodeBsdfGlass/IOR" in values for values in nodes):
            assert values["open_edges"] == 0, item
            assert values["volume"] > 0, item


@pytest.mark.parametrize("name", GIVEN_MESH)
def test_script_takes_a_mesh(tmp_path: Path, name: str) -> None:
    mesh, blend = tmp_path / "octahedron.obj", tmp_path / f"{name}.blend"
    mesh.write_text(OCTAHEDRON)
    blender("--python", str(SCENES / f"build_{name}.py"), "--", str(mesh), str(blend))
    about = describe(tmp_path, [str(blend)])[str(blend)]
    body = about["objects"][name.capitalize()]
    assert (body["vertices"], body["polygons"], body["open_edges"]) == (6, 8, 0)
    assert body["box"] == [[-1, -1, -2], [1, 1, 2]]  # z up
    assert about["settings"]["use_transmitted_light"] is False


@pytest.mark.parametrize("name", GIVEN_MESH)
def test_script_wants_its_mesh(name: str) -> None:
    with pytest.raises(AssertionError, match="OUT.blend"):
        blender("--python", str(SCENES / f"build_{name}.py"))


def test_every_scene_has_its_script() -> None:
    assert sorted(path.stem for path in SCENES.glob("*.blend")) == NAMES
    scripts = sorted(path.stem[6:] for path in SCENES.glob("build_*.py"))
    assert scripts == sorted(NAMES + GIVEN_MESH)
