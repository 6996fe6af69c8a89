"""What ``margin --json`` says of one attack."""

from __future__ import annotations

import pytest

from advdiff_sumo.experiments.margin import BRAKING, Margin, Trial
from advdiff_sumo.experiments.margin_trials import MarginOf

FAILS, PASSES = Trial(2.75, failed=True, met=True), Trial(2.5, failed=False, met=True)
NOBODY = Trial(8.5, failed=False, met=False)


@pytest.mark.parametrize(
    ("margin", "failing", "passing", "why"),
    [
        (Margin(PASSES, FAILS, ()), 2.75, 2.5, "copes with hard-stop at braking of 2.5 m/s² and fails at"),
        (Margin(PASSES, None, ()), None, 2.5, "copes with hard-stop up to the severest"),
        (Margin(None, FAILS, ()), 2.75, None, "fails at the mildest hard-stop already"),
        (Margin(NOBODY, None, ()), None, None, "nobody was in a position for hard-stop"),
    ],
)
def test_by_hand(margin: Margin, failing: float | None, passing: float | None, why: str) -> None:
    summary = MarginOf("hard-stop", BRAKING, margin).summary()
    assert summary.pop("why").startswith(why)
    assert summary == {
        "attack": "hard-stop",
        "parameter": "braking",
        "unit": "m/s²",
        "failing": failing,
        "passing": passing,
    }
