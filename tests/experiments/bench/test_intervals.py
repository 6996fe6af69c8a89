"""Intervals and tests on samples whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.experiments.bench.fewshot import Pooled, mean_over_targets
from advdiff_sumo.experiments.bench.intervals import (
    Divergence,
    Estimate,
    difference,
    estimate,
    ratio,
)
from advdiff_sumo.experiments.bench.samples import Rates
from advdiff_sumo.experiments.bench.transfer import share_kept
from advdiff_sumo.metrics.statistics import jensen_shannon, mcnemar


def names(count: int) -> list[str]:
    return [f"s{k}" for k in range(count)]


def test_wilson_for_rates() -> None:
    """5 of 10: centre 0.5, half width 1.96 √(0.025 + 0.0096) / 1.384."""
    found = estimate(ratio(names(10), [1.0] * 5 + [0.0] * 5, [1.0] * 10, rate=True))
    assert found.value == 0.5
    assert found.n == 10
    assert (found.low, found.high) == pytest.approx((0.2366, 0.7634), abs=1e-4)


def test_wilson_out_of_many_vehicles_a_scene() -> None:
    found = estimate(ratio(names(2), [0.0, 0.0], [60.0, 40.0], rate=True))
    assert (found.value, found.low, found.n) == (0.0, 0.0, 100)
    assert found.high == pytest.approx(0.0370, abs=1e-4)  # z² / (n + z²)


def test_bootstrap_of_a_mean() -> None:
    """Of values without spread the interval is a point; of many normal ones it is ± 1.96 / √n."""
    point = estimate(ratio(names(5), [3.0] * 5, [1.0] * 5))
    assert (point.value, point.low, point.high) == (3.0, 3.0, 3.0)
    values = np.random.default_rng(1).normal(size=400)
    found = estimate(ratio(names(400), values.tolist(), [1.0] * 400))
    assert found.value == pytest.approx(values.mean())
    assert found.low is not None
    assert found.high is not None
    assert found.high - found.low == pytest.approx(2 * 1.96 / 20.0, rel=0.1)


def test_what_a_scene_has_several_of_is_drawn_together() -> None:
    """Two scenes, the one with values of 0, the other of 1: a draw is 0, ½ or 1, however many values there are."""
    found = estimate(ratio(names(2), [0.0, 1000.0], [1000.0, 1000.0]))
    assert (found.value, found.low, found.high, found.n) == (0.5, 0.0, 1.0, 2000)


def test_no_sample_no_figure() -> None:
    assert estimate(ratio([], [], [])) == Estimate()
    assert estimate(ratio(names(2), [0.0, 0.0], [0.0, 0.0], rate=True)) == Estimate()


def test_divergence_by_hand() -> None:
    """With p = (1, 0), q = (½, ½), m = (¾, ¼): ½ log₂ 4/3 + ½ (½ log₂ 2/3 + ½ log₂ 2) = 0.3113."""
    p, q = np.array([[4.0, 0.0]]), np.array([[3.0, 3.0]])
    assert jensen_shannon(p, q)[0] == pytest.approx(0.311278, abs=1e-6)
    assert jensen_shannon(p, p)[0] == 0.0
    assert jensen_shannon(p, np.array([[0.0, 9.0]]))[0] == pytest.approx(1.0)
    assert np.isnan(jensen_shannon(p, np.zeros((1, 2)))[0])


def test_divergence_pools_scenes_and_is_the_mean_over_histograms() -> None:
    own = (np.array([[4.0, 0.0], [0.0, 4.0]]), np.array([[1.0, 0.0], [1.0, 0.0]]))
    reference = (np.array([[2.0, 2.0], [2.0, 2.0]]), np.array([[0.0, 1.0], [0.0, 1.0]]))
    found = estimate(Divergence(("a", "b"), own, reference))
    assert found.value == pytest.approx(0.5)  # the first agree as a whole, the second have nothing in common
    assert found.n == 8
    # half of the draws are one scene twice, so that they are larger by half of 0.5 · 0.311278 on average
    assert found.high == pytest.approx(0.5 * (0.311278 + 1.0) - 0.25 * 0.311278, abs=2e-3)
    assert found.low == pytest.approx(0.5 - 0.25 * 0.311278, abs=2e-3)


def test_mcnemar_by_hand() -> None:
    """One against five: 2 (C(6,0) + C(6,1)) / 2⁶."""
    assert mcnemar(1, 5) == pytest.approx(14 / 64)
    assert mcnemar(0, 0) == 1.0


def test_differences_are_paired() -> None:
    """Here b is a plus one in every scene, whatever the scenes do; a scene that one of them lacks does not count."""
    values = [1.0, 5.0, -3.0, 8.0]
    a = ratio(names(4), values, [1.0] * 4)
    b = ratio(["other", *names(4)[::-1]], [99.0, *(v + 1.0 for v in values[::-1])], [1.0] * 5)
    found = difference(b, a)
    assert (found.value, found.scenes, found.p) == (1.0, 4, None)
    assert found.low == pytest.approx(1.0)
    assert found.high == pytest.approx(1.0)


def test_rates_of_episodes_get_mcnemar_and_those_of_vehicles_do_not() -> None:
    a = ratio(names(6), [1.0, 1.0, 1.0, 1.0, 1.0, 0.0], [1.0] * 6, rate=True)
    b = ratio(names(6), [0.0, 0.0, 0.0, 0.0, 0.0, 1.0], [1.0] * 6, rate=True)
    found = difference(a, b)
    assert found.value == pytest.approx(4 / 6)
    assert found.p == pytest.approx(14 / 64)
    assert difference(ratio(names(6), [1.0] * 6, [5.0] * 6, rate=True), b).p is None


def test_nothing_in_common_is_no_difference() -> None:
    one, other = ratio(["a"], [1.0], [1.0]), ratio(["b"], [1.0], [1.0])
    assert difference(one, other).value is None


def test_plans_per_second_are_by_the_median() -> None:
    found = estimate(Rates(("a", "b", "c"), np.array([0.1, 0.05, 4.0])))
    assert found.value == pytest.approx(10.0)
    assert found.n == 3


def test_warm_ups_and_scenes_are_drawn_at_once() -> None:
    """All warm-ups agree: only scenes vary. One alone: Wilson."""
    hits = np.array([[1.0, 0.0, 0.0, 0.0]] * 5)
    found = Pooled(tuple("abcd"), hits).estimate()
    assert (found.value, found.n) == (0.25, 20)
    assert found.low == 0.0
    assert found.high == 0.75
    assert Pooled(tuple("abcd"), hits[:1]).estimate().low == pytest.approx(0.0456, abs=1e-4)
    gained = Pooled(tuple("abcd"), hits).less(Pooled(tuple("dcba"), np.array([[0.0, 0.0, 0.0, 1.0]])))
    assert (gained.value, gained.scenes) == (0.0, 4)
    assert (gained.low, gained.high) == pytest.approx(
        (-0.4899, 0.4899), abs=1e-4
    )  # no pair differs: z² / (4 + z²)


def test_a_difference_that_all_pairs_agree_in_has_a_width() -> None:
    """None of eight is otherwise: z² / (8 + z²) = 0.3244, and no difference is beyond 1."""
    all_hit, none_hit = (ratio(names(8), [hit] * 8, [1.0] * 8, rate=True) for hit in (1.0, 0.0))
    for sample, other, low, high in (
        (all_hit, all_hit, -0.3244, 0.3244),
        (none_hit, none_hit, -0.3244, 0.3244),
        (all_hit, none_hit, 0.6756, 1.0),
        (none_hit, all_hit, -1.0, -0.6756),
    ):
        found = difference(sample, other)
        assert (found.low, found.high) == pytest.approx((low, high), abs=1e-4)
    first = Pooled(tuple(names(8)), np.zeros((1, 8)))
    later = Pooled(tuple(names(8)), np.zeros((3, 8))).less(first)
    assert (later.low, later.high) == pytest.approx((-0.3244, 0.3244), abs=1e-4)


def test_the_mean_over_targets_takes_the_scenes_that_all_have() -> None:
    one = Pooled(tuple("abc"), np.array([[1.0, 0.0, 1.0], [1.0, 1.0, 1.0]]))
    other = Pooled(tuple("cb"), np.array([[0.0, 0.0], [1.0, 0.0]]))
    both = mean_over_targets([one, other])
    assert (both.scenes, both.targets) == (("b", "c"), 2)
    assert both.hits.tolist() == [[0.0, 0.5], [0.5, 1.0]]
    found = both.estimate()
    assert (found.value, found.n) == (0.5, 8)
    assert found.low == 0.0  # both draws of b, of the first warm-up
    assert found.high == 1.0
    gained = both.less(mean_over_targets([Pooled(tuple("bc"), np.array([[0.0, 0.0]]))] * 2))
    assert (gained.value, gained.scenes) == (0.5, 2)


def test_share_of_the_rate_that_is_kept() -> None:
    own = ratio(names(4), [1.0, 1.0, 1.0, 1.0], [1.0] * 4, rate=True)
    foreign = ratio(names(4), [1.0, 1.0, 1.0, 0.0], [1.0] * 4, rate=True)
    found = share_kept([(foreign, own), (own, own)])
    assert found.value == pytest.approx(7 / 8)
    assert found.n == 4
    assert share_kept([]).value is None
