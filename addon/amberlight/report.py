# SPDX-License-Identifier: GPL-3.0-or-later
"""The report of a render as lines for people, and the names of the files that it leaves."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any


@dataclass
class Summary:
    """What the panel of the last render shows."""

    lines: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


# Summaries of the last finished renders, by name of the scene: all engines add, the panel reads.
LAST: dict[str, Summary] = {}


def warning_lines(report: dict[str, Any]) -> list[str]:
    """The library's own warnings."""
    return [
        f"{item['text']} ({item['count']} times)" if item.get("count", 1) > 1 else item["text"]
        for item in report.get("warnings", ())
    ]


def summary_lines(report: dict[str, Any]) -> list[str]:
    """What was simulated, what was not and why, seconds by stage, memory. A key that is missing is
    left out: an older or newer library may say less or more."""
    lines = []
    if "width" in report:
        lines.append(
            f"{report['width']}x{report['height']}, {report.get('samples', '?')} samples, "
            f"estimator {report.get('estimator', '?')}"
        )
    lines += accuracy_lines(report.get("accuracy", {}))
    lines += effect_lines(report)
    if "cpu_s" in report.get("plan", {}):
        lines.append(f"choice of effects: {report['plan']['cpu_s']:.2g} CPU s of the scene's")
    for stage in report.get("stages", ()):
        lines.append(f"{stage['name']}: {stage['wall_s']:.2f} s ({stage['cpu_s']:.2f} CPU s)")
    memory = report.get("memory", {})
    parts = [
        f"{key.removesuffix('_bytes').replace('_', ' ')} {value / 2**20:.1f} MiB"
        for key, value in memory.items()
    ]
    if parts:
        lines.append("memory: " + ", ".join(parts))
    light = report.get("light", {})
    if "rays" in light:
        what = f"{light['rays']} rays, {light.get('volume_samples', 0)} volume samples"
        if light.get("tubes"):
            rest = f" of {light.get('tube_bounces', 0)} reflections, the rest by {what}"
            what = f"{light['tubes']} tubes" + (rest if light.get("volume_samples") else "")
        elif light.get("lit_triangles"):
            what = f"{light['lit_triangles']} lit triangles"
        lines.append("light: " + what)
    return lines


def percent(value: float | None) -> str:
    """Two digits, and 140 % as that, not as 1.4e+02 %. None: beyond all numbers."""
    if value is None:
        return "unknown"
    return f"{float(f'{100 * value:.2g}'):g} %"


def share_text(share: dict[str, float] | None) -> str:
    """A predicted share with its bounds, or nothing."""
    if not share:
        return ""
    bounds = f"{percent(share['low'])} to {percent(share['high'])}"
    return f"; share {percent(share['value'])}, {bounds}"


def cost_text(seconds: float | None) -> str:
    return f"; {seconds:.2g} CPU s" if seconds is not None else ""


def effect_lines(report: dict[str, Any]) -> list[str]:
    """Each effect: simulated or skipped, why, its share, its time; and objects that differ from the
    rest, and how the camera's time is divided among several."""
    lines = []
    for effect in report.get("effects", ()):
        name = str(effect["name"]).replace("_", " ")
        done = "simulated" if effect["simulated"] else "skipped"
        if effect.get("count"):
            done += f" up to {effect['count']}"
        reason = f", {effect['reason']}" if effect.get("reason") else ""
        measured = effect.get("measured")
        shown = f"; measured {percent(measured)}" if measured is not None else ""
        cost = cost_text(effect.get("cpu_s"))
        lines.append(f"{name}: {done}{reason}{share_text(effect.get('share'))}{shown}{cost}")
        costs = [
            f"    {item['name']}{cost_text(item['camera_cpu_s'])} by the camera"
            for item in effect.get("objects", ())
            if item.get("camera_cpu_s")
        ]
        lines += costs if len(costs) > 1 else []
        lines += [
            f"    {item['name']}: skipped{share_text(item.get('share'))}"
            for item in effect.get("objects", ())
            if effect["simulated"] and not item["simulated"]
        ]
    return lines


def plan_lines(plan: dict[str, Any]) -> list[str]:
    """A plan that was not rendered."""
    lines = []
    about = plan.get("plan", {})
    if "share_min" in about:
        kind = "by share" if about["automatic"] else "by hand"
        lines.append(
            f"effects chosen {kind}, least share {percent(about['share_min'])}, left out "
            f"{percent(about['omitted'])}, {about['probes']} probes"
        )
    reason = f", {plan['estimator_reason']}" if plan.get("estimator_reason") else ""
    lines.append(f"estimator {plan.get('estimator', '?')}{reason}")
    lines += effect_lines(plan)
    for effect in plan.get("effects", ()):
        shares = [
            f"    {item['name']}{share_text(item.get('share'))}"
            for item in effect.get("objects", ())
            if item.get("share") and item["simulated"]
        ]
        if len(shares) > 1:
            lines += [f"{effect['name']} by object:", *shares]
    return lines


def accuracy_lines(accuracy: dict[str, Any]) -> list[str]:
    """The error that the render states of itself, and what keeps it above its target."""
    parts = [
        f"{name} {percent(accuracy[key])}"
        for key, name in (
            ("noise", "noise"),
            ("field", "light field"),
            ("scatter", "photons"),
            ("caustics", "caustics"),
        )
        if accuracy.get(key) is not None
        and (key not in ("scatter", "caustics") or accuracy[key] > 0)
    ]
    if not parts:
        return []
    if accuracy.get("stated") is None:
        return [f"error: {', '.join(parts)}; of the light field not estimated"]
    line = f"error: {percent(accuracy['stated'])}"
    if accuracy.get("pixels") == "objects and caustics":
        line += " with caustics beside objects"
    if accuracy.get("target"):
        line += f" of {percent(accuracy['target'])}"
    line += f" ({', '.join(parts)})"
    if accuracy.get("reached") is False:
        line += f", target not reached; {accuracy['limit']}"
        if accuracy.get("in_reach") is False:
            line += "; more samples a pixel cannot reach it and were not taken"
    return [line]


def joined_warning(lines: Iterable[str]) -> str:
    """All warnings as the one sentence that Blender shows."""
    lines = list(lines)
    count = f"{len(lines)} remarks" if len(lines) > 1 else "Remark"
    return f"{count}: " + "; ".join(lines)


def output_path(template: str, frame: int, layer_index: int, layer: str) -> str:
    """File name for a view layer and frame: '#'s become the frame's number, as in Blender; the
    first layer keeps the name, later ones get "_layer" before the extension."""

    def number(match: re.Match[str]) -> str:
        return str(frame).zfill(len(match.group()))

    head, slash, tail = template.rpartition("/")
    tail = re.sub("#+", number, tail)
    if layer_index > 0:
        clean = re.sub(r"[^\w.-]", "_", layer)
        stem, dot, extension = tail.rpartition(".")
        tail = f"{stem}_{clean}{dot}{extension}" if dot else f"{tail}_{clean}"
    return head + slash + tail
