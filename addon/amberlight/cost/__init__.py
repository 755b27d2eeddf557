# SPDX-License-Identifier: GPL-3.0-or-later
"""What accuracy costs in one scene: every estimator at a sweep of budgets against a reference.

    session.py     one measurement, step by step   tables.py   cost.csv, cost.md
    scenes.py      the scene in the library        plots.py    cost.png, with matplotlib
    bench.py       renders, rows, images, time     exr.py      OpenEXR files, read and written
    sweep.py       what is rendered, in order      output.py   all files of a measurement
    rows.py        what one setting gave           curve.py    fronts, equal time, equal error
    metrics.py     errors of images                references.py  images from elsewhere

No Blender, and numpy at the top: import it only when something is to be measured.
"""
