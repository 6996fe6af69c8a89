"""Rules that a target breaks without a collision, in hand-worked drives on the map of ``encounters.crossing``."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.metrics.breaches.offences import offences, offences_sentence
from advdiff_sumo.metrics.metric_rows import episode_row
from tests.metrics.encounters import DT_S, Car, driven, record_of, signals_of, straight

WAY = ("WC_1", "CE_1")


def told(record, road) -> list[tuple[str, float]]:
    return [(str(one.kind), round(one.time_s, 1)) for one in offences(record, road)]


def lit(road, *letters: str):
    """Return signals with one letter per instant for the eastward car; all others are green."""
    return tuple(signals_of(road, {WAY: letter}, 1)[0] for letter in letters)


# The stop line lies at x = -7.2: at 10 m/s from -30.05 the front, 2 m ahead, passes it between 2.0 and 2.1 s, and the
# centre is on the junction from 2.3 s.
EGO = straight("ego", (-30.05, -1.6), 0, 10)


@pytest.mark.parametrize(
    ("green_s", "expected"),
    [
        ((0.0, 0.0), [("red_light", 2.3)]),
        ((0.0, 1.9), [("red_light", 2.3)]),  # it turned red in time to be seen, as it has been for 0.1 s
        ((0.0, 4.1), []),
        ((0.0, 2.15), []),  # red once the front is over the line
        ((2.2, 4.1), []),  # green once the front is over it
    ],
)
def test_a_red_light_is_one_from_the_front_to_the_centre(light_road, green_s, expected) -> None:
    times = DT_S * np.arange(41)
    letters = np.where((times >= green_s[0]) & (times < green_s[1]), "G", "r")
    assert told(record_of(EGO, signals=lit(light_road, *letters)), light_road) == expected


def test_there_are_no_red_light_offences_without_signals_or_on_yellow(light_road) -> None:
    assert told(record_of(EGO), light_road) == []
    assert told(record_of(EGO, signals=lit(light_road, *"y" * 41)), light_road) == []


def test_stopping_before_the_line_or_with_the_front_over_it_is_no_red_light_offence(light_road) -> None:
    red = lit(light_road, *"r" * 41)
    for x in (-30.0, -8.9):
        stands = straight("ego", (x, -1.6), 0, 0)
        assert told(record_of(stands, signals=red), light_road) == []


def test_offences_of_others_are_not_the_targets(light_road) -> None:
    far = straight("ego", (60, -1.6), 0, 10)
    other = Car("other", EGO.xy_m, EGO.yaw_rad, EGO.speed_mps)
    assert told(record_of(far, other, signals=lit(light_road, *"r" * 41)), light_road) == []


def test_speeding_counts_above_1_2_times_the_limit_and_is_reported_at_its_worst(road) -> None:
    # the limit is 13.89 m/s, a fifth more 16.67
    allowed = driven("ego", (-150, -1.6), 0, [16.6] * 41)
    assert told(record_of(allowed), road) == []
    speed = np.r_[np.full(20, 16.0), np.full(10, 17.0), 18.0, np.full(10, 17.0)]
    record = record_of(driven("ego", (-150, -1.6), 0, speed))
    assert told(record, road) == [("speeding", 3.0)]
    assert offences_sentence(offences(record, road)) == (
        "The target drove at 65 km/h where 50 km/h are allowed (3.0 s)."
    )


def test_reversing_is_reported_once(road) -> None:
    backwards = driven("ego", (-50, -1.6), 0, [-1.0] * 41)
    assert [kind for kind, _ in told(record_of(backwards), road)] == ["reversing"]
    crept = driven("ego", (-50, -1.6), 0, [-0.15] * 41)  # 0.15 m a second: less than 0.2
    assert told(record_of(crept), road) == []


@pytest.mark.parametrize("begins", [2, 6, 7, 10, 14])
def test_reversing_counts_whenever_it_begins(road, begins) -> None:
    """0.35 m/s for 0.6 s: 0.21 m at the last of six instants, also if a full second begins among them."""
    speed = np.zeros(41)
    speed[begins : begins + 6] = -0.35
    record = record_of(driven("ego", (-50, -1.6), 0, speed))
    assert told(record, road) == [("reversing", round(0.1 * (begins + 5), 1))]


def test_noisy_speeds_are_no_reversing(road) -> None:
    """0.05 m back and forth, as for standing vehicles in logs: 0.25 m backwards in total, but never far at once."""
    assert told(record_of(driven("ego", (-50, -1.6), 0, np.resize([-0.5, 0.5], 41))), road) == []


@pytest.mark.parametrize("seconds", [1.0, 4.0])
def test_the_wrong_side_counts_after_a_while(road, seconds) -> None:
    """On the lane of the opposite direction at y = 1.6, from 1 s on, for *seconds*."""
    times = DT_S * np.arange(61)
    left = np.where((times >= 1.0) & (times < 1.0 + seconds), 3.2, 0.0)
    record = record_of(driven("ego", (-150, -1.6), 0, [8.0] * 61, left))
    assert told(record, road) == ([("wrong_side", 1.0)] if seconds > 1.5 else [])


@pytest.mark.parametrize("begins", [5, 6, 7, 8, 9, 20])
@pytest.mark.parametrize(("instants", "counts"), [(15, False), (16, True)])
def test_the_wrong_side_counts_whenever_it_begins(road, begins, instants, counts) -> None:
    """16 instants of 0.1 s last 1.5 s from the first to the last, wherever the record starts."""
    left = np.zeros(61)
    left[begins : begins + instants] = 3.2
    record = record_of(driven("ego", (-150, -1.6), 0, [8.0] * 61, left))
    assert told(record, road) == ([("wrong_side", round(begins * DT_S, 1))] if counts else [])


@pytest.mark.parametrize(("seconds", "expected"), [(1.4, []), (2.4, [("wrong_side", 0.8)])])
def test_longer_steps_do_not_shorten_the_required_time(road, seconds, expected) -> None:
    """With steps of 0.2 s it is checked every 0.4 s: 1.2 s, four checks, are less than 1.5 s."""
    times = DT_S * np.arange(61)
    left = np.where((times > 0.75) & (times < 0.8 + seconds), 3.2, 0.0)
    record = record_of(driven("ego", (-150, -1.6), 0, [8.0] * 61, left))
    coarse = replace(record, tracks=record.tracks.every(2), controller=record.controller[:, ::2])
    assert told(coarse, road) == expected


def test_driving_against_the_lane_is_the_wrong_side_but_walking_is_not(road) -> None:
    against = straight("ego", (-60, -1.6), math.pi, 8)
    assert told(record_of(against), road) == [("wrong_side", 0.0)]
    walker = Car("ego", against.xy_m, against.yaw_rad, against.speed_mps, (0.5, 0.5), AgentClass.PEDESTRIAN)
    assert told(record_of(walker), road) == []


def test_the_row_names_each_kind_once(light_road) -> None:
    fast = driven("ego", (-60, -1.6), 0, [20.0] * 41)
    row = episode_row(record_of(fast, signals=lit(light_road, *"r" * 41)), light_road)
    assert row["offences"] == "speeding, red_light"
    assert str(row["offences_text"]).startswith("The target drove at 72 km/h")
    careful = episode_row(record_of(EGO, signals=lit(light_road, *"G" * 41)), light_road)
    assert (careful["offences"], careful["offences_text"]) == ("", None)
