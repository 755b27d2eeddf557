# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders random scenes in Blender: none may end it, none may have a value that is not finite, and
each gives a picture or one clear error. A process ends with the first scene that ends it, and the
next one goes on after that.

    random_scenes.py [--count 2000] [--first 0]     a scene is a function of its number
    random_scenes.py --count 1 --first 1234 --verbose
"""

import argparse
import functools
import importlib.util
import os
import resource
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
BLENDER = os.environ.get("AMBERLIGHT_BLENDER", "blender")
# A scene may take this many CPU seconds, Blender's modifiers and all; most take less than 0.1.
# Above SLOW in the renderer it is named.
CPU_LIMIT = 60
SLOW = 2.0
# Scenes to a process: what a scene leaves behind in Blender is not ours to bound.
SCENES_PER_PROCESS = 100
PICTURE, REFUSED, FAILED, SLOWLY = "picture", "refused", "failed", "slow"
# Blender itself ended or did not come back while it made the scene, before anything of ours ran.
BUILT, BLENDERS = "built", "blender's own"


# ---- Outside Blender -----------------------------------------------------------------------------


def scripts_folder(folder):
    """A folder of scripts that holds the add-on of this checkout."""
    (folder / "addons").mkdir()
    (folder / "addons" / "amberlight").symlink_to(ROOT / "addon" / "amberlight")
    return folder


def run(first, count, say=print, verbose=False):
    """Counter of outcomes; what there is to say of defects and slow scenes goes to `say`."""
    outcomes = Counter()
    with tempfile.TemporaryDirectory() as name:
        scripts = scripts_folder(Path(name))
        environment = {**os.environ, "BLENDER_USER_SCRIPTS": str(scripts), "TMPDIR": name}
        journal, output = Path(name, "journal"), Path(name, "output")
        at = first
        while at < first + count:
            end = min(at + SCENES_PER_PROCESS, first + count)
            command = [BLENDER, "-b", "--factory-startup", "--addons", "amberlight"]
            command += ["--python", __file__, "--", str(journal), str(at), str(end)]
            journal.write_text("")
            with output.open("w") as file:
                process = subprocess.run(
                    command, env=environment, cwd=name, stdout=file, stderr=subprocess.STDOUT
                )
            done, is_built = at, False
            for line in journal.read_text().splitlines():
                _, what, _ = line.split(" ", 2)
                is_built = what == BUILT
                if is_built:
                    continue
                outcomes[what] += 1
                done += what != SLOWLY
                if what in {FAILED, SLOWLY} or verbose:
                    say(line)
            if verbose:
                say(output.read_text(errors="replace"))
            if done < end and not is_built and process.returncode >= 0:
                # No signal ended it: nothing of ours could even start.
                tail = output.read_text(errors="replace")[-3000:]
                raise RuntimeError(f"{BLENDER} did not come to scene {done}: {tail}")
            if done < end:
                outcomes[FAILED if is_built else BLENDERS] += 1
                tail = output.read_text(errors="replace")[-3000:] if is_built else "by itself"
                say(f"{done} ended Blender ({process.returncode}): {tail}")
                done += 1
            at = done
    return outcomes


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args()
    say = functools.partial(print, flush=True)
    outcomes = run(options.first, options.count, say, options.verbose)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(
        f"{options.count} scenes: {outcomes[PICTURE]} pictures, {outcomes[REFUSED]} refused, "
        f"{outcomes[FAILED]} failed, {outcomes[SLOWLY]} slow, {outcomes[BLENDERS]} ended Blender "
        "before the render; "
        f"{(used.ru_utime + used.ru_stime) / options.count:.2f} CPU s each"
    )
    return outcomes[FAILED] > 0


# ---- In Blender ----------------------------------------------------------------------------------


def watch(problems, seconds):
    """Every array of pixels that goes to Blender passes by here, and every render."""
    import numpy as np
    from amberlight import engine

    write, render = engine.write_pixels, engine.AmberlightRenderEngine.render

    def write_checked(target, pixels):
        if not np.isfinite(pixels).all():
            problems.append(f"pass {target.name} has values that are not finite")
        write(target, pixels)

    def render_timed(self, depsgraph):
        begin = time.process_time()
        render(self, depsgraph)
        seconds.append(time.process_time() - begin)

    engine.write_pixels = write_checked
    engine.AmberlightRenderEngine.render = render_timed


def render_scene(number, problems, journal):
    """Outcome and what there is to say of it."""
    import bpy
    from amberlight import report
    from random_scene import RandomScene

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    problems.clear()
    report.LAST.clear()
    RandomScene(number).fill()
    bpy.context.evaluated_depsgraph_get()
    journal.write(f"{number} {BUILT} \n")
    outcome, said = PICTURE, ""
    try:
        bpy.ops.render.render()
    except RuntimeError as error:
        outcome, said = REFUSED, str(error).strip()
        texts = {line for line in said.splitlines() if line.startswith("Error: ")}
        # Each view layer says it again.
        if len(texts) != 1 or "internal error" in said:
            problems.append("no clear error")
    else:
        if scene.name not in report.LAST:
            problems.append("neither a picture nor an error")
    for summary in report.LAST.values():
        problems.extend(line for line in summary.warnings if "were not finite" in line)
    if problems:
        outcome, said = FAILED, "; ".join([*problems, said])
    return outcome, " | ".join(said.splitlines())


def inside(path, first, end):
    sys.path.insert(0, str(HERE))
    problems, seconds = [], []
    watch(problems, seconds)
    # Blender's own output is buffered elsewhere and would tear these lines.
    with Path(path).open("a", encoding="utf-8", buffering=1) as journal:
        for number in range(first, end):
            print(f"Scene {number}", flush=True)
            seconds.clear()
            limit = int(time.process_time()) + CPU_LIMIT
            resource.setrlimit(resource.RLIMIT_CPU, (limit, resource.RLIM_INFINITY))
            try:
                outcome, said = render_scene(number, problems, journal)
            except Exception:
                outcome, said = FAILED, traceback.format_exc().replace("\n", " | ")
            if sum(seconds) > SLOW:
                journal.write(f"{number} {SLOWLY} {sum(seconds):.1f} CPU s\n")
            journal.write(f"{number} {outcome} {said}\n")


if __name__ == "__main__":
    if importlib.util.find_spec("bpy"):
        path, first, end = sys.argv[sys.argv.index("--") + 1 :]
        inside(path, int(first), int(end))
        sys.stdout.flush()
        os._exit(0)
    sys.exit(main())
