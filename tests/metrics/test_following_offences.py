"""Unsafe lane entries and close following without a collision, in hand-worked drives on ``encounters.crossing``."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.metrics.breaches.offences import offences, offences_sentence
from advdiff_sumo.metrics.metric_rows import episode_row
from tests.metrics.encounters import DT_S, Car, driven, record_of, straight

# Behind the target's new lane, whose centre line is at y = -1.6, a follower drives at 12 m/s and the target at 8 m/s.
# The target moves left by 3.2 m from 1 s to 3 s. Its left side, 1 m beside its centre, is 0.3 m over the line at
# y = -3.2 when it has moved by 0.9 m: at 1.6 s. The safe gap is 12 · 0.75 + (12² - 8²) / 12 = 15.7 m. The follower
# closes in by 3 m while it reacts, and then needs 4² / 2 (gap - 3).
STEPS = 61
TIMES = DT_S * np.arange(STEPS)
LEFT = np.interp(TIMES, [1.0, 3.0], [0.0, 3.2])


def changing(gap_m: float, follower_mps: float = 12.0) -> tuple[Car, Car]:
    """Return the target, which changes lanes, and a follower at *gap_m* behind it at 1.6 s."""
    ego = driven("ego", (-150, -4.8), 0, [8.0] * STEPS, LEFT)
    other = straight("other", (-150 + 1.6 * (8.0 - follower_mps) - 4.0 - gap_m, -1.6), 0, follower_mps, STEPS)
    return ego, other


def told(record, road) -> list[tuple[str, float]]:
    return [(str(one.kind), round(one.time_s, 1)) for one in offences(record, road)]


@pytest.mark.parametrize(
    ("gap_m", "brake"),
    [
        (16.0, None),  # safe
        (6.0, None),  # 2.7 m/s² are enough
        (4.8, "4.5"),  # 4.44, in steps of a quarter
        (4.0, "8.0"),
    ],
)
def test_a_lane_change_must_not_make_the_vehicle_behind_brake_hard(road, gap_m, brake) -> None:
    record = record_of(*changing(gap_m))
    assert told(record, road) == ([] if brake is None else [("unsafe_lane_entry", 1.6)])
    expected = (
        f"The target entered the lane of 'other' {gap_m:.1f} m ahead (15.7 m are needed), who had to brake at {brake} "
        "m/s² or more not to hit it (1.6 s)."
    )
    assert offences_sentence(offences(record, road)) == ("" if brake is None else expected)


def test_moving_into_the_lane_of_a_vehicle_beside_is_sideways(road) -> None:
    record = record_of(*changing(-3.0, 8.0))
    assert told(record, road) == [("sideways", 1.6)]
    assert "moved sideways into the lane of 'other', beside it, who had to brake at" in offences_sentence(
        offences(record, road)
    )


def test_it_counts_if_the_follower_brakes_and_no_collision_follows(road) -> None:
    ego, _ = changing(4.0)
    speed = np.maximum(7.0, 12.0 - 8.0 * np.maximum(0.0, TIMES - 1.7))
    row = episode_row(record_of(ego, driven("other", (-164.4, -1.6), 0, speed)), road)
    assert (row["target_collision"], row["offences"]) == (False, "unsafe_lane_entry")


def test_a_follower_that_drives_too_fast_or_changes_lanes_itself_does_not_count(road) -> None:
    ego, _ = changing(4.0)
    fast = straight("other", (-150 + 1.6 * (8 - 17) - 8, -1.6), 0, 17, STEPS)  # 61 km/h where 50 are allowed
    assert told(record_of(ego, fast), road) == []
    arrives = driven("other", (-164.4, -4.8), 0, [12.0] * STEPS, LEFT)
    assert told(record_of(ego, arrives), road) == []


def test_a_follower_that_would_have_hit_a_third_first_does_not_count(road) -> None:
    ego, other = changing(4.0)
    between = straight("between", (-150 - 2 - 1 - 0.9, -1.6), 0, 8, STEPS, size=(1.8, 0.6))
    assert told(record_of(ego, other), road) == [("unsafe_lane_entry", 1.6)]
    assert told(record_of(ego, other, between), road) == []


def test_staying_in_the_lane_or_leaving_it_again_is_no_entry(road) -> None:
    _, other = changing(4.0)
    stays = driven("ego", (-150, -4.8), 0, [8.0] * STEPS)
    assert told(record_of(stays, other), road) == []


# At 10 m/s behind a vehicle as fast the safe gap is 7.5 m, half of it 3.75 m.
@pytest.mark.parametrize(
    ("gap_m", "speed", "steps", "expected"),
    [
        (3.7, 10.0, 81, [("close_following", 3.0)]),  # as near at the start: three seconds to make room
        (3.8, 10.0, 81, []),
        (3.7, 10.0, 51, [("close_following", 3.0)]),
        (3.7, 10.0, 50, []),  # it lasts less than 2 s from there
        (1.5, 5.0, 81, []),  # slow
        (1.5, 5.1, 81, [("close_following", 3.0)]),
    ],
)
def test_less_than_half_the_safe_gap_for_two_seconds_is_close_following(
    road, gap_m, speed, steps, expected
) -> None:
    ego = straight("ego", (-150, -1.6), 0, speed, steps)
    assert told(record_of(ego, straight("other", (-146 + gap_m, -1.6), 0, speed, steps)), road) == expected


def test_closing_in_counts_from_where_the_gap_is_too_small(road) -> None:
    """12 m/s against 10 from 7.5 m on for 2 s: half the safe gap is (9 + 44 / 12) / 2 = 6.33 m, reached at 0.6 s."""
    closing = np.where(TIMES <= 2.0, 12.0, 10.0)
    ego = driven("ego", (-150, -1.6), 0, closing)
    record = record_of(ego, straight("other", (-138.5, -1.6), 0, 10, STEPS))
    assert told(record, road) == [("close_following", 0.6)]
    assert offences_sentence(offences(record, road)) == (
        "The target followed 'other' at 43 km/h, 6.3 m behind (12.7 m are safe), for 2 s or more (0.6 s)."
    )


@pytest.mark.parametrize(("braking_mps2", "expected"), [(1.2, []), (0.8, [("close_following", 0.3)])])
def test_time_in_which_the_target_brakes_does_not_count(road, braking_mps2, expected) -> None:
    """14 m/s behind 10 from 10 m on, for 4 s; half the safe gap, 9.2 m at first, is reached at 0.4 or 0.3 s.

    At 0.3 s with 0.8 m/s²: 10 − 1.2 + 0.04 = 8.84 m of (10.3 + 89.3 / 12) / 2 = 8.88 m.
    """
    ego = driven("ego", (-150, -1.6), 0, 14.0 - braking_mps2 * DT_S * np.arange(41))
    assert told(record_of(ego, straight("other", (-136, -1.6), 0, 10, 41)), road) == expected


def test_a_vehicle_that_cuts_in_closely_leaves_time_to_make_room(road) -> None:
    """On the target's lane from 2.1 s on, 3 m ahead; the target falls back from 4 s on, or not at all."""
    steps = 101
    times = DT_S * np.arange(steps)
    enters = driven("other", (-143, -4.8), 0, [10.0] * steps, np.interp(times, [1.0, 3.0], [0.0, 3.2]))
    for brakes_at, expected in ((4.0, []), (99.0, [("close_following", 5.1)])):
        ego = driven("ego", (-150, -1.6), 0, np.where(times > brakes_at, 8.0, 10.0))
        assert [x for x in told(record_of(ego, enters), road) if x[0] == "close_following"] == expected


def test_two_vehicles_in_turn_are_not_one(road) -> None:
    """Each is close for 1.5 s only: the first leaves to the right, the second is then a safe gap ahead."""
    steps = 61
    times = DT_S * np.arange(steps)
    leaves = driven("a", (-142.5, -1.6), 0, [10.0] * steps, np.interp(times, [3.5, 4.5], [0.0, -3.2]))
    ego = straight("ego", (-150, -1.6), 0, 10, steps)
    ahead = straight("b", (-130, -1.6), 0, 10, steps)
    assert told(record_of(ego, leaves, ahead), road) == []
