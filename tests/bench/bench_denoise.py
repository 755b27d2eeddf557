# SPDX-License-Identifier: GPL-3.0-or-later
"""What Blender's Denoise node makes of our pictures, without and with our passes for it. Prints
markdown; never asserts.

    PYTHON tests/bench/bench_denoise.py [--samples 4 16] [--reference 256] [--percent 40] [FILE ...]

PYTHON has the module bpy of a Blender 4 that has the denoiser, as those of PyPI have and Debian's
have not (python3 -m venv DIR; DIR/bin/pip install bpy==4.2.0). Errors are against a render of
another seed with --reference samples: noise of its own is in all of them.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "addon"))

import amberlight  # noqa: E402
from amberlight.cost import exr, metrics  # noqa: E402

SCENES = ("still_life", "caustics")
GUIDES = {"Albedo": "Denoising Albedo", "Normal": "Denoising Normal"}


def build_outputs(folder):
    """A file each for the picture, denoised by itself, and with our passes."""
    tree = bpy.context.scene.node_tree
    tree.nodes.clear()
    layers = tree.nodes.new("CompositorNodeRLayers")
    files = tree.nodes.new("CompositorNodeOutputFile")
    files.base_path = str(folder)
    files.format.file_format, files.format.color_depth = "OPEN_EXR", "32"
    files.file_slots.clear()
    sources = {"as rendered": layers.outputs["Image"]}
    for name, guides in (("denoised", {}), ("with passes", GUIDES)):
        node = tree.nodes.new("CompositorNodeDenoise")
        tree.links.new(layers.outputs["Image"], node.inputs["Image"])
        for socket, source in guides.items():
            tree.links.new(layers.outputs[source], node.inputs[socket])
        sources[name] = node.outputs[0]
    for name, source in sources.items():
        files.file_slots.new(name)
        tree.links.new(source, files.inputs[name])
    tree.links.new(layers.outputs["Image"], tree.nodes.new("CompositorNodeComposite").inputs[0])
    return list(sources)


def render(path, samples, seed, percent):
    """{name: (height, width, 3)}."""
    bpy.ops.wm.open_mainfile(filepath=str(path))
    scene = bpy.context.scene
    scene.render.engine = "AMBERLIGHT"
    scene.render.resolution_percentage = percent
    settings = scene.amberlight
    settings.samples, settings.seed = samples, seed
    settings.report_path = settings.exr_path = ""
    scene.use_nodes = True
    scene.frame_set(1)
    with tempfile.TemporaryDirectory() as name:
        names = build_outputs(Path(name))
        scene.render.filepath = str(Path(name) / "composite")
        bpy.ops.render.render(write_still=True)
        return {key: exr.read_rgb(Path(name) / f"{key}0001.exr", ()) for key in names}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--samples", nargs="+", type=int, default=[4, 16])
    parser.add_argument("--reference", type=int, default=256)
    parser.add_argument("--percent", type=int, default=40)
    options = parser.parse_args()
    amberlight.register()
    print("| scene | samples | | floored_rel | rel_rmse | mean |\n|---|--:|---|--:|--:|--:|")
    for path in options.files or [ROOT / f"scenes_blend/{name}.blend" for name in SCENES]:
        truth = render(path, options.reference, 1000, options.percent)["as rendered"]
        truth = truth.astype(np.float64)
        everywhere = np.ones(truth.shape[:2], bool)
        for samples in options.samples:
            for name, pixels in render(path, samples, 1, options.percent).items():
                image = pixels.astype(np.float64)
                print(
                    f"| {path.stem} | {samples} | {name} "
                    f"| {metrics.floored_rel(image, truth, everywhere):.1%} "
                    f"| {metrics.rel_rmse(image, truth, everywhere):.1%} "
                    f"| {image.mean() / truth.mean():.4f} |",
                    flush=True,
                )
    amberlight.unregister()


if __name__ == "__main__":
    main()
