# SPDX-License-Identifier: GPL-3.0-or-later
"""blender_manifest.toml obeys the limits that Blender enforces only when it installs."""

import tomllib

from sources import ROOT

MANIFEST = tomllib.loads((ROOT / "addon" / "amberlight" / "blender_manifest.toml").read_text())


def test_short_texts() -> None:
    texts = {"tagline": MANIFEST["tagline"], **MANIFEST.get("permissions", {})}
    assert not {key: text for key, text in texts.items() if len(text) > 64 or text.endswith(".")}


def test_required_keys() -> None:
    assert MANIFEST["schema_version"] == "1.0.0"
    assert MANIFEST["id"] == "amberlight"
    assert MANIFEST["type"] == "add-on"
    assert MANIFEST["license"] == ["SPDX:GPL-3.0-or-later"]
