# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender scene -> plain data -> library. Only extract*.py know Blender."""
