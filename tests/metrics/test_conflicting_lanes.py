"""Lanes of one street whose ways over a junction cross or join, and road users side by side within one lane."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from advdiff_sumo.core.polylines import Polyline, concatenate
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.maps import RoadMap
from tests.metrics.encounters import EDGES, NODES, Car, along, build, driven, findings, record_of

BICYCLE = {"size": (1.8, 0.6), "agent_class": AgentClass.BICYCLE}
TURN = """<connections>
  <connection from="WC" to="CE" fromLane="0" toLane="0"/> <connection from="WC" to="CE" fromLane="1" toLane="1"/>
  <connection from="WC" to="CS" fromLane="1" toLane="0"/>
</connections>"""
DROP_NODES = """<nodes>
  <node id="A" x="-300" y="0"/> <node id="M" x="0" y="0" type="zipper"/> <node id="B" x="300" y="0"/>
</nodes>"""
DROP_EDGES = """<edges>
  <edge id="AM" from="A" to="M" numLanes="2" speed="25"/> <edge id="MB" from="M" to="B" numLanes="1" speed="25"/>
</edges>"""


@pytest.fixture(scope="module")
def turn_road(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    """The crossing, where the left lane from the west may turn right, across the right one; it has to give way."""
    folder = tmp_path_factory.mktemp("turn")
    (folder / "turn.con.xml").write_text(TURN)
    return build(
        folder, NODES.format(kind="priority"), EDGES, "turn", more=("-x", str(folder / "turn.con.xml"))
    )


@pytest.fixture(scope="module")
def drop_road(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    """A street whose two lanes (y = -4.8 and -1.6) become one (y = -1.6) between x = -4 and 4; both yield."""
    return build(tmp_path_factory.mktemp("drop"), DROP_NODES, DROP_EDGES, "drop")


def over(road: RoadMap, start: str, end: str) -> Polyline:
    """Return the centre line of lane *start*, the junction and lane *end*."""
    return concatenate([road.lanes[x].line for x in (start, *road.links[start, end].via, end)])


def at(name: str, line: Polyline, s_m: float, mps: float) -> Car:
    """Return a car that drives along *line* from *s_m* on for 8 s."""
    return along(name, line, s_m + 0.1 * mps * np.arange(81))


def test_a_turn_across_the_lane_beside_takes_its_right_of_way(turn_road) -> None:
    """Both pass the line (192.8 m) at 3.6 s; the turning car meets the flank of the other, which drives straight on."""
    ahead = at("ahead", over(turn_road, "WC_0", "CE_0"), 163.5, 8)
    turning = at("turning", over(turn_road, "WC_1", "CS_0"), 170.0, 6)
    kind, fault, own, other = findings(record_of(ahead, turning, route=("WC", "CE")), turn_road)
    assert (kind, fault, own, other) == ("junction", "other", [], ["right_of_way"])
    kind, fault, own, other = findings(record_of(turning, ahead, route=("WC", "CS")), turn_road)
    assert (kind, fault, own, other) == ("junction", "target", ["right_of_way"], [])


@pytest.mark.parametrize(
    ("ahead", "behind", "fault", "breaches"),
    [
        ((253.0, 20.0), (251.0, 20.0), "unclear", []),  # 2 m are 0.1 s
        # the fronts pass the line (296 m) after 7 / 4 = 1.75 and 18 / 6 = 3 s
        ((287.0, 4.0), (276.0, 6.0), "other", ["right_of_way", "ran_into"]),
    ],
)
def test_where_two_lanes_become_one_the_first_may_go(
    drop_road, ahead: tuple[float, float], behind: tuple[float, float], fault: str, breaches: list[str]
) -> None:
    line, ending = over(drop_road, "AM_1", "MB_0"), over(drop_road, "AM_0", "MB_0")
    cars = at("ahead", line, *ahead), at("behind", ending, *behind)
    expected = ("junction", fault, [], breaches)
    assert findings(record_of(*cars, route=("AM", "MB")), drop_road) == expected


@pytest.mark.parametrize(
    ("car_left", "bicycle_left", "expected"),
    [
        # the car (y = -4.2, right side at -5.2) passes; the bicycle's left side is at -5.7, in the same lane
        (lambda s: -np.clip(0.06 * (s - 22), 0.0, 0.6), lambda s: 0.0 * s, ("target", ["sideways"], [])),
        (lambda s: 0.0 * s, lambda s: np.clip(0.08 * (s - 24), 0.0, 1.2), ("other", [], ["sideways"])),
    ],
)
def test_moving_sideways_into_a_bicycle_within_the_lane(
    road,
    car_left: Callable[[np.ndarray], np.ndarray],
    bicycle_left: Callable[[np.ndarray], np.ndarray],
    expected: tuple[str, list[str], list[str]],
) -> None:
    steps = np.arange(61.0)
    car = driven("car", (-120, -4.2), 0, np.full(61, 10.0), left=car_left(steps))
    bicycle = driven("bicycle", (-106, -6.0), 0, np.full(61, 5.0), left=bicycle_left(steps), **BICYCLE)
    kind, *found = findings(record_of(car, bicycle), road)
    assert (kind, *found) == ("side", *expected)


def test_a_vehicle_without_a_route_is_taken_to_go_straight_on(road) -> None:
    """The front of the bus is on the junction, its centre (y < -10.4) is not. Turning right it would meet nobody."""
    turning = at("turning", over(road, "EC_1", "CS_0"), 168.8, 6)
    bus = driven("bus", (1.6, -39), np.pi / 2, np.full(81, 5.0), size=(18.0, 2.5))
    assert findings(record_of(turning, bus, route=("EC", "CS")), road)[1:] == ("other", [], ["right_of_way"])
