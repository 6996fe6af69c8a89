"""Near misses worked by hand on the crossing of ``encounters.crossing``; cars are 4 x 2 m."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.metrics.criticality import least, time_to_collision
from advdiff_sumo.metrics.near_miss import ResolvedBy, near_miss
from tests.metrics.encounters import braking, driven, record_of, straight


def missed(record, road):
    """Return the near miss at the least time to collision."""
    tracks = record.tracks
    return near_miss(record, road, least(time_to_collision(tracks, record.target), tracks))


def test_nobody_near_is_no_near_miss(road) -> None:
    assert (
        missed(record_of(straight("ego", (-150, -1.6), 0, 10), straight("far", (-90, -1.6), 0, 10)), road)
        is None
    )


def test_gentle_braking_behind_a_leader_is_not_critical(road) -> None:
    ego = driven("ego", (-150, -1.6), 0, braking(12, 1.5, 3.0, 81))
    lead = driven("lead", (-118, -1.6), 0, braking(12, 0.5, 3.0, 81))
    found = missed(record_of(ego, lead), road)
    assert found is None or not found.critical


def test_a_cut_in_that_the_target_brakes_for_at_the_last_moment(road) -> None:
    # 8 m ahead and 8 m/s slower: closing 8 m/s in 0.75 s leaves 2 m or less; 8²/2/2 = 16 m/s² would be needed
    steps = 61
    cutter = driven(
        "cutter", (-138, -1.6), 0, np.full(steps, 6.0), left=np.maximum(-3.2, -0.4 * np.arange(steps))
    )
    speed = np.maximum(5.0, 14.0 - 9.0 * np.maximum(0.0, 0.1 * np.arange(steps) - 0.2))
    found = missed(record_of(driven("ego", (-150, -4.8), 0, speed), cutter), road)
    assert found is not None
    assert found.critical
    assert found.brake_mps2 > 4.0
    assert found.resolved_by is ResolvedBy.TARGET


def test_the_other_resolves_it(road) -> None:
    # 12 m ahead it comes 1.2 m into the lane at 6 m/s against 13, and leaves it again after a second
    steps = 61
    t = 0.1 * np.arange(steps)
    left = np.where(t < 0.5, -4.0 * t, np.minimum(0.0, -2.0 + 8.0 * np.maximum(0.0, t - 1.0)))
    cutter = driven("cutter", (-134, -1.6), 0, np.full(steps, 6.0), left=left)
    found = missed(record_of(straight("ego", (-150, -4.8), 0, 13, steps=steps), cutter), road)
    assert found is not None
    assert found.resolved_by is ResolvedBy.OTHER
