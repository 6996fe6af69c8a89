"""The panels of a film strip: how many there may be, and the moment that each shows."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import ConfigError

MOST_PANELS = 8


def moments_of_panels(panels: int, start_s: float, end_s: float) -> FloatArray:
    """Return *panels* moments, evenly spaced up to *end_s*; the first is *start_s* unless there is one alone.

    Raises:
        ConfigError: the number of panels is not from 1 to ``MOST_PANELS``.
    """
    if not 1 <= panels <= MOST_PANELS:
        raise ConfigError(f"panels={panels}: give a number from 1 to {MOST_PANELS}")
    return np.linspace(start_s, end_s, max(panels, 2))[-panels:]
