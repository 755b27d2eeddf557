# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of the hard cases, and the import path: their scenes are built by tests/images."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
for folder in (HERE, HERE.parent / "images"):
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--record", action="store_true", help="write docs/stability.md")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--record"):
        # The document is written after the run, and held against the tables by the next.
        items[:] = [item for item in items if "document" not in item.name]


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    import hard

    if session.config.getoption("--record") and exitstatus == 0:
        hard.write_document(hard.update_results())
