# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the sources are, for the laws; without git, so that an unpacked archive passes too."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ["native", "addon", "tests", "scenes_blend", "docs", ".ci"]


def files(*suffixes: str, under: str | None = None) -> list[Path]:
    """Our own files with one of the suffixes, sorted; nothing that was built."""
    found = [path for path in ROOT.iterdir() if path.is_file()] if under is None else []
    for folder in FOLDERS if under is None else [under]:
        found += (path for path in (ROOT / folder).rglob("*") if path.is_file())
    return sorted(
        path
        for path in found
        if path.suffix in suffixes
        and not {"__pycache__", "lib", "results"} & set(path.relative_to(ROOT).parts)
    )


def name(path: Path) -> str:
    return str(path.relative_to(ROOT))
