"""What came of encounters, on records driven by hand: failed, nearly so, resolved, or cut off."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.experiments.encounter_outcomes import BegunEncounter, outcomes
from advdiff_sumo.maps import RoadMap
from tests.metrics.encounters import braking, crossing, driven, record_of, straight

STEPS = 61


@pytest.fixture(scope="module")
def road(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    return crossing(tmp_path_factory.mktemp("net"), "priority")


def behind_a_stop(target_brakes_s: float, target_mps2: float = 8.0, gap_m: float = 26.0) -> EpisodeRecord:
    """Both at 12 m/s, 26 m apart; the leader brakes with 6 m/s² after 1 s and stands after 3 s, 12 m on."""
    return record_of(
        driven("target", (-170.0, -4.8), 0.0, braking(12.0, target_brakes_s, target_mps2, STEPS)),
        driven("leader", (-170.0 + gap_m + 4.0, -4.8), 0.0, braking(12.0, 1.0, 6.0, STEPS)),
        straight("far", (-20.0, 4.8), np.pi, 5.0, STEPS),
    )


def came(record: EpisodeRecord, road: RoadMap, *begun: BegunEncounter) -> list[tuple[str, float]]:
    ended, values = outcomes(record, road, begun)
    return [(one.names[0], round(value, 3)) for one, value in zip(ended, values.tolist(), strict=True)]


STOP, FAR = BegunEncounter(1.0, ("leader",), (1.0,)), BegunEncounter(0.5, ("far",), (0.0,))


def test_who_does_not_brake_fails_against_the_leader_alone(road: RoadMap) -> None:
    assert came(behind_a_stop(9.0), road, FAR, STOP) == [("far", 0.0), ("leader", 1.0)]


def test_who_brakes_in_time_resolves_it(road: RoadMap) -> None:
    assert came(behind_a_stop(1.5), road, FAR, STOP) == [("far", 0.0), ("leader", 0.0)]


def test_who_stops_at_the_last_moment_nearly_fails(road: RoadMap) -> None:
    """It stops 0.2 m short. (d + 0.2 m) / √(16 m/s² · d) is least at d = 0.2 m: 0.224 s, seen at instants of 0.1 s."""
    (far, near) = came(behind_a_stop(3.35, 8.0, 25.4), road, FAR, STOP)
    assert far == ("far", 0.0)
    assert near[1] == pytest.approx(0.5 * (1.0 - 0.224 / 0.5), abs=0.05)


def test_an_encounter_that_the_end_cuts_off_says_nothing(road: RoadMap) -> None:
    late = BegunEncounter(4.0, ("leader",), (1.0,))
    assert came(behind_a_stop(1.5), road, late) == []


def test_of_two_with_the_same_vehicle_the_last_one_failed(road: RoadMap) -> None:
    """The first lasted a second, which is too short to tell."""
    first = BegunEncounter(0.0, ("leader",), (2.0,))
    assert came(behind_a_stop(9.0), road, first, STOP) == [("leader", 1.0)]


def test_a_contact_that_is_no_valid_failure_says_nothing(road: RoadMap) -> None:
    """The other comes over the line into the target's side, which no rule allows."""
    record = record_of(
        straight("target", (-170.0, -4.8), 0.0, 12.0, STEPS),
        driven("other", (-170.0, -1.6), 0.0, np.full(STEPS, 12.0), -np.linspace(0.0, 6.0, STEPS)),
    )
    assert came(record, road, BegunEncounter(0.0, ("other",), (1.0,))) == []
