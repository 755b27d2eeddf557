# SPDX-License-Identifier: GPL-3.0-or-later
"""Lifetimes, checks and errors of the handles, and a render from end to end over the stand-in."""

import gc
import threading
import time

import numpy as np
import pytest
from amberlight.binding import _ffi, errors
from amberlight.binding.handles import Render, Scene
from amberlight.export.scene_data import (
    IDENTITY,
    CameraData,
    LightData,
    MaterialData,
    MeshData,
    ObjectData,
    SceneData,
)
from amberlight.render_job import Frame, RenderJob, Settings, render_params
from conftest import alive

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
INDICES = np.array([[0, 1, 2]], np.uint32)
CAMERA = CameraData(IDENTITY, (-0.5, 0.5, -0.5, 0.5))


def scene_data(positions=TRIANGLE):
    return SceneData(
        materials=[MaterialData("Grey")],
        meshes=[MeshData("Tri", positions, INDICES)],
        objects=[ObjectData("Tri", 0, IDENTITY, (0,))],
        lights=[LightData("Lamp", "POINT", (1.0, 1.0, 1.0))],
        camera=CAMERA,
    )


def committed(library):
    scene = Scene(library)
    scene.set_camera(_ffi.AMB_CAMERA_PERSPECTIVE, IDENTITY, window=(-1, 1, -1, 1))
    scene.commit()
    return scene


def params(settings=None, **frame):
    return render_params(settings or Settings(), Frame(**{"width": 8, "height": 4, **frame}))


def test_close_twice(fake):
    scene = Scene(fake)
    scene.close()
    scene.close()
    assert scene.is_closed
    with pytest.raises(errors.AmbStateError, match="closed"):
        scene.commit()


def test_context_manager_closes_after_an_error(fake):
    with pytest.raises(ZeroDivisionError), Scene(fake):
        raise ZeroDivisionError
    assert alive(fake) == (0, 0)


def test_forgotten_handle_warns_and_closes(fake):
    scene = Scene(fake)
    with pytest.warns(ResourceWarning, match="unclosed Scene"):
        del scene
        gc.collect()
    assert alive(fake) == (0, 0)


def test_scene_closes_its_renders_first(fake):
    scene = committed(fake)
    render = scene.start(width=2, height=2, samples=1)
    assert alive(fake) == (1, 1)
    scene.close()
    assert render.is_closed


def test_explain(fake):
    """A plan without a render, and the library's refusal."""
    scene = committed(fake)
    plan = scene.explain(seed=7, effects_are_auto=1)
    assert plan["plan"]["automatic"] and plan["effects"][0]["reason"] == "seed 7"
    assert alive(fake) == (1, 0)
    scene.close()
    with Scene(fake) as scene, pytest.raises(errors.AmbStateError):
        scene.explain()


def test_render_keeps_its_scene(fake):
    render = committed(fake).start(width=2, height=2, samples=1)
    gc.collect()
    assert alive(fake) == (1, 1)
    render.close()
    render._scene.close()


@pytest.mark.parametrize(
    ("arrays", "what"),
    [
        ((TRIANGLE[:, :2], INDICES), "positions"),
        ((TRIANGLE, INDICES.ravel()), "triangles"),
        ((TRIANGLE, INDICES, TRIANGLE[:2], _ffi.AMB_NORMALS_VERTEX), "normals"),
        ((TRIANGLE, INDICES, TRIANGLE, _ffi.AMB_NORMALS_CORNER), "normals"),
        ((TRIANGLE, INDICES, None, 0, np.zeros(2, np.uint32)), "slots"),
    ],
)
def test_wrong_shapes_never_reach_the_library(fake, arrays, what):
    with Scene(fake) as scene, pytest.raises(ValueError, match=what):
        scene.add_mesh("Tri", *arrays)


def test_other_layouts_are_converted(fake):
    with Scene(fake) as scene:
        strided = np.zeros((3, 6))[:, ::2]
        assert scene.add_mesh("Tri", strided, INDICES.astype(np.int64)) == 0
        assert scene.add_mesh("Tri", TRIANGLE, INDICES, TRIANGLE, _ffi.AMB_NORMALS_VERTEX) == 1


def test_unknown_field(fake):
    with Scene(fake) as scene, pytest.raises(TypeError, match="no field 'colour'"):
        scene.add_light(_ffi.AMB_LIGHT_POINT, "Lamp", colour=(1, 1, 1))
    with Scene(fake) as scene, pytest.raises(ValueError, match="needs 3 values"):
        scene.add_light(_ffi.AMB_LIGHT_POINT, "Lamp", color=(1, 1))


@pytest.mark.parametrize(
    ("status", "builtin"),
    [
        ("INVALID_ARGUMENT", ValueError),
        ("INVALID_STATE", RuntimeError),
        ("OUT_OF_MEMORY", MemoryError),
        ("UNSUPPORTED", NotImplementedError),
        ("IO", OSError),
    ],
)
def test_classes(status, builtin):
    value = getattr(_ffi, f"AMB_{status}")
    error = errors.CLASSES[value]("it failed", value, "amb_f")
    assert isinstance(error, builtin) and isinstance(error, errors.AmberlightError)
    assert (str(error), error.status, error.function) == ("amb_f: it failed", value, "amb_f")


def test_error_names_function_and_object(fake):
    broken = TRIANGLE.copy()
    broken[1, 1] = np.nan
    with Scene(fake) as scene, pytest.raises(errors.AmbArgumentError) as caught:
        scene.add_mesh("Soap", broken, INDICES)
    assert str(caught.value) == 'amb_scene_add_mesh: a position of mesh "Soap" is not finite'


def test_too_many_lobes(fake):
    lobes = [((1, 1, 1), 0.1 * i) for i in range(5)]
    with Scene(fake) as scene, pytest.raises(errors.AmbArgumentError, match="too many lobes"):
        scene.add_material("Jam", lobes=lobes)


def test_committed_scene_is_constant(fake):
    with committed(fake) as scene, pytest.raises(errors.AmbStateError, match="committed"):
        scene.add_mesh("Tri", TRIANGLE, INDICES)


def test_job(fake):
    seen = []
    with RenderJob(fake, scene_data(), params(crop=(1, 2, 3, 2))) as job:
        assert job.run(lambda progress: seen.append(progress.fraction) or True)
        assert seen == sorted(seen) and seen[-1] == 1.0
        pixels = job.render.read_pass("Combined")
        assert pixels.shape == (2, 3, 4)
        assert pixels[1, 2, 0] == 1 + 2 + 1000 * (2 + 1)
        assert job.render.read_pass("Depth").shape == (2, 3, 1)
        assert job.render.report()["samples"] == 16
        with pytest.raises(errors.AmbArgumentError, match="no such pass"):
            job.render.read_pass("Colour")


def test_job_cancels(fake):
    settings = Settings(samples=100_000)
    start = time.perf_counter()
    with RenderJob(fake, scene_data(), params(settings)) as job:
        assert job.run(lambda progress: progress.fraction < 0.5) is False
    assert time.perf_counter() - start < 5.0


def test_job_stops_when_it_is_enough(fake):
    """An endless render whose first sample will do: there is a picture, and closing ends it."""
    settings = Settings(samples=100_000)
    with RenderJob(fake, scene_data(), params(settings)) as job:
        assert job.run(lambda progress: True, lambda progress: progress.samples_done > 0)
        assert job.render.read_pass("Combined").shape == (4, 8, 4)


def test_job_frees_after_a_bad_scene(fake):
    broken = np.full_like(TRIANGLE, np.inf)
    with pytest.raises(errors.AmbArgumentError, match='"Tri" is not finite'):
        RenderJob(fake, scene_data(broken), params())
    with pytest.raises(errors.AmbUnsupported, match="not available"):
        RenderJob(fake, scene_data(), params(Settings(estimator="SPECULAR")))
    assert alive(fake) == (0, 0)


def test_write_exr(fake, tmp_path):
    with RenderJob(fake, scene_data(), params()) as job:
        job.run(lambda progress: True)
        job.render.write_exr(tmp_path / "a.exr", "Layer")
        assert (tmp_path / "a.exr").read_text() == "Layer"
        with pytest.raises(errors.AmbIOError):
            job.render.write_exr(tmp_path / "none" / "a.exr", "Layer")


def test_waiting_lets_other_threads_run(fake):
    render = Render(committed(fake), width=2, height=2, samples=5000)
    ticks = []
    thread = threading.Thread(target=lambda: ticks.append(time.perf_counter()))
    start = time.perf_counter()
    thread.start()
    render.wait(0.3)
    thread.join()
    assert ticks[0] - start < 0.25
    render._scene.close()


def test_errors_belong_to_their_thread(fake):
    """Each thread reads its own record."""
    texts = {}

    def provoke(name):
        with Scene(fake) as scene:
            for _ in range(50):
                try:
                    scene.add_mesh(name, np.full((3, 3), np.nan, np.float32), INDICES)
                except errors.AmbArgumentError as error:
                    texts.setdefault(name, set()).add(str(error))

    threads = [threading.Thread(target=provoke, args=(f"mesh{i}",)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for name, said in texts.items():
        assert said == {f'amb_scene_add_mesh: a position of mesh "{name}" is not finite'}
