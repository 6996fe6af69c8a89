"""Time limits for waiting for other processes; they are long, so that no test fails because a machine is busy."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

#: After this time a process counts as hung; many times the duration of the slowest one on an idle machine.
HANG_S = 3600.0


def with_time(attempt: Callable[[float], T | None], limit_s: float) -> T:
    """Call *attempt* with a time limit, which is doubled until it returns a result, and return the result.

    Args:
        attempt: time limit in s → result; None if a healthy process exceeded the limit because the machine is busy.
        limit_s: first time limit.
    """
    while (outcome := attempt(limit_s)) is None:
        limit_s *= 2.0
        assert limit_s < HANG_S, "what is healthy never came to its end"
    return outcome
