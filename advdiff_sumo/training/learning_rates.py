"""Learning rate as a pure function of the step, so that checkpoints need no state of it.

PyTorch's schedulers have a state that a checkpoint would have to hold, and ``OneCycleLR`` refuses steps beyond its
total. With a function, resuming and changing the length of a training need no special cases.
"""

from __future__ import annotations

import math
from typing import Literal

ScheduleName = Literal["constant", "cosine", "one-cycle"]

_START_SHARE, _END_SHARE = 0.04, 0.002


def rate_factor(name: ScheduleName, step: int, total: int, warmup_share: float = 0.1) -> float:
    """Return the factor of the learning rate at *step* of *total*.

    Args:
        name: "constant"; "cosine": from 1 down to 0.002 along half a cosine; "one-cycle": up from 0.04 to 1
            over the first *warmup_share* of all steps, then down as "cosine" (Smith and Topin, 2019,
            doi:10.1117/12.2520589).
        step: steps done, from 0.
        total: all steps of the training.
        warmup_share: share of the steps in which the rate rises.
    """
    if name == "constant":
        return 1.0
    done = min(step / max(total, 1), 1.0)
    up = warmup_share if name == "one-cycle" else 0.0
    if done < up:
        return _blend(_START_SHARE, 1.0, done / up)
    return _blend(1.0, _END_SHARE, (done - up) / (1.0 - up))


def _blend(start: float, end: float, share: float) -> float:
    return end + (start - end) * 0.5 * (1.0 + math.cos(math.pi * share))
