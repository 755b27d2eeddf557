# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders the worst five pictures before and after their fix, side by side, into docs/stability/.

    python3 tests/stability/pictures.py      # builds the commits before the fixes: minutes

A fix is named by the subject of its commit; "before" is the library of that commit's parent. Both
halves have the same exposure, that of the picture after.
"""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
OUT = ROOT / "docs/stability"
SIZE = 96
TUBES_FIX = "Keep tubes exact along the light and in dense media, by a table of hard cases"
PLACES_FIX = "Keep pictures of far, near, doubled and open things right"
# Name of the picture: the commit that mended it, and the method.
PICTURES = {
    "far_from_the_origin": (PLACES_FIX, "POINTS_COVARIANCE"),
    "along_the_light": (TUBES_FIX, "TUBES"),
    "dense": (TUBES_FIX, "TUBES"),
    "faces_given_twice": (PLACES_FIX, "TUBES"),
    "lamp_on_the_surface": (PLACES_FIX, "TUBES"),
}


def setup_of(name: str) -> object:
    from dataclasses import replace

    import table_lights
    import table_meshes
    from meshes import bumpy_sphere, icosphere
    from scenes import POINT, SUN, Body, Camera, Lamp, Setup

    if name == "far_from_the_origin":
        ball = replace(table_meshes.BALL, camera=Camera((0, 0, 5), window=2.3))
        return ball.placed(move=(1e5, -1e5, 7e4))
    if name == "along_the_light":
        light = np.array([0.36, 0.48, 0.8])
        body = Body(icosphere(4), 1.0, (0.4, 0.5, 0.3), 0.2, 0.3)
        return Setup((body,), (Lamp(SUN, direction=light),), Camera(-5 * light, light, window=2.3))
    if name == "dense":
        body = Body(bumpy_sphere(4), 1.5, (400.0, 300.0, 200.0), 10.0)
        lamp = Lamp(POINT, color=20.0, position=(2.5, 1.5, 2.8))
        return Setup((body,), (lamp,), Camera((0, 0, 5), window=2.3))
    if name == "faces_given_twice":
        mesh = table_meshes.with_duplicates(table_meshes.CUBE)
        return replace(
            table_meshes.cube_setup(mesh), camera=Camera((3, 2, 4), (-3, -2, -4), window=3.6)
        )
    body = Body(table_lights.CUBE, 1.0, (0.4, 0.5, 0.3), 0.1)
    return Setup(
        (body,),
        (Lamp(POINT, position=(0.1, 0.2, 1.0001)),),
        Camera((3, 2, 4), (-3, -2, -4), window=3.6),
    )


def write_png(path: Path, pixels: np.ndarray) -> None:
    """(height, width, 3) uint8."""
    height, width, _ = pixels.shape
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(rows, 9))
        + chunk(b"IEND", b"")
    )


def render_one(name: str, path: str, root: str) -> None:
    """In a process of its own, with the library and the binding of that checkout."""
    sys.path[:0] = [str(HERE), str(Path(root) / "tests/images")]
    from dataclasses import replace

    from scenes import picture

    setup = replace(setup_of(name), size=SIZE)
    np.save(path, picture(setup, PICTURES[name][1], samples=4, light_samples=2**17))


def checkout_before(subject: str, folder: Path) -> Path:
    """Builds the parent of the commit with that subject."""
    commit = subprocess.check_output(
        ["git", "log", "-1", "--format=%H", "--fixed-strings", f"--grep={subject}"],
        cwd=ROOT,
        text=True,
    ).strip()
    if not commit:
        raise SystemExit(f'no commit "{subject}"')
    folder.mkdir()
    archive = subprocess.check_output(["git", "archive", f"{commit}^"], cwd=ROOT)
    subprocess.run(["tar", "x"], input=archive, cwd=folder, check=True)
    for command in (
        ["cmake", "-S", ".", "--preset", "release", "-DAMB_BUILD_TESTS=OFF", "-DAMB_WERROR=OFF"],
        ["cmake", "--build", "build/release", "--target", "amberlight"],
    ):
        subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)
    return folder


def main() -> None:
    OUT.mkdir(exist_ok=True)
    work = Path(tempfile.mkdtemp())
    try:
        fixes = {subject: None for subject, _ in PICTURES.values()}
        before = {s: checkout_before(s, work / str(i)) for i, s in enumerate(fixes)}
        for name, (subject, _) in PICTURES.items():
            halves = []
            for root in (before[subject], ROOT):
                path = str(work / "half.npy")
                library = root / "build/release/lib/libamberlight.so"
                environment = os.environ | {"AMBERLIGHT_LIBRARY": str(library)}
                command = [sys.executable, __file__, name, path, str(root)]
                subprocess.run(command, env=environment, check=True)
                halves.append(np.load(path))
            white = np.percentile(halves[1], 99.5)
            gap = np.full((SIZE, 4, 3), white)
            both = np.concatenate([halves[0], gap, halves[1]], axis=1)
            shown = np.clip(both / white, 0, 1) ** (1 / 2.2)
            write_png(OUT / f"{name}.png", (255 * shown + 0.5).astype(np.uint8))
            print(name, float(halves[0].mean()), float(halves[1].mean()))
    finally:
        shutil.rmtree(work)


if __name__ == "__main__":
    if len(sys.argv) == 4:
        render_one(*sys.argv[1:])
    else:
        main()
