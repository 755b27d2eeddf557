# SPDX-License-Identifier: GPL-3.0-or-later
"""The planner against shares by brute force (references/planner_shares.json, made by
references/make_planner_shares.py), and what a scene must never be charged for."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from api import handles, library, rgb
from meshes import Mesh
from planner_scenes import SCENES, Body, PlannerScene, add_mesh, cube, point, spot
from planner_shares import (
    BOUNCES,
    COUNTS,
    EVERYTHING,
    ORDERS,
    object_mask,
    render_passes,
    truth,
)

MEASURED: dict[str, dict[str, Any]] = json.loads(
    (Path(__file__).parent / "references/planner_shares.json").read_text()
)
SIZE = 24
# Why an effect that is less than the least share is simulated all the same.
TOGETHER = "what is left out would be too much together"
# What a share must be of the least one that is simulated for the decision to be certain.
CLEAR = 2.0
KINDS = (
    "light of the surroundings in media",
    "light through other objects",
    "light-side internal reflection",
)
BY_NAME = {scene.name: scene for scene in SCENES}


def explain(scene: PlannerScene, **params: Any) -> dict[str, Any]:
    settings = {
        "width": SIZE,
        "height": SIZE,
        "samples": 64,
        "effects": EVERYTHING,
        "effects_are_auto": 1,
    }
    with handles.Scene(library.load()) as built:
        scene.build(built)
        built.commit()
        return built.explain(**(settings | params))


def effects(plan: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {effect["name"]: effect for effect in plan["effects"]}


def taken_back_rightly(
    plan: dict[str, Any], name: str, share: float, shares: dict[str, Any]
) -> bool:
    """Whether with this share more would be left out than one effect may have alone, five sixths
    of what all may have together."""
    is_taken_back = effects(plan)[name]["reason"] == TOGETHER
    return is_taken_back and left_out(plan, shares) + share > plan["plan"]["share_min"]


def wrong_decisions(plan: dict[str, Any], shares: dict[str, Any]) -> list[str]:
    """Decisions of a plan that its shares, twice above or below the least, contradict."""
    least = plan["plan"]["share_min"]
    wrong = []
    for name, effect in effects(plan).items():
        if name not in shares:
            continue
        measured, share = effect["share"], shares[name]
        if name in COUNTS:
            # Beyond the count nothing large is left, and one step less would leave too much.
            count = effect["count"]
            rest = dict(zip(BOUNCES, share, strict=True))
            left = rest.get(count)
            if left is not None and left > CLEAR * least:
                wrong.append(f"{name}: {count} leave {left:.2%}")
            fewer = [known for known in BOUNCES if known < count]
            one_less = rest[fewer[-1]] if fewer else least
            if one_less < least / CLEAR and not taken_back_rightly(plan, name, one_less, shares):
                wrong.append(f"{name}: {count}, {fewer[-1]} leave but {rest[fewer[-1]]:.2%}")
        elif share > CLEAR * least and not effect["simulated"]:
            wrong.append(f"{name}: skipped, has {share:.2%}, predicted {measured}")
        elif share < least / CLEAR and effect["simulated"]:
            if not taken_back_rightly(plan, name, share, shares):
                wrong.append(f"{name}: simulated, has {share:.2%}, predicted {measured}")
    return wrong


def left_out(plan: dict[str, Any], shares: dict[str, Any]) -> float:
    """Measured shares of what a plan leaves out; of light that scatters the larger account, by
    orders or by where it comes from, since each counts the other's."""
    found = effects(plan)
    rest = {
        name: 0.0 if found[name]["simulated"] else share
        for name, share in shares.items()
        if name not in COUNTS
    }
    for name in COUNTS:
        # The count of the table that is not larger leaves as much or more.
        steps = [i for i, known in enumerate(BOUNCES) if known <= found[name]["count"]]
        rest[name] = shares[name][steps[-1]]
    orders = sum(rest[name] for name in ORDERS)
    kinds = sum(rest[name] for name in KINDS)
    return max(orders, kinds) + sum(v for k, v in rest.items() if k not in {*ORDERS, *KINDS})


@pytest.mark.parametrize("name", MEASURED)
def test_decisions_are_right(name: str) -> None:
    for accuracy in (0.0, 0.03, 0.1):
        plan = explain(BY_NAME[name], accuracy=accuracy)
        assert not wrong_decisions(plan, MEASURED[name]), accuracy


def test_the_cheaper_choice_is_taken() -> None:
    """Where light is strewn by a bumpy wall its reflections cost most of a render: they are left
    out though they alone would show, and reflections on the camera's side, which cost little, are
    followed farther for it. With beads these are kept though they would not show, for the noise
    that would have to take their place."""
    at = {"accuracy": 0.05, "width": 64, "height": 64}
    light, camera = "light-side internal reflection", "camera-side internal reflection"
    plan = explain(BY_NAME["bumpy resin"], **at)
    bumpy, least = effects(plan), plan["plan"]["share_min"]
    assert bumpy[light]["count"] == 0 and bumpy[light]["reason"].startswith("it would cost more")
    assert least < bumpy[light]["share"]["value"] < 1.2 * least
    assert bumpy[camera]["count"] > 1 and bumpy[camera]["reason"] == TOGETHER
    plan = explain(BY_NAME["beads"], **at)
    beads, least = effects(plan), plan["plan"]["share_min"]
    assert beads[camera]["count"] == 1
    assert beads[camera]["reason"] == "to leave it out would cost more in noise"
    assert 0.7 * least < beads[camera]["share"]["value"] < 0.75 * least


def test_what_is_left_out_fits_the_target() -> None:
    """In 95 of 100 plans at least; accuracy 0 counts as 1 %."""
    fits = []
    for name, shares in MEASURED.items():
        for accuracy in (0.01, 0.03, 0.1):
            if shares:
                omitted = left_out(explain(BY_NAME[name], accuracy=accuracy), shares)
                fits.append(omitted <= accuracy)
    assert sum(fits) >= 0.95 * len(fits), f"{sum(fits)} of {len(fits)}"


def test_there_are_scenes_enough() -> None:
    assert len(MEASURED) == len(SCENES) >= 24


def test_nothing_costs_nothing() -> None:
    """Scenes without a medium, a reflecting boundary or a lamp that reaches a medium."""
    nothing = effects(explain(BY_NAME["nothing at all"]))
    assert not any(effect["simulated"] for effect in nothing.values())
    assert explain(BY_NAME["nothing at all"])["plan"]["probes"] == 0
    glass = effects(explain(BY_NAME["clear glass"]))
    assert not any(glass[name]["simulated"] for name in (*ORDERS, *KINDS))
    matched = effects(explain(BY_NAME["matched, white"]))
    assert not any(matched[name]["simulated"] for name in (*COUNTS, "surface reflection"))
    away = effects(explain(BY_NAME["lamp turned away"]))
    assert not away["light-side internal reflection"]["simulated"]


def test_a_lamp_that_lights_nothing_builds_no_field() -> None:
    """Light in media is of the surroundings alone then, or there is none."""
    scene = BY_NAME["lamp turned away"]
    settings = {"samples": 1, "effects_are_auto": 1}
    (image,), report = render_passes(scene, 16, **settings)
    assert report["light"]["rays"] == report["light"]["tubes"] == 0
    assert report["estimator_reason"] == "no lamp lights an object"
    assert effects(report)["single scattering"]["simulated"] and image.max() > 0
    _, report = render_passes(replace(scene, world=0.0), 16, **settings)
    for name in ORDERS:
        assert effects(report)[name]["reason"] == "no lamp lights an object"
    # One that sees the object by an edge of its cone does.
    aside = replace(scene, lamps=(spot((3.0, 0.0, 2.0), (-2.0, 0.0, -2.5)),))
    _, report = render_passes(aside, 16, **settings)
    assert report["light"]["rays"] + report["light"]["tubes"] > 0


def test_low_albedo_stops_at_the_first_order() -> None:
    dark = effects(explain(BY_NAME["ink"], accuracy=0.03))
    assert not dark["double scattering"]["simulated"]
    assert not dark["multiple scattering"]["simulated"]


def test_an_object_without_influence_is_not_traced() -> None:
    plan = explain(BY_NAME["one behind the camera"])
    single = effects(plan)["single scattering"]
    assert not single["simulated"]
    beads = effects(explain(BY_NAME["beads"]))["single scattering"]
    assert beads["simulated"] and any(item["simulated"] for item in beads["objects"])


def test_by_hand_the_switches_win() -> None:
    """Also where a share is small; it is told all the same."""
    plan = explain(BY_NAME["ink"], effects_are_auto=0, samples=64, light_bounces=3)
    found = effects(plan)
    assert all(found[name]["simulated"] for name in ORDERS)
    assert found["light-side internal reflection"]["count"] == 3
    assert found["camera-side internal reflection"]["reason"] == "0 bounces set"
    assert found["single scattering"]["share"] is not None


def test_threads_do_not_matter() -> None:
    plans = [explain(BY_NAME["resin on a floor"], threads=threads) for threads in (1, 3)]
    for plan in plans:
        del plan["plan"]["cpu_s"]
    assert plans[0] == plans[1]


def test_a_render_does_as_its_plan_says() -> None:
    scene = BY_NAME["matched, dark"]
    settings = {"samples": 4, "effects_are_auto": 1, "light_samples": 4096}
    plan = explain(scene, **settings)
    (combined, *orders), report = render_passes(
        scene, SIZE, ("Combined", *ORDERS.values()), **settings
    )
    del plan["plan"]["cpu_s"], report["plan"]["cpu_s"]
    measured = {effect["name"]: effect.pop("measured") for effect in report["effects"]}
    assert {effect.pop("measured") for effect in plan["effects"]} == {None}
    # A plan has cost nothing yet.
    assert not {effect.pop("cpu_s") for effect in plan["effects"]} - {None, 0}
    for effect in report["effects"]:
        del effect["cpu_s"]
    for effect in [*plan["effects"], *report["effects"]]:
        for seen in effect["objects"]:
            seen.pop("camera_cpu_s", None)
    assert report["plan"] == plan["plan"] and report["effects"] == plan["effects"]
    single = orders[0][object_mask(scene, SIZE)]
    radiance = combined[object_mask(scene, SIZE)].mean()
    assert measured["single scattering"] == pytest.approx(
        np.sqrt(np.mean(single**2)) / radiance, rel=0.1
    )
    assert measured["multiple scattering"] is None and measured["surface reflection"] is None
    assert combined.mean() > 0
    for name, image in zip(ORDERS, orders, strict=True):
        assert (image.mean() > 0) == effects(plan)[name]["simulated"]


@pytest.mark.parametrize(
    "name", ["resin in the dark", "wax", "matched, dark", "dim amber", "coloured glass", "sun"]
)
def test_finished_pictures_meet_the_target(name: str) -> None:
    """With what was left out, noise and light field. All scenes, and finer:
    tests/bench/bench_planner.py --finished."""
    scene, target, common = BY_NAME[name], 0.08, {"light_samples": 2**15}
    known = truth(scene, 16, samples=16, kernel_size=2.0, **common)
    (image,), report = render_passes(scene, 16, effects_are_auto=1, accuracy=target, **common)
    assert report["accuracy"]["stated"] <= target
    assert known.error(image) < 1.25 * target


def test_noise_of_silhouettes_is_not_understated() -> None:
    """A black sphere before a bright world: pixels at its edge have all the noise, and those whose
    halves agree by chance must get as many samples as the others do."""
    scene, size, target, seeds = BY_NAME["ink"], 32, 0.05, 24
    common: dict[str, Any] = {"threads": 1, "light_samples": 2**16}
    known = truth(scene, size, samples=256, **common)
    true, stated = [], []
    for seed in range(seeds):
        (image,), report = render_passes(
            scene, size, effects_are_auto=1, accuracy=target, seed=seed, **common
        )
        true.append(known.error(image))
        stated.append(report["accuracy"]["stated"])
    assert np.mean(np.square(true)) < 1.25 * np.mean(np.square(stated)), (true, stated)
    assert np.mean(np.array(true) <= target) >= 0.75, true


def test_later_orders_are_more_than_few_walks_find() -> None:
    """Of a thin medium's third scattering few walks know, and all they missed is not absent."""
    scene = BY_NAME["less than outside"]
    known = MEASURED[scene.name]["multiple scattering"]
    for seed in range(6):
        plan = explain(
            scene, width=32, height=32, accuracy=0.05, light_samples=2**16, seed=seed, samples=1
        )
        assert effects(plan)["multiple scattering"]["share"]["value"] > 0.4 * known, seed


def test_a_camera_in_a_medium_sees_what_it_scatters() -> None:
    """Fog around the camera, in an even world: light that leaves it never met its boundary."""
    fog = Body(sigma_s=0.4, ior=1.0, mesh=cube, size=10.0)
    scene = PlannerScene("in fog", (fog,), (), world=1.0)
    surroundings = effects(explain(scene))["light of the surroundings in media"]
    assert surroundings["share"]["low"] > 0.5, surroundings
    (image,), _ = render_passes(scene, 16, effects_are_auto=1, samples=16)
    assert image.mean() == pytest.approx(1.0, abs=0.03)


def test_a_camera_in_a_medium_sees_walls_through_it() -> None:
    """A closed room in fog that is larger: every ray meets a wall first."""
    fog = Body(sigma_s=0.4, ior=1.0, mesh=cube, size=10.0)

    class Room(PlannerScene):
        def build(self, scene: handles.Scene) -> None:
            super().build(scene)
            grey = scene.add_material("walls", albedo=rgb(0.5))
            add_mesh(scene, "walls", cube(), grey, (0.0, 0.0, 0.0), 9.0)

    room = Room("room in fog", (fog,), (point((0.0, 0.0, 2.0)),))
    (image,), report = render_passes(
        room, 16, names=("Single Scattering",), effects_are_auto=1, samples=4
    )
    assert effects(report)["single scattering"]["simulated"] and image.mean() > 0


def tumbler() -> Mesh:
    """A drinking glass of flat faces: a closed profile, turned about z."""
    profile = np.array(
        [(0.0, -0.9), (0.8, -0.9), (0.85, 0.9), (0.77, 0.9), (0.72, -0.6), (0.0, -0.55)]
    )
    around = 48
    angles = 2 * np.pi * np.arange(around) / around
    rings = [
        np.stack([r * np.cos(angles), r * np.sin(angles), np.full(around, z)], axis=1)
        for r, z in profile[1:-1]
    ]
    points = np.concatenate([*rings, [(0.0, 0.0, profile[0, 1]), (0.0, 0.0, profile[-1, 1])]])
    below, within = len(points) - 2, len(points) - 1
    last = (len(rings) - 1) * around
    faces = []
    for i in range(around):
        j = (i + 1) % around
        faces += [(below, j, i), (within, last + i, last + j)]
        for ring in range(len(rings) - 1):
            a, b = ring * around, (ring + 1) * around
            faces += [(a + i, a + j, b + j), (a + i, b + j, b + i)]
    return Mesh(points, np.array(faces, np.uint32))


def test_light_goes_round_in_a_glass() -> None:
    """A clear tumbler in an even world: light that its walls have reflected dozens of times is a
    part of the picture, of the rim most of all, and all of it together is 1."""
    scene = PlannerScene("tumbler", (Body(mesh=tumbler),), (), world=1.0)
    (image,), report = render_passes(scene, 32, effects_are_auto=1, samples=64)
    assert effects(report)["camera-side internal reflection"]["count"] > 16
    assert image.mean() == pytest.approx(1.0, abs=2e-3)
    assert image.min() > 0.9
