"""Rates and intervals against values worked out by hand."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from advdiff_sumo.metrics.statistics import Rate, mcnemar, mcnemar_more, wilson

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
    empty = Rate.of_flags([])
    assert (empty.low, empty.high, empty.share) == (None, None, None)


@given(st.integers(1, 300).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_interval_holds_the_share_and_mirrors(sample: tuple[int, int]) -> None:
    count, n = sample
    low, high = wilson(count, n)
    mirrored_low, mirrored_high = wilson(n - count, n)
    assert 0.0 <= low <= count / n + 1e-12
    assert count / n - 1e-12 <= high <= 1.0
    assert (low, high) == pytest.approx((1.0 - mirrored_high, 1.0 - mirrored_low), abs=1e-9)


@given(count=st.integers(0, 400), rest=st.integers(0, 400))
def test_intervals_and_p_values_are_those_of_scipys_binomial_test(count: int, rest: int) -> None:
    total = count + rest
    assert mcnemar(count, rest) == pytest.approx(binomtest(count, total).pvalue if total else 1.0, rel=1e-9)
    more = binomtest(count, total, alternative="greater").pvalue if total else 1.0
    assert mcnemar_more(count, rest) == pytest.approx(more, rel=1e-9)
    if total:
        interval = binomtest(count, total).proportion_ci(0.95, method="wilson")
        assert wilson(count, total) == pytest.approx((interval.low, interval.high), abs=1e-12)
