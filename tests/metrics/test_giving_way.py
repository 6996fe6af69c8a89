"""Giving way without a collision, in hand-worked encounters on the map of ``encounters.crossing``.

The target comes from the south at 5 m/s. Its front passes the line, at y = -10.4, before 0.5 s, when its centre is at
y = -11.95. The other comes from the west on the lane at y = -1.6. Their boxes, 4 m by 2 m, can meet while the target's
centre is between y = -4.6 and 1.4, from 1.47 s to 2.67 s later, and the other's between x = -1.4 and 4.6. If it starts
d metres before x = -1.4 at 12 m/s, it must drive at most d in 2.67 s. It drives 9 m in the 0.75 s before it brakes:
12 · 2.67 - b · 1.92² / 2 = d.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.metrics.breaches.offences import offences
from advdiff_sumo.metrics.metric_rows import episode_row
from tests.metrics.encounters import Car, braking, driven, record_of, signals_of, straight

NORTH = 0.5 * math.pi
EGO = straight("ego", (1.6, -14.45), NORTH, 5)
ROUTE = ("SC", "CN")


def from_west(d_m: float, speed: float = 12.0) -> Car:
    """Return a car at constant *speed* that is, at 0.5 s, *d_m* before the area where it may meet the target."""
    return straight("other", (-1.4 - d_m - 0.5 * speed, -1.6), 0, speed)


def text_of(road, *others: Car, ego: Car = EGO, **rest) -> list[str]:
    record = record_of(ego, *others, route=ROUTE, **rest)
    return [x.text for x in offences(record, road) if x.kind == "right_of_way"]


@pytest.mark.parametrize(
    ("d_m", "brake"),
    [
        (35.0, None),  # it passes behind the target
        (27.0, None),  # 2.7 m/s² are enough
        (24.0, "4.5"),  # 4.4, in steps of a quarter
        (20.0, "6.8"),  # it stops before: 9 m and 12² / 2b are 20 m at 6.55
        (8.0, None),  # it has passed before the target is there
    ],
)
def test_a_vehicle_with_priority_must_not_be_made_to_brake_hard(road, d_m, brake) -> None:
    expected = (
        [] if brake is None else [f"did not give way to 'other', who had to brake at {brake} m/s² or more"]
    )
    assert [one.removesuffix(" not to hit it") for one in text_of(road, from_west(d_m))] == expected


def test_if_the_other_is_hit_it_counts_at_any_required_braking(road) -> None:
    record = record_of(EGO, from_west(27.0), route=ROUTE)
    assert not text_of(road, from_west(27.0))
    row = episode_row(record, road)
    assert row["target_breaches"] == "right_of_way"
    assert row["offences"] == "right_of_way"
    assert str(row["offences_text"]).startswith("The target did not give way to 'other' at the junction")


def test_it_also_counts_if_the_other_brakes_and_no_collision_follows(road) -> None:
    careful = driven("other", (-31.4, -1.6), 0, braking(12.0, 0.6, 6.0, 41))
    row = episode_row(record_of(EGO, careful, route=ROUTE), road)
    assert (row["target_collision"], row["offences"]) == (False, "right_of_way")
    assert str(row["offences_text"]).startswith(
        "The target did not give way to 'other', who had to brake at "
    )
    assert str(row["offences_text"]).endswith(" (0.5 s).")


def test_the_text_names_the_vehicle_that_had_to_brake_hardest(road) -> None:
    nearer = straight("nearer", (-1.4 - 20 - 6, -1.6), 0, 12)
    assert len(text_of(road, from_west(35.0), nearer)) == 1
    assert "'nearer'" in text_of(road, from_west(35.0), nearer)[0]


def test_a_vehicle_that_would_have_hit_a_third_first_does_not_count(road) -> None:
    queue = straight("queue", (-14, -1.6), 0, 0)
    assert text_of(road, from_west(24.0), queue) == []
    beside = straight("beside", (-14, -4.8), 0, 0)
    assert len(text_of(road, from_west(24.0), beside)) == 1


def test_a_speeding_vehicle_does_not_count(road) -> None:
    assert text_of(road, from_west(36.0, speed=18.0)) == []
    assert len(text_of(road, from_west(30.0, speed=15.0))) == 1


def test_a_target_with_priority_or_at_an_all_way_stop_need_not_give_way(road, stop_road) -> None:
    east = straight("ego", (-32, -1.6), 0, 12)
    late = straight("other", (1.6, -24), NORTH, 9)
    record = record_of(east, late)
    assert [one.kind for one in offences(record, road)] == []
    assert [one.kind for one in offences(record_of(late, east, route=ROUTE), road)] == ["right_of_way"]
    assert text_of(stop_road, from_west(24.0)) == []


def test_waiting_with_the_front_over_the_line_is_giving_way(road) -> None:
    waits = driven("ego", (1.6, -14.45), NORTH, braking(5.0, 0.6, 4.0, 41))  # its front stops at y = -6.2
    assert text_of(road, from_west(24.0), ego=waits) == []


def test_pedestrians_are_not_judged(road) -> None:
    other = from_west(24.0)
    walker = Car("other", other.xy_m, other.yaw_rad, other.speed_mps, (0.5, 0.5), AgentClass.PEDESTRIAN)
    assert text_of(road, walker) == []


@pytest.mark.parametrize(
    ("own", "theirs", "expected"),
    [("g", "G", 1), ("g", "r", 0), ("g", "y", 1), ("G", "g", 0), ("r", "G", 0)],
)
def test_signals_override_the_signs(light_road, own, theirs, expected) -> None:
    """The target's own red light is another offence; a vehicle that comes on red has no right of way."""
    letters = {("SC_0", "CN_0"): own} | {("WC_1", to): theirs for to in ("CE_1", "CN_0")}
    signals = signals_of(light_road, letters, 41)
    assert len(text_of(light_road, from_west(24.0), signals=signals)) == expected


@pytest.mark.parametrize(("theirs", "expected"), [("G", 1), ("y", 0), ("r", 0)])
def test_a_vehicle_that_stops_counts_only_on_green(light_road, theirs, expected) -> None:
    stops = driven("other", (-31.4, -1.6), 0, braking(12.0, 0.6, 6.0, 41))  # at x = -12.2
    letters = {("WC_1", to): theirs for to in ("CE_1", "CN_0")}
    assert len(text_of(light_road, stops, signals=signals_of(light_road, letters, 41))) == expected


def test_signals_that_are_not_known_are_not_judged(light_road) -> None:
    assert text_of(light_road, from_west(24.0)) == []


def test_a_target_that_begins_over_the_line_is_not_judged(road) -> None:
    over = straight("ego", (1.6, -11.0), NORTH, 5)
    assert text_of(road, from_west(20.0), ego=over) == []


def test_a_vehicle_that_leaves_the_record_is_extrapolated(road) -> None:
    """It is present until 1 s and drives straight on; the extrapolation continues this."""
    other = from_west(24.0)
    xy = np.where(np.arange(41)[:, None] <= 10, other.xy_m, np.nan)
    assert len(text_of(road, Car("other", xy, other.yaw_rad, other.speed_mps))) == 1
