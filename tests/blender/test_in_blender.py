# SPDX-License-Identifier: GPL-3.0-or-later
"""Starts Blender: for the tests in `inside`, and for what only a whole process shows (exit codes,
signals, a crash). AMBERLIGHT_BLENDER names another Blender."""

import importlib.util
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from run_tests import NO_PYTEST

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
BLENDER = os.environ.get("AMBERLIGHT_BLENDER", "blender")
INSIDE = sorted(path.name for path in (HERE / "inside").glob("test_*.py"))

pytestmark = pytest.mark.skipif(shutil.which(BLENDER) is None, reason="no Blender")

SCENE = """
import bpy, math
bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
scene = bpy.context.scene
scene.render.engine = "AMBERLIGHT"
scene.render.resolution_x, scene.render.resolution_y = 16, 16
scene.amberlight.samples = 2
scene.amberlight.light_samples = 2000
bpy.ops.object.camera_add(location=(0, -5, 0), rotation=(math.radians(90), 0, 0))
scene.camera = bpy.context.object
bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=2)
ball = bpy.context.object
bpy.ops.amberlight.new_translucent_material(preset="RESIN")
bpy.ops.object.light_add(type="SPOT", location=(0, 0, 5))
"""


@pytest.fixture(scope="session")
def scripts(tmp_path_factory):
    """A folder of scripts that holds the add-on of this checkout."""
    folder = tmp_path_factory.mktemp("scripts")
    (folder / "addons").mkdir()
    (folder / "addons" / "amberlight").symlink_to(ROOT / "addon" / "amberlight")
    return folder


@pytest.fixture(scope="session")
def fake_library(tmp_path_factory):
    path = tmp_path_factory.mktemp("fake") / "libamberlight.so"
    source = ROOT / "tests" / "python" / "fake_library.c"
    command = ["gcc", "-std=c11", "-D_GNU_SOURCE", "-fPIC", "-shared", f"-I{ROOT}/native/include"]
    subprocess.run([*command, str(source), "-o", str(path)], check=True)
    return path


@pytest.fixture
def start(scripts, fake_library, tmp_path):
    """Starts a background Blender with the add-on; returns the Popen."""

    def run(*arguments, library=None, wrap=(), background=True):
        environment = {
            **os.environ,
            "BLENDER_USER_SCRIPTS": str(scripts),
            "AMBERLIGHT_FAKE_LIBRARY": str(fake_library),
            "TMPDIR": str(tmp_path),
        }
        if library:
            environment["AMBERLIGHT_LIBRARY"] = str(library)
        command = [*wrap, BLENDER, *(["-b"] if background else []), "--factory-startup"]
        return subprocess.Popen(
            [*command, "--addons", "amberlight", *map(str, arguments)],
            env=environment, cwd=tmp_path, text=True, errors="replace",
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip

    return run


@pytest.fixture
def render(start, tmp_path):
    """Renders frame 1 of SCENE, changed by `script`: (exit code, output, image)."""

    def run(script="", **options):
        path = tmp_path / "scene.py"
        path.write_text(SCENE + script)
        image = tmp_path / "image0001.png"
        process = start("--python", path, "-o", tmp_path / "image", "-F", "PNG", "-f", 1, **options)
        output, _ = process.communicate(timeout=120)
        return process.returncode, output, image

    return run


@pytest.mark.parametrize("name", INSIDE)
def test_inside(start, name, tmp_path):
    process = start(
        "--python", HERE / "run_tests.py", "--",
        "-q", "--rootdir", ROOT, "--basetemp", tmp_path / "pytest", HERE / "inside" / name,
    )  # fmt: skip
    output, _ = process.communicate(timeout=600)
    if process.returncode == NO_PYTEST:
        pytest.skip("no pytest for Blender's Python")
    sys.stdout.write(output)
    assert process.returncode == 0, output[-6000:]


def test_exit_code_of_a_render(render, fake_library):
    code, output, image = render(library=fake_library)
    assert code == 0 and image.is_file(), output
    # What a headless user reads, line by line.
    assert "single scattering: simulated" in output
    assert "background: skipped, the world is black" in output
    assert "camera: 0.75 s (1.50 CPU s)" in output
    # "Warning: " until Blender 5, then a line of its log.
    remarks = re.findall(r"(?i)(.*)amberlight: remark: mesh .A. is open \(2 times\)", output)
    assert len(remarks) == 1 and "warning" in remarks[0].lower(), output


SKY = """
world = scene.world = bpy.data.worlds.new("World")
if bpy.app.version < (5, 0):
    world.use_nodes = True
sky = world.node_tree.nodes.new("ShaderNodeTexSky")
background = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
world.node_tree.links.new(sky.outputs[0], background.inputs["Color"])
world.amberlight.width = {width}
"""


def test_a_render_bakes_the_world(render, fake_library):
    code, output, image = render(SKY.format(width=64), library=fake_library)
    assert code == 0 and image.is_file(), output
    assert output.count('Amberlight: baking world "World"') == 1, output
    assert "Bake World" not in output


def test_interrupt_of_a_bake(start, fake_library, tmp_path):
    """Ends the render that waits for it, too."""
    script = SKY.format(width=4096)
    assert interrupted(start, tmp_path, script, "Sample 1/", library=fake_library) < 20


BAD = {
    "no camera": ("scene.camera = None", "Cannot render, no camera"),
    "no mesh that is finite": (
        "ball.data.vertices[0].co.x = math.nan",
        'a position of mesh "Icosphere" is not finite',
    ),
    "no such estimator": ("scene.amberlight.estimator = 'SPECULAR'", "is not available"),
    "panorama": ("scene.camera.data.type = 'PANO'", "renders perspective and orthographic"),
    "no numpy": ("import sys; sys.modules['numpy'] = None", "install python3-numpy"),
}


@pytest.mark.parametrize("case", BAD)
def test_exit_code_of_a_failure(render, fake_library, case):
    script, message = BAD[case]
    code, output, image = render(script, library=fake_library)
    assert code == 1 and not image.exists(), output
    assert len([line for line in output.splitlines() if message in line]) == 1, output


def test_missing_library(render, tmp_path):
    code, output, image = render(library=tmp_path / "nowhere.so")
    assert code == 1 and not image.exists()
    assert "nowhere.so is missing: build it" in output


def test_error_of_an_earlier_frame_ends_an_animation(start, fake_library, tmp_path):
    path = tmp_path / "scene.py"
    path.write_text(SCENE + "scene.frame_end = 2\nscene.camera = None")
    process = start("--python", path, "-o", tmp_path / "image", "-a", library=fake_library)
    process.communicate(timeout=120)
    assert process.returncode == 1 and not list(tmp_path.glob("image*"))


def wait_for(process, text):
    """Reads the output until a line contains `text`."""
    for line in process.stdout:
        if text in line:
            return
    pytest.fail(f"Blender ended without saying {text!r}")


def interrupted(start, tmp_path, script, sign="Amberlight: ", **options):
    """Seconds from SIGINT, once a render has said `sign`, to Blender's end."""
    path = tmp_path / "scene.py"
    path.write_text(SCENE + script)
    process = start("--python", path, "-o", tmp_path / "image", "-F", "PNG", "-f", 1, **options)
    wait_for(process, sign)
    process.send_signal(signal.SIGINT)
    begin = time.perf_counter()
    process.communicate(timeout=60)
    assert process.returncode == 1 and not list(tmp_path.glob("image*"))
    return time.perf_counter() - begin


def test_interrupt(start, fake_library, tmp_path):
    """Ctrl-C in a render without end."""
    script = "scene.amberlight.samples = 100000"
    assert interrupted(start, tmp_path, script, library=fake_library) < 10


def test_interrupt_of_the_real_library(start, tmp_path):
    if not real_library().is_file():
        pytest.skip("the library is not built")
    script = (
        "scene.amberlight.samples = 100000\nscene.amberlight.light_samples = 100000\n"
        "scene.render.resolution_x = scene.render.resolution_y = 512\n"
    )
    assert interrupted(start, tmp_path, script) < 10


def real_library():
    override = os.environ.get("AMBERLIGHT_LIBRARY")
    return Path(override or ROOT / "addon" / "amberlight" / "lib" / "libamberlight.so")


def run_in_window(start, fake_library, script, *arguments):
    """(exit code, output) of a Blender with a window."""
    if shutil.which("xvfb-run") is None:
        pytest.skip("no xvfb-run")
    process = start(
        *arguments, "--python", HERE / script, library=fake_library, background=False,
        wrap=["xvfb-run", "-a", "-s", "-screen 0 1280x1024x24"],
    )  # fmt: skip
    try:
        output, _ = process.communicate(timeout=100)
    except subprocess.TimeoutExpired:
        process.terminate()
        output, _ = process.communicate()
    return process.returncode, output


def test_window(start, fake_library):
    """Viewport, panels and F12 in a Blender with a window."""
    code, output = run_in_window(start, fake_library, "window_script.py")
    for line in (
        "first", "moved", "changed", "orthographic", "renders 1", "baked CURRENT",
        "undone MISSING", "redone CURRENT", "the end",
    ):  # fmt: skip
        assert f"SAW {line}\n" in output, output
    # A panel that fails to draw says so here.
    assert "addons/amberlight" not in output and "rna_uiItemR" not in output, output
    assert code == 0, output


def test_cost_in_a_window(start, fake_library):
    """The operator runs beside the user interface, stops at Esc, and shows its picture."""
    code, output = run_in_window(
        start, fake_library, "window_cost_script.py", "--enable-event-simulate"
    )
    for line in (
        "started {'RUNNING_MODAL'}", "running True", "stopped with 0 rows", "rows True",
        "ticks True", "applied POINTS_FIXED", "the end",
    ):  # fmt: skip
        assert f"SAW {line}\n" in output, output
    if importlib.util.find_spec("matplotlib"):
        assert "SAW picture ['cost.png']\n" in output or "no matplotlib" in output, output
    assert "addons/amberlight" not in output and "rna_uiItemR" not in output, output
    assert code == 0, output
