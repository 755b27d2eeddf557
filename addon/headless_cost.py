# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure what accuracy costs for `./amberlight cost`, which runs this inside Blender.

    blender -b FILE -E AMBERLIGHT --python headless_cost.py -- DIR [SETTING=VALUE ...]

Writes DIR/cost.csv, cost.md, cost.png and the images. A SETTING is a name of scene.amberlight_cost
(time_limit=60), else one that `./amberlight render` knows. Ends Blender with exit code 1 and one
sentence when anything fails.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))
from headless_render import SettingError, apply_setting, setting_names  # noqa: E402

# What the sweep sets in every render.
SWEPT = {"estimator", "light_samples", "kernel_size", "tube_refinement", "accuracy"}
PROGRESS_SECONDS = 2.0


def apply(scene: bpy.types.Scene, setting: str) -> None:
    name = setting.partition("=")[0]
    own = set(setting_names(scene.amberlight_cost)) - {"directory"}
    if name in SWEPT:
        raise SettingError(f"{name}: the sweep sets it; there are {', '.join(sorted(own))}")
    apply_setting(scene, f"scene.amberlight_cost.{setting}" if name in own else setting)


def main(arguments: list[str]) -> None:
    folder, *settings = arguments
    scene = bpy.context.scene
    if not hasattr(scene, "amberlight_cost"):
        raise RuntimeError("the add-on 'amberlight' is not enabled")
    scene.render.engine = "AMBERLIGHT"
    for setting in settings:
        apply(scene, setting)
    measure(scene, Path(folder))


def measure(scene: bpy.types.Scene, folder: Path) -> None:
    from amberlight.binding import library
    from amberlight.engine import export_for_render
    from amberlight.operators_cost import cost_request, scene_name

    exported = export_for_render(scene, bpy.context.view_layer.name)
    request = cost_request(scene, exported, scene_name(scene), folder)
    from amberlight.cost.session import measure as steps_of

    steps = steps_of(library.load(), request)
    said, text = 0.0, ""
    while True:
        try:
            status = next(steps)
        except StopIteration as end:
            outcome = end.value
            break
        now = time.monotonic()
        if status.text != text and now - said >= PROGRESS_SECONDS:
            print(f"{100 * status.fraction:3.0f} % {status.text}", flush=True)
            said, text = now, status.text
    print((folder / "cost.md").read_text(encoding="utf-8"))
    for file in outcome.files:
        print(f"wrote {file}", flush=True)
    if outcome.said:
        print(f"amberlight: {outcome.said}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    try:
        main(sys.argv[sys.argv.index("--") + 1 :])
    except KeyboardInterrupt:
        print("amberlight: cancelled", file=sys.stderr, flush=True)
        sys.exit(1)
    except Exception as error:
        # AmberlightError is known only once the add-on is; a failed script must end Blender.
        message = getattr(error, "message", str(error)).removeprefix("Error: ").rstrip()
        if not isinstance(error, (OSError, RuntimeError, SettingError)) and not hasattr(
            error, "message"
        ):
            raise
        print(f"amberlight: {message}", file=sys.stderr, flush=True)
        sys.exit(1)
