# SPDX-License-Identifier: GPL-3.0-or-later
"""What every source text has in common."""

import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from sources import ROOT, files, name

SCRIPTS = [ROOT / "amberlight", ROOT / ".ci" / "run"]
CODE = files(".c", ".h", ".py", ".sh") + SCRIPTS
TEXTS = CODE + files(".md", ".txt", ".toml", ".json", ".cmake")


def lines(paths: list[Path]) -> Iterator[tuple[str, str]]:
    """("file:number", text) of every line."""
    for path in paths:
        for number, line in enumerate(path.read_text(encoding="utf-8").split("\n"), 1):
            yield f"{name(path)}:{number}", line


def test_licence_is_named_at_the_top() -> None:
    licence = "SPDX-License-Identifier: GPL-3.0-or-later"
    heads = {name(path): "".join(path.read_text().splitlines(True)[:2]) for path in CODE}
    assert not [path for path, head in heads.items() if licence not in head]


def test_no_note_to_self() -> None:
    """An open question is an issue, not a comment."""
    words = "|".join(["TO" + "DO", "FIX" + "ME", "X" * 3])
    assert not [place for place, line in lines(CODE) if re.search(rf"\b(?:{words})\b", line)]


def test_white_space() -> None:
    assert not [place for place, line in lines(TEXTS) if "\t" in line or line != line.rstrip()]


def test_last_line() -> None:
    ends = {name(path): path.read_text()[-2:] for path in TEXTS}
    assert not [path for path, end in ends.items() if end and (end[-1] != "\n" or end == "\n\n")]


def test_line_length() -> None:
    assert not [place for place, line in lines(CODE) if len(line) > 100]


def test_clang_format() -> None:
    # The formatter's opinion changes between versions: 14 is Debian 12's, and ours.
    program = shutil.which("clang-format-14") or shutil.which("clang-format")
    if program is None or " 14." not in subprocess.check_output([program, "--version"], text=True):
        pytest.skip("no clang-format 14")
    sources = [str(path) for path in files(".c", ".h")]
    command = [program, "--dry-run", "--Werror", *sources]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr[:4000]


def test_committed_files_are_small() -> None:
    """Generated pictures and scenes live in the repository only when they are small."""
    binary = files(".blend", ".png", ".jpg", ".exr", ".npy")
    assert not [name(path) for path in binary if path.stat().st_size > 1_000_000]
