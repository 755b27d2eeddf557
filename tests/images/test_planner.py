# SPDX-License-Identifier: GPL-3.0-or-later
"""The planner against shares by brute force (references/planner_shares.json, made by
references/make_planner_shares.py), and what a scene must never be charged for."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from api import handles, library
from planner_scenes import SCENES, PlannerScene
from planner_shares import BOUNCES, COUNTS, EVERYTHING

MEASURED: dict[str, dict[str, Any]] = json.loads(
    (Path(__file__).parent / "references/planner_shares.json").read_text()
)
SIZE = 24
# What a share must be of the least one that is simulated for the decision to be certain.
CLEAR = 2.0
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
            if fewer and rest[fewer[-1]] < least / CLEAR:
                wrong.append(f"{name}: {count}, {fewer[-1]} leave but {rest[fewer[-1]]:.2%}")
        elif share > CLEAR * least and not effect["simulated"]:
            wrong.append(f"{name}: skipped, has {share:.2%}, predicted {measured}")
        elif share < least / CLEAR and effect["simulated"]:
            wrong.append(f"{name}: simulated, has {share:.2%}, predicted {measured}")
    return wrong


@pytest.mark.parametrize("name", MEASURED)
def test_decisions_are_right(name: str) -> None:
    for accuracy in (0.0, 0.03, 0.1):
        plan = explain(BY_NAME[name], accuracy=accuracy)
        assert not wrong_decisions(plan, MEASURED[name]), accuracy


def test_there_are_scenes_enough() -> None:
    assert len(MEASURED) == len(SCENES) >= 24
