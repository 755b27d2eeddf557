# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of clamps speaks of the code as it is."""

import re

from sources import ROOT

ROW = re.compile(r"^\|.*?\| `(\S+\.[ch])`: `([^`]+)` \|", re.MULTILINE)


def test_clamps_stand_where_the_table_has_them() -> None:
    rows = ROW.findall((ROOT / "docs" / "clamps.md").read_text())
    assert len(rows) > 40
    source = ROOT / "native" / "src"
    assert not [row for row in rows if row[1] not in (source / row[0]).read_text()]
