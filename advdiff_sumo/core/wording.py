"""Build parts of sentences: counts and lists."""

from __future__ import annotations

from collections.abc import Sequence


def counted(count: int, noun: str) -> str:
    """Return *count* with *noun* in the singular or plural: "1 finding", "3 findings", "3 near misses"."""
    ending = "es" if noun.endswith(("s", "x", "ch", "sh")) else "s"
    return f"{count} {noun}" if count == 1 else f"{count} {noun}{ending}"


def in_series(words: Sequence[str]) -> str:
    """Return *words*, at least one, as a list in a sentence: "a", "a and b", "a, b and c"."""
    *first, last = words
    return f"{', '.join(first)} and {last}" if first else last
