"""Hand-worked contacts with pedestrians on the crossings of ``encounters.crossing``, which lie at x and y = ±8.4 m."""

from __future__ import annotations

import math

import numpy as np
import pytest

from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.collision import collisions, target_collision
from advdiff_sumo.metrics.verdict import judge
from tests.metrics.encounters import EDGES, NODES, build, driven, findings, record_of, signals_of, straight

NORTH = math.pi / 2
WALKER = {"size": (0.6, 0.6), "agent_class": AgentClass.PEDESTRIAN}
CROSSINGS = ("--sidewalks.guess", "true", "--crossings.guess", "true")
ROUTE = ("SC", "CN")


@pytest.fixture(scope="module")
def foot(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    """The crossing with sidewalks and crossings for people; the street along x has priority."""
    return build(
        tmp_path_factory.mktemp("foot"), NODES.format(kind="priority"), EDGES, "foot", more=CROSSINGS
    )


@pytest.fixture(scope="module")
def foot_lights(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    """The same with traffic lights."""
    nodes = NODES.format(kind="traffic_light")
    return build(tmp_path_factory.mktemp("lights"), nodes, EDGES, "lights", more=CROSSINGS)


@pytest.mark.parametrize("pause_s", [0.0, 0.4])
def test_a_pedestrian_hit_on_a_crossing_broke_no_rule(foot, pause_s) -> None:
    """The pedestrian enters the lane less than 0.75 * 8 + 8² / 12 = 11.3 m ahead of the target.

    It came onto the crossing (x = 3.2 m) 1.7 s before the contact, 13.6 m ahead. A pause of less than a second in front
    of the car does not change that.
    """
    ego = straight("ego", (1.6, -30), NORTH, 8, steps=81)
    speeds = np.where((np.arange(81) * 0.1 >= 4.0) & (np.arange(81) * 0.1 < 4.0 + pause_s), 0.0, 1.0)
    on = driven("on", (5.9, 8.4), math.pi, speeds, **WALKER)
    kind, fault, own, other = findings(record_of(ego, on, route=ROUTE), foot)
    assert (kind, fault, other) == ("side", "target", [])
    assert "right_of_way" in own
    assert findings(record_of(on, ego, route=()), foot)[1:3] == ("other", [])


@pytest.mark.parametrize("from_x_m", [7.0, 7.4])
def test_a_pedestrian_that_walks_onto_a_crossing_too_late_is_at_fault(foot, from_x_m) -> None:
    """They leave the kerb at x = 3.2 m at 3.8 and 4.2 s, when a car that is there at 4.5 s can no longer stop."""
    ego = straight("ego", (1.6, -30), NORTH, 8, steps=81)
    on = driven("on", (from_x_m, 8.4), math.pi, np.full(81, 1.0), **WALKER)
    kind, fault, own, other = findings(record_of(ego, on, route=ROUTE), foot)
    assert (kind, fault, other) == ("side", "other", ["unsafe_lane_entry"])
    assert "right_of_way" in own


@pytest.mark.parametrize(("stands_s", "fault"), [(2.2, "target"), (3.7, "other")])
def test_a_pedestrian_that_starts_onto_a_crossing_too_late_is_at_fault(foot, stands_s, fault) -> None:
    """At 8 m/s a car stops within 11.3 m, 1.4 s. The kerb is at x = 3.2 m; the car is at y = 8.4 m at 4.5 s."""
    ego = straight("ego", (1.6, -30), NORTH, 8, steps=81)
    speeds = np.where(np.arange(81) * 0.1 < stands_s, 0.0, 1.0)
    steps = driven("steps", (3.6, 8.4), math.pi, speeds, **WALKER)
    kind, blamed, own, _other = findings(record_of(ego, steps, route=ROUTE), foot)
    assert (kind, blamed, "right_of_way" in own) == ("side", fault, True)


def before_the_light(road: RoadMap, letter: str | None) -> EpisodeRecord:
    """Return a northward car on *letter* at 10 m/s and a pedestrian that crosses before it; they meet at 3 s."""
    ego = straight("ego", (1.6, -8.4 - 2.0 - 30.0), NORTH, 10, steps=61)
    walker = driven("walker", (1.6 - 1.3 * 3.0, -8.4), 0.0, np.full(61, 1.3), **WALKER)
    signals = () if letter is None else signals_of(road, {("SC_1", "CN_1"): letter}, 61)
    return record_of(ego, walker, route=ROUTE, signals=signals)


def test_a_pedestrian_hit_by_a_red_light_runner_broke_no_rule(foot_lights) -> None:
    """The pedestrian is in the lane at 1.8 s, 11.7 m ahead, where 0.75 * 10 + 10² / 12 = 15.8 m are needed."""
    expected = ("side", "target", ["red_light", "right_of_way"], [])
    assert findings(before_the_light(foot_lights, "r"), foot_lights) == expected


def test_a_pedestrian_in_front_of_a_protected_green_entered_the_lane(foot_lights) -> None:
    expected = ("side", "other", [], ["unsafe_lane_entry"])
    assert findings(before_the_light(foot_lights, "G"), foot_lights) == expected


def test_without_signals_the_fault_on_a_crossing_with_a_light_is_unclear(foot_lights) -> None:
    record = before_the_light(foot_lights, None)
    assert findings(record, foot_lights) == ("side", "unclear", [], [])
    hit = target_collision(record, collisions(record))
    assert hit is not None
    assert "right of way (no signals recorded)" in judge(record, foot_lights, hit).not_judged


def test_two_pedestrians_on_a_crossing_need_not_give_way_to_each_other(foot) -> None:
    one, other = (
        driven("one", (-3, 8.4), 0.0, np.full(61, 1.0), **WALKER),
        driven("other", (3, 8.4), math.pi, np.full(61, 1.0), **WALKER),
    )
    assert findings(record_of(one, other, route=()), foot)[1:] == ("unclear", [], [])
