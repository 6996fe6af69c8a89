"""Build parts of sentences: counts and lists."""

from __future__ import annotations

from collections.abc import Sequence

_MAX_RANGES = 6  # in a sentence


def counted(count: int, noun: str) -> str:
    """Return *count* with *noun* in the singular or plural: "1 finding", "3 findings", "3 near misses"."""
    ending = "es" if noun.endswith(("s", "x", "ch", "sh")) else "s"
    return f"{count} {noun}" if count == 1 else f"{count} {noun}{ending}"


def in_series(words: Sequence[str]) -> str:
    """Return *words*, at least one, as a list in a sentence: "a", "a and b", "a, b and c"."""
    *first, last = words
    return f"{', '.join(first)} and {last}" if first else last


def in_ranges(numbers: Sequence[int]) -> str:
    """Return ascending *numbers*, at least one, as ranges in a sentence: "0", "0 to 3, 5 and 7", "50 of 0 to 99"."""
    ranges: list[tuple[int, int]] = []
    for number in numbers:
        is_next = bool(ranges) and number == ranges[-1][1] + 1
        first = ranges.pop()[0] if is_next else number
        ranges.append((first, number))
    if len(ranges) > _MAX_RANGES:
        return f"{len(numbers)} of {numbers[0]} to {numbers[-1]}"
    return in_series([str(first) if first == last else f"{first} to {last}" for first, last in ranges])
