"""Abrupt braking without need, in hand-worked drives on ``encounters.crossing``."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.metrics.breaches.offences import offences, offences_sentence
from advdiff_sumo.metrics.metric_rows import episode_row
from tests.metrics.encounters import DT_S, Car, braking, driven, record_of, signals_of, straight

STEPS = 61
LANE_Y = -1.6


def stopping(x: float = -190.0, brake_mps2: float = 6.0, speed: float = 13.0, left: object = 0.0) -> Car:
    """Return a target that drives east from *x* at *speed*, and brakes from 2 s on until it stands."""
    return driven("ego", (x, LANE_Y), 0, braking(speed, 2.0, brake_mps2, STEPS), left)  # type: ignore[arg-type] # numbers


def needless(record, road) -> list[float]:
    return [round(one.time_s, 1) for one in offences(record, road) if one.kind == "needless_braking"]


def test_braking_for_nothing_is_needless(road) -> None:
    """With 6 m/s² from 2 s on the mean of a second is over 4 m/s² from 1.7 s on: seven of its ten steps."""
    record = record_of(stopping())
    assert needless(record, road) == [1.7]
    assert offences_sentence(offences(record, road)) == (
        "The target braked abruptly without need, from 47 to 0 km/h (1.7 s)."
    )
    row = episode_row(record, road)
    assert (row["target_collision"], row["offences"]) == (False, "needless_braking")


@pytest.mark.parametrize(("brake_mps2", "speed"), [(3.9, 13.0), (6.0, 5.0), (1.0, 13.0)])
def test_gentle_or_slow_braking_is_not_judged(road, brake_mps2: float, speed: float) -> None:
    assert needless(record_of(stopping(brake_mps2=brake_mps2, speed=speed)), road) == []


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (straight("other", (-140, LANE_Y), 0, 0, STEPS), []),  # stands 10 m from where the target stops
        (straight("other", (-20, LANE_Y), 0, 0, STEPS), [1.7]),  # far away
        (straight("other", (-140, -4.8), 0, 0, STEPS), [1.7]),  # on the lane beside
        (straight("other", (-140, -4.8), 0, 0, STEPS, drift=1.0), []),  # moves into the lane
        (straight("other", (-160, LANE_Y), 0, 13, STEPS), [1.7]),  # two seconds ahead, as fast
        (driven("other", (-165, LANE_Y), 0, braking(13, 1.5, 7, STEPS)), []),  # brakes hard itself
        (straight("other", (-215, LANE_Y), 0, 13, STEPS), [1.7]),  # behind
    ],
)
def test_another_road_user_is_a_reason_if_a_careful_driver_would_brake_for_it(road, other, expected) -> None:
    assert needless(record_of(stopping(), other), road) == expected


@pytest.mark.parametrize(("y", "expected"), [(-9.0, []), (-10.5, [1.7])])
def test_a_pedestrian_near_the_way_is_a_reason(road, y: float, expected: list[float]) -> None:
    walker = driven("walker", (-140, y), 0, [0.0] * STEPS, size=(0.4, 0.5), agent_class=AgentClass.PEDESTRIAN)
    assert needless(record_of(stopping(), walker), road) == expected


@pytest.mark.parametrize(
    ("letters", "expected"), [("G" * STEPS, [1.7]), ("G" * 15 + "y" * 46, []), ("r" * STEPS, [])]
)
def test_a_signal_that_is_not_green_is_a_reason(light_road, letters: str, expected: list[float]) -> None:
    way = ("WC_1", "CE_1")
    signals = tuple(signals_of(light_road, {way: letter}, 1)[0] for letter in letters)
    assert needless(record_of(stopping(x=-90.0), signals=signals), light_road) == expected
    assert needless(record_of(stopping(x=-90.0)), light_road) == []  # unknown signals


def test_a_line_at_which_to_give_way_is_a_reason_within_reach(road, stop_road) -> None:
    """Gentle braking takes 13² / 3 = 56.3 m, and 20 m are added; at 1 s the line is 66 or 166 m away."""
    assert needless(record_of(stopping(x=-90.0)), road) == [1.7]  # the street has priority
    assert needless(record_of(stopping(x=-90.0)), stop_road) == []
    assert needless(record_of(stopping()), stop_road) == [1.7]


def test_the_end_of_the_route_is_a_reason(road) -> None:
    assert needless(record_of(stopping(x=-90.0), route=("WC",)), road) == []
    assert needless(record_of(stopping(), route=("WC",)), road) == [1.7]


def test_a_lane_change_is_a_reason(road) -> None:
    left = np.interp(DT_S * np.arange(STEPS), [1.0, 3.0], [0.0, 1.2])
    assert needless(record_of(stopping(left=left)), road) == []


def test_a_target_that_is_absent_meanwhile_is_not_judged(road) -> None:
    ego = stopping()
    ego.xy_m[15] = np.nan
    assert needless(record_of(ego), road) == []
