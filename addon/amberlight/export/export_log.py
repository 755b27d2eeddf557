# SPDX-License-Identifier: GPL-3.0-or-later
"""What an export could not follow exactly: one entry a message, with everything it concerns."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class ExportLog:
    """Collects messages; `entries`: message -> the things it was said about, in order."""

    entries: dict[str, list[str]] = field(default_factory=dict)

    def warn(self, where: str, message: str) -> None:
        """`where`: what it concerns, e.g. 'object "Cube"'; the same pair is kept once."""
        places = self.entries.setdefault(message, [])
        if where not in places:
            places.append(where)

    def lines(self) -> list[str]:
        """One line for each message: `message: where, where, ...`."""
        return [
            f"{message}: {', '.join(places)}" if any(places) else message
            for message, places in self.entries.items()
        ]

    def __len__(self) -> int:
        return len(self.entries)
