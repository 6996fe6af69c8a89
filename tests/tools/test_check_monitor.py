"""Why our safe distance and the monitor's disagree, on values worked by hand."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

from check_monitor import ACROSS, CLOSE, OTHER, TOUCHING, why_apart


@pytest.mark.parametrize(
    ("spare_m", "gap_m", "why"),
    [
        ([np.nan], [np.nan], ACROSS),
        ([-20.7], [0.1], TOUCHING),
        ([np.nan, -0.4], [np.nan, 12.0], CLOSE),
        ([0.3], [8.0], CLOSE),
        ([-3.0], [6.0], OTHER),
    ],
)
def test_why_two_judges_disagree_on_the_safe_distance(
    spare_m: list[float], gap_m: list[float], why: str
) -> None:
    assert why_apart(np.array(spare_m), np.array(gap_m)) == why
