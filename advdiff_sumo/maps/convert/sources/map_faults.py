"""What is wrong with a map: counted by kind, with a sentence for each fault of it, 20 of a kind at most."""

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
        """Return the sentences of each kind, the first ones and how many more there are."""
        sentences_told: list[str] = []
        for kind, own in self._sentences.items():
            sentences_told += own[:MOST_SENTENCES]
            if len(own) > MOST_SENTENCES:
                sentences_told.append(f"{self._file}: {kind}: {len(own) - MOST_SENTENCES} more")
        return tuple(sentences_told)
