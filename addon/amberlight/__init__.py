# SPDX-License-Identifier: GPL-3.0-or-later
"""Amberlight: a render engine for translucent objects.

Blender is imported only when the add-on is registered, so that everything below that needs no
Blender can be tested without one.
"""

from __future__ import annotations

bl_info = {
    "name": "Amberlight",
    "description": "Render engine for translucent objects: resin, amber, jade, wax, oil in glass",
    "author": "The Amberlight authors",
    "version": (0, 1, 0),
    "blender": (3, 4, 0),
    "location": "Render properties > Render Engine",
    "category": "Render",
}

# Registered in this order, unregistered in the reverse one.
MODULES = (
    "properties", "properties_cost", "operators", "operators_cost", "operators_world", "engine",
    "world_bake", "ui", "ui_cost",
)  # fmt: skip


def _modules() -> list:  # type: ignore[type-arg]
    from importlib import import_module

    return [import_module(f".{name}", __package__) for name in MODULES]


def register() -> None:
    for module in _modules():
        module.register()


def unregister() -> None:
    for module in reversed(_modules()):
        module.unregister()
