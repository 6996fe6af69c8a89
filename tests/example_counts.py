"""Number of examples for tests of costly properties."""

from __future__ import annotations

from hypothesis import settings


def examples(ci: int, desk: int) -> int:
    """Return *ci* if the examples are the same in every run, so that more of them find nothing new; else *desk*."""
    return ci if settings().derandomize else desk
