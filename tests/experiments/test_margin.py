"""Bisection of a severity, worked by hand and for any threshold."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from advdiff_sumo.experiments.margin import Margin, bisect, trials_text


def test_the_neighbours_by_hand() -> None:
    """Between 1 and 9, to 2: 9 fails, 1 passes, 5 fails, 3 passes."""
    found = bisect(lambda severity: severity >= 4.0, within=2.0)
    assert (found.passes_mps2, found.fails_mps2) == (3.0, 5.0)
    assert found.tried == {9.0: True, 1.0: False, 5.0: True, 3.0: False}
    assert found.neighbours == (5.0, 3.0)


@pytest.mark.parametrize(
    ("threshold", "margin"),
    [(10.0, Margin(9.0, None, {9.0: False})), (0.5, Margin(None, 1.0, {9.0: True, 1.0: True}))],
)
def test_nothing_or_all_fails(threshold: float, margin: Margin) -> None:
    assert bisect(lambda severity: severity >= threshold, within=1.0) == margin


@given(threshold=st.floats(1.01, 9.0), within=st.floats(0.1, 3.0))
def test_the_threshold_lies_between_the_neighbours(threshold: float, within: float) -> None:
    found = bisect(lambda severity: severity >= threshold, within)
    assert found.passes_mps2 is not None
    assert found.fails_mps2 is not None
    assert found.passes_mps2 < threshold <= found.fails_mps2
    assert found.fails_mps2 - found.passes_mps2 <= within + 1e-9


def test_trials_are_listed_mildest_first() -> None:
    text = trials_text(Margin(3.0, 5.0, {9.0: True, 1.0: False, 5.0: True, 3.0: False}))
    assert text.splitlines() == ["braking_mps2,valid_failure", "1,false", "3,false", "5,true", "9,true"]
