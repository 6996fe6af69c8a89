"""How many examples a costly property is tried on."""

from __future__ import annotations

from hypothesis import settings


def examples(ci: int, desk: int) -> int:
    """Return *ci* where examples are the same every time, so that more of them find nothing new, and else *desk*."""
    return ci if settings().derandomize else desk
