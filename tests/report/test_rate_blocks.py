"""Rates and intervals against values worked out by hand."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from advdiff_sumo.report.rate_blocks import Rate, headline, wilson

Z2 = 1.959963984540054**2


def test_wilson_at_the_ends() -> None:
    # p = 0: centre and half width are both z²/2 / (n + z²); p = 1 mirrors it
    assert wilson(0, 10) == pytest.approx((0.0, Z2 / (10 + Z2)), abs=1e-9)
    assert wilson(10, 10) == pytest.approx((10 / (10 + Z2), 1.0), abs=1e-9)


def test_wilson_in_the_middle() -> None:
    # p = 1/2, n = 4: centre 1/2, half width z/(n + z²) · sqrt(n/4 + z²/4) = z / (2 sqrt(n + z²))
    half = 0.5 * (Z2 / (4 + Z2)) ** 0.5
    assert wilson(2, 4) == pytest.approx((0.5 - half, 0.5 + half), abs=1e-9)


def test_no_sample_has_no_interval() -> None:
    assert wilson(0, 0) == (None, None)
    assert Rate.of_flags("x", "y", []).share is None


@given(st.integers(1, 300).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_interval_holds_the_share_and_mirrors(sample: tuple[int, int]) -> None:
    count, n = sample
    low, high = wilson(count, n)
    mirrored_low, mirrored_high = wilson(n - count, n)
    assert low is not None
    assert high is not None
    assert mirrored_low is not None
    assert mirrored_high is not None
    assert 0.0 <= low <= count / n + 1e-12
    assert count / n - 1e-12 <= high <= 1.0
    assert (low, high) == pytest.approx((1.0 - mirrored_high, 1.0 - mirrored_low), abs=1e-9)


def test_headline_counts(rows: Any) -> None:
    episodes = [
        rows.struck(0, attacker_visible=True, valid_failure=True, critical=False),
        rows.struck(1, at_fault="other", attacker_visible=False, valid_failure=False, critical=False),
        rows.struck(2, at_fault="unclear"),
        rows.episode(3, route_completed=True, valid_failure=False, critical=True),
        rows.episode(4, end="failed", failure_kind="plan_refused"),
    ]
    counts = {rate.label: (rate.count, rate.n) for rate in headline(episodes)}
    assert counts == {
        "Valid failures": (1, 3),
        "Critical near misses": (1, 3),
        "Collisions": (3, 4),
        "Collisions, target at fault": (1, 4),
        "Attacker was visible": (1, 2),
        "Route completed": (1, 4),
        "Failures": (1, 5),
    }
