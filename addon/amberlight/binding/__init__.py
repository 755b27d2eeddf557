# SPDX-License-Identifier: GPL-3.0-or-later
"""The C library seen from Python: no Blender, no rendering, one pointer per object."""
