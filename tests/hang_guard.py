"""How long a test waits for another process before it takes it for hung; no test may fail because a machine is busy."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

#: Many times what the slowest of them takes on a machine at rest.
HANG_S = 3600.0


def with_time(attempt: Callable[[float], T | None], limit_s: float) -> T:
    """Return what *attempt* returns under a time limit that only what hangs may miss.

    It returns None where something else missed it, since the machine is busy, and is tried with twice the limit.
    """
    while (outcome := attempt(limit_s)) is None:
        limit_s *= 2.0
        assert limit_s < HANG_S, "what is healthy never came to its end"
    return outcome
