# SPDX-License-Identifier: GPL-3.0-or-later
"""What is rendered, in which order, and what is left out, over a scene of known errors."""

import csv
import dataclasses

import numpy as np
import pytest
from amberlight.binding.errors import AmberlightError
from amberlight.cost import sweep as sweep_module
from amberlight.cost.bench import Options
from amberlight.cost.references import ImageReference
from amberlight.cost.rows import Setting
from amberlight.cost.session import Request, Worker, measure
from amberlight.cost.sweep import Sweep
from amberlight.export.scene_data import IDENTITY, CameraData, MaterialData, ObjectData
from cost_stub import BEST_KERNEL, NOISE, SIZE, TRUTH, Clock, StubScene, render_params
from test_handles import scene_data

NO_SPECULAR = {"SPECULAR": "not available"}
NO_TUBES = {"TUBES": "estimator TUBES cannot render this: a lamp has an extent", **NO_SPECULAR}
LEVELS = (8192, 32768, 131072)
FREE = Options(0.0, 1, levels=LEVELS)


def sweep(options=FREE, scene=None, **params):
    """(measurement, scene) of a complete sweep."""
    scene = scene or StubScene(Clock(), NO_SPECULAR)
    with Sweep((scene, scene), "stub", render_params(**params), options, scene.clock) as found:
        for status in found.run():
            assert 0.0 <= status.fraction <= 1.0 and status.text
        return found.measurement, scene


def settings(measurement, estimator):
    return [row.setting for row in measurement.rows_of(estimator)]


def test_finest_tubes_are_the_reference():
    found, _ = sweep()
    assert found.reference.name == "TUBES, refinement 4"
    # The errors of the stub are e, 4 e, 16 e: extrapolation finds that of the reference itself.
    assert found.reference.own == pytest.approx(0.04 * 4.0**-4, rel=1e-3)
    assert [s.tube_refinement for s in settings(found, "TUBES")] == [0, 1, 2, 3, -1, -2]
    want = 0.04 * (1 - 4.0**-4)
    assert found.rows_of("TUBES")[0].error("rel_rmse") == pytest.approx(want, rel=1e-3)
    assert found.is_doubtful(found.rows_of("TUBES")[3]) is False
    assert found.mean == pytest.approx(2.0) and found.coverage == 1.0


def test_kernels_are_swept_around_the_best():
    found, _ = sweep()
    for estimator, kernel in BEST_KERNEL.items():
        for level in LEVELS:
            rows = [r for r in found.rows_of(estimator) if r.setting.light_samples == level]
            assert {kernel / 2, kernel, 2 * kernel} <= {r.setting.kernel_size for r in rows}
            best = min(rows, key=lambda row: row.error("rel_rmse"))
            assert best.setting.kernel_size == kernel
    # Once the best is known only its neighbours are looked at.
    last = [s for s in settings(found, "POINTS_FIXED") if s.light_samples == LEVELS[-1]]
    assert len(last) == 3


def test_next_kernel():
    assert sweep_module.next_kernel({}, 5) == 5
    assert sweep_module.next_kernel({5: 0.2}, 5) == 4
    assert sweep_module.next_kernel({5: 0.2, 4: 0.3}, 5) == 6
    assert sweep_module.next_kernel({5: 0.2, 4: 0.3, 6: 0.1}, 5) == 7
    assert sweep_module.next_kernel({5: 0.2, 6: 0.1, 7: 0.1}, 5) is None
    # At the ends of the row one neighbour is enough.
    assert sweep_module.next_kernel({0: 0.1, 1: 0.2}, 1) is None


def test_camera_rays_are_the_same_in_all_renders():
    scene = StubScene(Clock(), NO_SPECULAR)
    sweep(scene=scene, crop_x=3, crop_width=2, light_bounces=1)
    probes = [params for params in scene.started if params["width"] < SIZE]
    assert len(probes) == 1, "of SPECULAR, which is then not rendered"
    for params in scene.started:
        if params in probes:
            continue
        assert (params["seed"], params["samples"], params["width"]) == (7, 4, SIZE)
        assert (params["crop_width"], params["light_bounces"]) == (0, 1)
        # Surroundings are the same for all: they are left out.
        assert params["effects"] in {0, 1}


def test_costs():
    found, _ = sweep()
    assert found.rays == [0.1] * len(found.rays) and len(found.rays) > 2
    row = found.rows_of("TUBES")[1]
    # Building the scene happens once, in the first render, and is charged to all.
    assert row.run.stages == pytest.approx({"scene": 0.26, "light": 0, "field": 0.4, "camera": 0.4})
    assert (row.precompute, row.camera, row.total) == pytest.approx((0.66, 0.4, 1.06))
    row = next(r for r in found.rows_of("POINTS_FIXED") if r.setting.light_samples == 8192)
    assert (row.elements, row.field_bytes, row.light_bytes) == (8192, 72 * 8192, 24 * 8192)


def test_unsupported_is_a_reason_not_a_failure():
    found, _ = sweep(scene=StubScene(Clock(), NO_TUBES))
    assert found.estimators == ["POINTS_FIXED", "POINTS_COVARIANCE"]
    assert [(m.what, m.reason) for m in found.missing][:2] == [
        ("TUBES", "cannot render this: a lamp has an extent"),
        ("SPECULAR", "cannot render this: not available"),
    ]
    # Then most points are the reference, and rows that share much of it are left out.
    assert found.reference.name == f"POINTS_COVARIANCE, {LEVELS[-1]} samples, kernel size 2"
    assert max(r.setting.light_samples for r in found.rows) == LEVELS[-1] // 4
    assert "a quarter of its samples differ from it by" in found.reference.about
    assert found.missing[2].reason == "more than a quarter of the reference's samples"


def test_specular_is_the_reference_where_tubes_cannot():
    found, _ = sweep(scene=StubScene(Clock(), {"TUBES": "a lamp has an extent"}))
    assert found.reference.name == "SPECULAR" and found.reference.own is None
    assert "SPECULAR" not in found.estimators


def test_specular_is_a_row_beside_tubes():
    found, _ = sweep(scene=StubScene(Clock()))
    assert found.reference.name == "TUBES, refinement 4"
    assert found.rows_of("SPECULAR")[0].total == pytest.approx(50.26)


def test_paths_that_are_left_out_are_named():
    found, _ = sweep(scene=StubScene(Clock(), NO_SPECULAR, less=("TUBES",)))
    assert found.notes == ["TUBES leaves out light through other objects: its error contains that"]
    # What lacks light is no reference.
    assert found.reference.name.startswith("POINTS_COVARIANCE")
    # And finer tubes lack it as much.
    assert len(found.rows_of("TUBES")) == 2


def test_time_limit_is_kept_and_what_is_missing_is_named():
    clock = Clock()
    scene = StubScene(clock, NO_SPECULAR)
    found, _ = sweep(Options(12.0, 3, levels=(*LEVELS, 2**21)), scene)
    assert clock.now <= 12.0 + 1.0
    assert found.wall == clock.now
    reasons = {m.what: m.reason for m in found.missing}
    assert reasons["TUBES from refinement 2 on"] == "the time limit"
    assert any(what.startswith("points from") for what in reasons)
    # Neither of the two has a budget that the other lacks.
    levels = [{s.light_samples for s in settings(found, estimator)} for estimator in BEST_KERNEL]
    assert levels[0] == levels[1]


def test_kernels_that_did_not_fit_are_named():
    found, _ = sweep(Options(16.0, 1, levels=LEVELS))
    named = [m.what for m in found.missing if m.what.startswith("more kernels of ")]
    assert named
    for row in found.rows_of("POINTS_FIXED") + found.rows_of("POINTS_COVARIANCE"):
        setting = row.setting
        what = f"more kernels of {setting.estimator}, {setting.light_samples} samples"
        assert row.is_tuned == (what not in named)
        assert row.is_tuned or row not in found.front(setting.estimator)


def test_longer_limits_find_more():
    counts = [len(sweep(Options(limit, 1, levels=LEVELS))[0].rows) for limit in (8.0, 20.0, 100.0)]
    assert counts == sorted(set(counts))


def test_render_that_would_take_too_long_is_not_begun():
    scene = StubScene(Clock())
    found, _ = sweep(Options(40.0, 1, levels=LEVELS), scene)
    assert "SPECULAR" not in found.estimators
    reasons = {m.what: m.reason for m in found.missing}
    # 50 s in full: a few rays told.
    assert reasons["SPECULAR"] == "the time limit, it would take some 50 s"
    specular = Setting("SPECULAR").params["estimator"]
    begun = [p for p in scene.started if p.get("estimator") == specular]
    assert [(p["width"], p["height"], p["samples"]) for p in begun] == [(2, 2, 1)]


def test_render_that_takes_too_long_is_cut_off():
    """Even the few rays: what they cost is bounded too."""
    scene = StubScene(Clock(), speed=30.0)
    found, _ = sweep(Options(100.0, 1, levels=LEVELS[:1]), scene)
    assert {m.what: m.reason for m in found.missing}["SPECULAR"] == "the time limit"


def test_too_short_for_a_reference():
    scene = StubScene(Clock(), NO_TUBES, speed=50.0)
    with pytest.raises(AmberlightError, match="too short for a reference: raise the time limit"):
        sweep(Options(30.0, 1, levels=LEVELS), scene)


def test_repeats_are_spent_on_the_fronts():
    found, _ = sweep(Options(0.0, 3, levels=LEVELS))
    for estimator, front in found.fronts.items():
        for row in found.rows_of(estimator):
            assert len(row.runs) == (3 if row in front else 1), row


def test_image_from_elsewhere():
    given = ImageReference("given.npy", (TRUTH + 0.02 * NOISE,))
    found, _ = sweep(Options(0.0, 1, reference=given, levels=LEVELS))
    assert found.reference.name == "given.npy" and found.reference.row is None
    errors = [row.error("rel_rmse") for row in found.rows_of("TUBES")]
    # 0.08 4^-r is added, 0.02 is there: the second refinement hits the image that was given.
    want = [abs(0.08 * 4.0**-r - 0.02) / 2 for r in (0, 1, 2, 3, -1, -2)]
    assert errors == pytest.approx(want, abs=1e-6)


def test_two_noisy_images():
    rng = np.random.default_rng(1)
    runs = tuple(TRUTH + rng.normal(0, 0.05, TRUTH.shape) for _ in range(2))
    found, _ = sweep(Options(0.0, 1, reference=ImageReference("A and B", runs), levels=LEVELS))
    row = found.rows_of("POINTS_FIXED")[0]
    assert row.error("mse") == pytest.approx((0.4 * 4) ** 2, rel=0.02)


@pytest.mark.parametrize(
    ("truth", "words"), [(np.zeros_like(TRUTH), "no light that scatters is in view")]
)
def test_nothing_to_measure(truth, words):
    with pytest.raises(AmberlightError, match=words):
        sweep(scene=StubScene(Clock(), NO_SPECULAR, truth=truth))


def test_closing_the_steps_ends_the_render():
    scene = StubScene(Clock(), NO_SPECULAR)
    with Sweep((scene, scene), "stub", render_params(), FREE, scene.clock) as found:
        steps = found.run()
        next(steps)
        steps.close()
        assert found.measurement is None and len(scene.started) == 1
        folder = found._path(Setting("SPECULAR")).parent
        assert folder.is_dir()
    assert not folder.exists()


# ---- Over the stand-in for the library -----------------------------------------------------------


def request(folder, **options):
    data = dataclasses.replace(
        scene_data(),
        materials=[MaterialData("Glass", is_dielectric=True)],
        objects=[ObjectData("Tri", 0, IDENTITY, (0,))],
        camera=CameraData(IDENTITY, (-0.5, 0.5, -0.5, 0.5)),
    )
    chosen = Options(**{"time_limit": 0.0, "repeats": 1, "levels": (64, 256), **options})
    return Request(data, "fake", render_params(samples=1), chosen, folder, ("hair is left out",))


def test_session_writes_its_files(fake, tmp_path):
    steps = measure(fake, request(tmp_path / "new" / "folder"))
    while True:
        try:
            next(steps)
        except StopIteration as end:
            outcome = end.value
            break
    names = {file.name for file in outcome.files}
    assert {"cost.csv", "cost.md", "cost_reference.exr", "cost_tubes.exr"} <= names
    assert all(file.stat().st_size > 0 for file in outcome.files)
    text = (tmp_path / "new" / "folder" / "cost.md").read_text()
    assert "- hair is left out\n" in text
    assert "SPECULAR: cannot render this: this estimator is not available" in text
    with (tmp_path / "new" / "folder" / "cost.csv").open() as file:
        rows = list(csv.DictReader(file))
    # The stand-in takes the same 1.5 CPU s for everything, and always draws the same.
    assert {row["camera_cpu_s"] for row in rows} == {"1.500000"}
    assert {row["rel_rmse"] for row in rows if row["role"] == "row"} == {"0"}


def test_worker_is_cancelled(fake, tmp_path):
    worker = Worker(fake, request(tmp_path))
    worker.start()
    worker.cancel()
    worker.join(10.0)
    assert not worker.is_alive() and worker.outcome is None and worker.error is None
    assert not list(tmp_path.iterdir())


def test_worker_keeps_its_error(fake, tmp_path):
    (tmp_path / "file").write_text("")
    worker = Worker(fake, request(tmp_path / "file" / "folder"))
    worker.start()
    worker.join(60.0)
    assert worker.outcome is None
    assert worker.message.startswith("the measurement is complete but not written: ")
