# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings to parameters, reports to lines, names of files."""

import pytest
from amberlight import report as reports
from amberlight.binding import _ffi
from amberlight.export.export_log import ExportLog
from amberlight.passes import PASSES
from amberlight.render_job import Frame, Settings, render_params

SINGLE = _ffi.AMB_EFFECT_SINGLE_SCATTERING
DOUBLE = _ffi.AMB_EFFECT_DOUBLE_SCATTERING
MULTIPLE = _ffi.AMB_EFFECT_MULTIPLE_SCATTERING
WORLD = _ffi.AMB_EFFECT_WORLD_LIGHT
CAUSTICS = _ffi.AMB_EFFECT_CAUSTICS
BETWEEN = _ffi.AMB_EFFECT_INTERREFLECTION | _ffi.AMB_EFFECT_LAMP_IMAGES
SURFACE = _ffi.AMB_EFFECT_SURFACE_REFLECTION
BACKGROUND = _ffi.AMB_EFFECT_BACKGROUND
TRANSMITTED = _ffi.AMB_EFFECT_TRANSMITTED_LIGHT


def effects(**settings):
    return render_params(Settings(**settings), Frame(4, 4))["effects"]


def test_params_are_fields_of_the_struct():
    names = {field[0] for field in _ffi.AmbRenderParams._fields_}
    params = render_params(Settings(accuracy=0.25), Frame(4, 4))
    assert set(params) == names - {"struct_size", "reserved"}
    assert params["accuracy"] == 0.25


def test_automatic_effects():
    everything = SINGLE | DOUBLE | MULTIPLE | WORLD | SURFACE | BACKGROUND | TRANSMITTED
    everything |= CAUSTICS | BETWEEN
    assert effects() == everything
    # The booleans count only when the user chooses.
    assert effects(use_background=False) == everything
    assert render_params(Settings(), Frame(4, 4))["effects_are_auto"] == 1


def test_manual_effects():
    bits = effects(effects="MANUAL", use_background=False, use_caustics=False)
    assert bits == SINGLE | SURFACE | TRANSMITTED | BETWEEN
    bits = effects(effects="MANUAL", use_double_scattering=True)
    assert bits == SINGLE | DOUBLE | SURFACE | BACKGROUND | TRANSMITTED | CAUSTICS | BETWEEN
    params = render_params(Settings(effects="MANUAL", memory_limit=3), Frame(4, 4))
    assert (params["effects_are_auto"], params["memory_limit"]) == (0, 3 << 20)


def test_preview_budget():
    limited = Settings(samples=100, light_samples=10, accuracy=0.01).limited(4, 1000)
    assert (limited.samples, limited.light_samples, limited.accuracy) == (4, 10, 0.0)


def test_passes():
    assert [item.name for item in PASSES][:2] == ["Combined", "Depth"]
    for item in PASSES:
        assert len(item.channel_ids) == item.channels


@pytest.mark.parametrize(
    ("template", "index", "want"),
    [
        ("/a/b.exr", 0, "/a/b.exr"),
        ("/a/b.exr", 1, "/a/b_Back_Layer.exr"),
        ("/a/b_####.exr", 0, "/a/b_0012.exr"),
        ("/a#/b#", 2, "/a#/b12_Back_Layer"),
    ],
)
def test_output_path(template, index, want):
    assert reports.output_path(template, 12, index, "Back Layer") == want


def test_summary():
    report = {
        "width": 4, "height": 2, "samples": 8, "estimator": "POINTS_FIXED",
        "effects": [
            {"name": "single_scattering", "simulated": True, "reason": ""},
            {"name": "background", "simulated": False, "reason": "the world is black"},
        ],
        "stages": [{"name": "light", "cpu_s": 2.0, "wall_s": 1.0}],
        "memory": {"scene_bytes": 2**20, "peak_rss_bytes": 2**21},
        "light": {"rays": 5, "volume_samples": 6},
        "warnings": [{"text": "open mesh", "count": 3}],
    }  # fmt: skip
    assert reports.summary_lines(report) == [
        "4x2, 8 samples, estimator POINTS_FIXED",
        "single scattering: simulated",
        "background: skipped, the world is black",
        "light: 1.00 s (2.00 CPU s)",
        "memory: scene 1.0 MiB, peak rss 2.0 MiB",
        "light: 5 rays, 6 volume samples",
    ]
    report["light"] = {"rays": 0, "volume_samples": 0, "tubes": 7}
    assert reports.summary_lines(report)[-1] == "light: 7 tubes"
    report["light"] = {"rays": 5, "volume_samples": 6, "tubes": 7, "tube_bounces": 2}
    assert reports.summary_lines(report)[-1] == (
        "light: 7 tubes of 2 reflections, the rest by 5 rays, 6 volume samples"
    )
    report["light"] = {"rays": 0, "volume_samples": 0, "tubes": 0, "lit_triangles": 8}
    assert reports.summary_lines(report)[-1] == "light: 8 lit triangles"
    assert reports.warning_lines(report) == ["open mesh (3 times)"]
    assert reports.summary_lines({}) == reports.warning_lines({}) == []


def test_plan_lines():
    share = {"value": 0.2, "low": 0.15, "high": 0.25}
    bead = {"name": "bead", "simulated": False, "share": None}
    statue = {"name": "statue", "simulated": True, "share": share}
    plan = {
        "plan": {"automatic": True, "share_min": 0.005, "omitted": 0.001, "probes": 64},
        "estimator": "TUBES", "estimator_reason": "lamps are small",
        "effects": [
            {"name": "single scattering", "simulated": True, "reason": "shows", "count": 0,
             "share": share, "objects": [statue, bead]},
            {"name": "light-side internal reflection", "simulated": True, "reason": "", "count": 2,
             "share": share, "objects": [statue, statue]},
        ],
    }  # fmt: skip
    assert reports.plan_lines(plan) == [
        "effects chosen by share, least share 0.5 %, left out 0.1 %, 64 probes",
        "estimator TUBES, lamps are small",
        "single scattering: simulated, shows; share 20 %, 15 % to 25 %",
        "    bead: skipped",
        "light-side internal reflection: simulated up to 2; share 20 %, 15 % to 25 %",
        "light-side internal reflection by object:",
        "    statue; share 20 %, 15 % to 25 %",
        "    statue; share 20 %, 15 % to 25 %",
    ]


@pytest.mark.parametrize(
    ("accuracy", "want"),
    [
        ({"target": 0, "stated": None, "noise": None, "field": None}, []),
        (
            {"target": 0, "stated": None, "noise": 0.0123, "field": None},
            ["error: noise 1.2 %; of the light field not estimated"],
        ),
        (
            {"target": 0.01, "stated": 0.0094, "noise": 0.009, "field": 0.0027, "reached": True},
            ["error: 0.94 % of 1 % (noise 0.9 %, light field 0.27 %)"],
        ),
        (
            {"target": 0.001, "stated": 0.004, "noise": 0.002, "field": 0.0035, "reached": False,
             "limit": "light field: no more"},
            ["error: 0.4 % of 0.1 % (noise 0.2 %, light field 0.35 %), target not reached; "
             "light field: no more"],
        ),
        (
            {"target": 0.01, "stated": 0.05, "noise": 0.02, "field": 0.0, "caustics": 0.045,
             "reached": False, "in_reach": False, "limit": "caustics: no more"},
            ["error: 5 % of 1 % (noise 2 %, light field 0 %, caustics 4.5 %), target not reached; "
             "caustics: no more; more samples a pixel cannot reach it and were not taken"],
        ),
        (
            {"target": 0.01, "stated": 0.008, "noise": 0.006, "field": 0.0, "scatter": 0.0,
             "caustics": 0.005, "pixels": "objects and caustics", "reached": True},
            ["error: 0.8 % with caustics beside objects of 1 % (noise 0.6 %, light field 0 %, "
             "caustics 0.5 %)"],
        ),
    ],
)  # fmt: skip
def test_accuracy_lines(accuracy, want):
    assert reports.summary_lines({"accuracy": accuracy}) == want


def test_effects_tell_their_time():
    bead = {"name": "bead", "simulated": True, "camera_cpu_s": 0.25}
    statue = {"name": "statue", "simulated": True, "camera_cpu_s": 1.5}
    report = {
        "plan": {"cpu_s": 0.5},
        "effects": [
            {"name": "single scattering", "simulated": True, "measured": 0.3, "cpu_s": 2.0,
             "objects": [statue, bead]},
            {"name": "caustics", "simulated": True, "measured": 0.1, "cpu_s": 1.0,
             "objects": [statue]},
        ],
    }  # fmt: skip
    assert reports.summary_lines(report) == [
        "single scattering: simulated; measured 30 %; 2 CPU s",
        "    statue; 1.5 CPU s by the camera",
        "    bead; 0.25 CPU s by the camera",
        "caustics: simulated; measured 10 %; 1 CPU s",
        "choice of effects: 0.5 CPU s of the scene's",
    ]


def test_percent_has_no_exponent():
    assert [reports.percent(value) for value in (1.4, 0.3, 0.0123, 0.0)] == [
        "140 %", "30 %", "1.2 %", "0 %",
    ]  # fmt: skip


def test_joined_warning():
    assert reports.joined_warning(["a: x"]) == "Remark: a: x"
    assert reports.joined_warning(["a: x", "b"]) == "2 remarks: a: x; b"


def test_log_collects():
    log = ExportLog()
    for name in ("A", "B", "A"):
        log.warn(name, "hair is left out")
    log.warn("", "nothing else")
    assert log.lines() == ["hair is left out: A, B", "nothing else"]
