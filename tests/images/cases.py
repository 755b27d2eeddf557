# SPDX-License-Identifier: GPL-3.0-or-later
"""The shared reference cases: their files, and their scenes through the public C API.

The folder is AMBERLIGHT_CASES, else ../shared/cases beside the checkout; tests that need it are
skipped where it is absent.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from api import ROOT, Medium, add_body, add_point, handles, set_perspective
from meshes import Mesh, read_obj
from numpy.typing import NDArray

FOLDER = Path(os.environ.get("AMBERLIGHT_CASES", ROOT.parent / "shared/cases"))


def case_folder(name: str) -> Path:
    """The folder of a case; skips the test that asks where there is none."""
    folder = FOLDER / name
    if not (folder / "case.json").is_file():
        pytest.skip(f"no reference case {folder}")
    return folder


@dataclass(frozen=True)
class Case:
    """A case as case.json describes it; images are (128, 128, 3), row 0 = top."""

    name: str
    folder: Path
    data: dict[str, Any]
    mesh: Mesh

    def build(self, scene: handles.Scene) -> None:
        """Body, point light and pinhole camera; y is up."""
        boundary, medium = self.data["boundary"], self.data["medium"]
        ior = boundary["ior_inside"] / boundary["ior_outside"]
        add_body(scene, self.mesh, Medium(ior, medium["sigma_s"], medium["sigma_a"], medium["g"]))
        light = self.data["light"]
        add_point(scene, light["position"], light["intensity_W_per_sr"])
        camera = self.data["camera"]
        fov = np.radians(camera["fov_deg"])
        set_perspective(scene, camera["eye"], camera["forward"], camera["up_vec"], fov)

    def reference(self, name: str) -> NDArray[np.float64]:
        return np.load(self.folder / f"{name}.npy").astype(np.float64)


def load_case(name: str) -> Case:
    folder = case_folder(name)
    data = json.loads((folder / "case.json").read_text())
    mesh = read_obj(folder / data["geometry"]["obj"])
    return Case(name, folder, data, mesh)


def sphere_interior(size: int, case: Case, inner: float = 0.97) -> NDArray[np.bool_]:
    """Pixels whose centre ray passes the unit sphere's centre within ``inner``: the silhouette,
    where the mesh and the exact sphere differ, is left out."""
    camera = case.data["camera"]
    half = np.tan(np.radians(camera["fov_deg"]) / 2)
    x = ((np.arange(size) + 0.5) / size * 2 - 1) * half
    d = np.stack(np.broadcast_arrays(x[None, :], -x[:, None], -1.0), axis=-1)
    d = d / np.linalg.norm(d, axis=-1, keepdims=True)
    distance = np.linalg.norm(np.cross(np.asarray(camera["eye"], dtype=np.float64), d), axis=-1)
    return distance < inner
