# SPDX-License-Identifier: GPL-3.0-or-later
"""Run inside Blender: keep what the add-on exports of a .blend, for bench_scenes.py.

./amberlight blender -b FILE.blend --python export_blend.py -- OUT.pickle
"""

from __future__ import annotations

import pickle
import sys
from pathlib import Path

import bpy
from amberlight.engine import export_for_render
from amberlight.render_job import render_params

scene = bpy.context.scene
exported = export_for_render(scene, scene.view_layers[0].name)
kept = (exported.data, render_params(exported.settings, exported.frame))
Path(sys.argv[sys.argv.index("--") + 1]).write_bytes(pickle.dumps(kept))
