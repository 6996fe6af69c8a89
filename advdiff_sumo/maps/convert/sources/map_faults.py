"""Collect the faults of a map: a count of each kind, and a sentence for each fault (at most 20 of a kind)."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

MOST_SENTENCES = 20


class MapFaults:
    """Faults of one file; *notes* counts them by kind."""

    def __init__(self, path: Path) -> None:
        self._file = path.name
        self.notes: Counter[str] = Counter()
        self._sentences: dict[str, list[str]] = {}

    def add(self, kind: str, sentence: str) -> None:
        """Count a fault of *kind* and keep its sentence."""
        self.notes[kind] += 1
        self._sentences.setdefault(kind, []).append(f"{self._file}: {sentence}")

    def sentences(self) -> tuple[str, ...]:
        """Return the first sentences of each kind, and for each kind how many more there are."""
        shown: list[str] = []
        for kind, of_kind in self._sentences.items():
            shown += of_kind[:MOST_SENTENCES]
            if len(of_kind) > MOST_SENTENCES:
                shown.append(f"{self._file}: {kind}: {len(of_kind) - MOST_SENTENCES} more")
        return tuple(shown)
