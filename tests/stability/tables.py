# SPDX-License-Identifier: GPL-3.0-or-later
"""All tables, each under its heading of the document. One line adds a table."""

from __future__ import annotations

from dataclasses import replace

import table_continuity
import table_estimators
import table_lights
import table_media
import table_meshes
import table_orders
import table_surfaces

TABLES = {
    "Estimators": table_estimators.CASES,
    "Lamps and cameras": table_lights.CASES,
    "Media": table_media.CASES,
    "Meshes and places": table_meshes.CASES,
    "Later orders": table_orders.CASES,
    "Opaque surfaces": table_surfaces.CASES,
    "Continuity": table_continuity.CASES,
}

CASES = [replace(case, group=group) for group, cases in TABLES.items() for case in cases]
