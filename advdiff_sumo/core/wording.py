"""Sentences out of parts."""

from __future__ import annotations

from collections.abc import Sequence


def in_series(words: Sequence[str]) -> str:
    """Return *words*, one at least, as a sentence lists them: "a", "a and b", "a, b and c"."""
    *first, last = words
    return f"{', '.join(first)} and {last}" if first else last
