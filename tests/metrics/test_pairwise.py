"""Least times to collision among many agents, worked by hand and compared with the measure for one target."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.metrics.criticality import time_to_collision
from advdiff_sumo.metrics.kinematics import velocities
from advdiff_sumo.metrics.pairwise import TTC_BINS_S, least_ttc, ttc_counts

CAR = (5.0, 2.0)


def test_by_hand() -> None:
    """Two meet head-on, 50 m between the bumpers at 20 m/s: 2.5 s. A third drives beside them; the last is absent."""
    xy = np.array([[0.0, 0.0], [55.0, 0.0], [0.0, 10.0], [5.0, 0.0]])
    yaw = np.array([0.0, np.pi, 0.0, 0.0])
    velocity = np.array([[10.0, 0.0], [-10.0, 0.0], [10.0, 0.0], [0.0, 0.0]])
    there = np.array([True, True, True, False])
    found = least_ttc(xy, yaw, velocity, np.tile(CAR, (4, 1)), there)
    np.testing.assert_allclose(found[:2], 2.5)
    assert np.isinf(found[2])
    assert np.isnan(found[3])


def test_overlapping_boxes_meet_now_and_far_ones_never() -> None:
    xy = np.array([[[0.0, 0.0], [4.0, 0.0]], [[0.0, 0.0], [300.0, 0.0]]])
    still, there = np.zeros((2, 2, 2)), np.ones((2, 2), dtype=np.bool_)
    found = least_ttc(xy, np.zeros((2, 2)), still, np.array([[CAR, CAR]] * 2), there)
    np.testing.assert_array_equal(found, [[0.0, 0.0], [np.inf, np.inf]])


def test_the_least_over_partners_is_that_of_the_measure_for_one_target() -> None:
    rng = np.random.default_rng(3)
    agents, steps = 7, 4
    start, speed = rng.uniform(-40.0, 40.0, (agents, 1, 2)), rng.uniform(0.0, 15.0, agents)
    yaw = np.tile(rng.uniform(-3.0, 3.0, agents)[:, None], steps)
    ahead = np.stack((np.cos(yaw), np.sin(yaw)), axis=-1)
    xy = start + 0.5 * speed[:, None, None] * np.arange(steps)[None, :, None] * ahead
    tracks = Tracks(
        ids=tuple("abcdefg"),
        classes=np.zeros(agents, dtype=np.int64),
        size_m=np.tile(CAR, (agents, 1)),
        xy_m=xy,
        yaw_rad=yaw,
        speed_mps=np.tile(speed[:, None], steps),
        valid=np.ones((agents, steps), dtype=np.bool_),
        t0_s=0.0,
        dt_s=0.5,
    )
    own = least_ttc(
        xy.swapaxes(0, 1), yaw.T, velocities(tracks).swapaxes(0, 1), tracks.size_m[None], tracks.valid.T
    )
    assert np.isfinite(own).any()
    for row in range(agents):
        others = np.delete(time_to_collision(tracks, row), row, axis=0)
        np.testing.assert_allclose(own[:, row], others.min(axis=0), rtol=1e-9)


def test_counts_have_a_bin_for_agents_that_never_meet() -> None:
    counts = ttc_counts(np.array([0.0, 0.4, 0.6, 10.0, np.inf, np.inf, np.nan]))
    assert len(counts) == len(TTC_BINS_S)
    assert (counts[0], counts[1], counts[-2], counts[-1]) == (2.0, 1.0, 1.0, 2.0)
    assert counts.sum() == 6.0
