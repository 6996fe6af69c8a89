"""The driving test counts what can be counted by hand, and finds planted faults of nets."""

from __future__ import annotations

import math
import re
from pathlib import Path

import libsumo
import pytest

from advdiff_sumo.core.errors import NetError
from advdiff_sumo.sim.driving_test import _contacts, _leads_to, _Tally, _track_lane_changes, driving_test
from advdiff_sumo.sim.random_trips import RandomTrips
from tests.sim.nets import CROSSING, build

ROAD = (
    '<nodes><node id="W" x="0" y="0"/><node id="M" x="300" y="0"/><node id="E" x="600" y="0"/></nodes>',
    '<edges><edge id="WM" from="W" to="M" numLanes="2" speed="10"/><edge id="ME" from="M" to="E" speed="10"/></edges>',
)
THROUGH = (  # two roads that cross without a junction: no vehicle yields
    """<nodes><node id="W" x="-300" y="0"/><node id="E" x="300" y="0"/>
<node id="S" x="0" y="-300"/><node id="N" x="0" y="300"/></nodes>""",
    '<edges><edge id="WE" from="W" to="E" speed="10"/><edge id="SN" from="S" to="N" speed="10"/></edges>',
)


def row(x: float, y: float, compass_deg: float, lane: str = "a_0", speed: float = 5.0) -> dict[int, object]:
    """SUMO's values of a car: front bumper, compass heading, speed and lane."""
    return {
        libsumo.VAR_POSITION: (x, y),
        libsumo.VAR_ANGLE: compass_deg,
        libsumo.VAR_SPEED: speed,
        libsumo.VAR_LANE_ID: lane,
    }


def test_cars_in_the_hour(tmp_path: Path) -> None:
    """One departs every 120 s and has arrived within 80 s: there are never two at a time."""
    found = driving_test(build(tmp_path, *ROAD), vehicles=5, duration_s=600.0)
    assert (found["vehicles"], found["meaning"]) == (5, "in all")
    assert (found["arrived"], found["vehicles_most"]) == (5, 1)
    assert found["lane_km"] == pytest.approx(0.9, abs=0.03)  # 2 × 300 m and 300 m, less the junction
    assert 5 * 0.2 <= found["vehicle_km"] <= 5 * 0.6  # trips of 200 to 600 m
    assert found["vehicles_mean"] == pytest.approx(
        1000.0 * found["vehicle_km"] / found["mean_speed_mps"] / 600.0, abs=0.1
    )
    assert found["vehicles_per_km"] == pytest.approx(found["vehicles_mean"] / found["lane_km"], abs=0.1)
    none = ("teleports", "emergency_brakings", "collisions_sumo", "collisions_boxes")
    assert [found[key] for key in none] == [0, 0, 0, 0]
    assert found["emergency_brakings_per_1000_km"] == 0.0


def test_cars_at_once(tmp_path: Path) -> None:
    found = driving_test(build(tmp_path, *ROAD), vehicles=6, at_once=True, duration_s=300.0)
    assert (found["vehicles"], found["meaning"], found["vehicles_most"]) == (6, "at once", 6)
    assert 5.0 <= found["vehicles_mean"] <= 6.0
    assert found["arrived"] > 6
    assert found["collisions_boxes"] == found["teleports"] == 0


def test_the_same_seed_gives_the_same_figures(tmp_path: Path) -> None:
    net = build(tmp_path, CROSSING[0].format(kind="priority"), CROSSING[1])
    first, again, other = (driving_test(net, vehicles=20, duration_s=120.0, seed=s) for s in (1, 1, 2))
    assert first == again
    assert first != other


def test_a_crossing_without_a_junction_shows_in_our_list_only(tmp_path: Path) -> None:
    found = driving_test(build(tmp_path, *THROUGH), vehicles=12, at_once=True, duration_s=600.0)
    assert found["collisions_boxes"] > 0
    assert found["collisions_sumo"] == 0  # SUMO checks lanes and junctions only
    assert found["places_of_contacts"].keys() <= {"WE_0", "SN_0"}
    assert sum(found["places_of_contacts"].values()) == found["collisions_boxes"]
    assert found["collisions_boxes_changing_lane"] == 0


@pytest.mark.parametrize("kind", ["priority", "right_before_left", "allway_stop", "traffic_light"])
def test_a_crossing_with_a_rule_shows_nothing(tmp_path: Path, kind: str) -> None:
    net = build(tmp_path, CROSSING[0].format(kind=kind), CROSSING[1])
    found = driving_test(net, vehicles=8, at_once=True, duration_s=300.0)
    assert found["arrived"] > 0
    assert (found["collisions_boxes"], found["collisions_sumo"], found["teleports"]) == (0, 0, 0)


def test_an_everlasting_red_light_ends_in_teleports(tmp_path: Path) -> None:
    net = build(tmp_path, CROSSING[0].format(kind="traffic_light"), CROSSING[1])
    red = re.sub(r'state="[rgyGY]+"', lambda m: 'state="' + "r" * (len(m[0]) - 8) + '"', net.read_text())
    net.write_text(red)
    found = driving_test(net, vehicles=4, at_once=True, duration_s=420.0)
    assert found["teleports"] > 0
    assert set(found["places_of_teleports"]) <= {"WC_0", "EC_0", "NC_0", "SC_0"}
    assert (
        driving_test(net, vehicles=4, at_once=True, duration_s=290.0)["teleports"] == 0
    )  # SUMO waits for 300 s


def test_a_net_without_a_trip_is_refused(tmp_path: Path) -> None:
    nodes = '<nodes><node id="A" x="0" y="0"/><node id="B" x="40" y="0"/></nodes>'
    net = build(tmp_path, nodes, '<edges><edge id="AB" from="A" to="B"/></edges>')
    with pytest.raises(NetError, match="holds no way of 50 m"):
        driving_test(net, vehicles=1, duration_s=10.0)


def test_trips_are_at_least_200_m_and_repeat_with_the_seed(tmp_path: Path) -> None:
    net = build(tmp_path, CROSSING[0].format(kind="priority"), CROSSING[1])
    trips = RandomTrips(net, 3)
    drawn = [trips.draw() for _ in range(50)]
    assert {len(trip) for trip in drawn} == {2}  # an arm has less than 150 m, two have nearly 300
    assert all(trip[0].endswith("C") and trip[1].startswith("C") for trip in drawn)
    again = RandomTrips(net, 3)
    assert [again.draw() for _ in range(50)] == drawn


@pytest.mark.parametrize(
    ("other", "touch"),
    [
        (row(10.0, 1.8, 90.0), True),  # beside, 0.1 m into each other
        (row(10.0, 1.9, 90.0), False),  # side by side
        (row(14.5, 0.0, 90.0), True),  # behind each other, 0.1 m into each other
        (row(14.6, 0.0, 90.0), False),
        (row(8.0, 5.6, 0.0), False),  # northwards, its tail at y = 1.0
        (row(8.0, 5.4, 0.0), True),  # its tail at y = 0.8
        (row(14.57, 0.0, 90.0), False),  # 3 cm only touch
    ],
)
def test_boxes_touch_as_worked_out(other: dict[int, object], touch: bool) -> None:
    """A car of 4.6 × 1.9 m, facing east, front at (10, 0), covers x from 5.4 to 10 and y from −0.95 to 0.95."""
    state = {"one": row(10.0, 0.0, 90.0), "other": other}
    assert _contacts(state) == ({("one", "other")} if touch else set())  # type: ignore[arg-type]


def test_a_lane_change_counts_for_one_car_length() -> None:
    tally = _Tally(last_lane={"car": ":j_0_0"}, next_lanes={":j_0_0": ("e_0",), "e_0": (), "e_1": ()})
    for lane, speed, changing in (
        ("e_0", 4.0, False),  # the lane that follows
        ("e_1", 4.0, True),
        ("e_1", 4.0, True),  # 2 m later
        ("e_1", 4.0, True),  # 4 m
        ("e_1", 4.0, False),  # 6 m, its tail has come after
    ):
        on_road = {"car": row(0.0, 0.0, 90.0, lane, speed)}
        _track_lane_changes(tally, on_road, 0.5)  # type: ignore[arg-type]
        tally.last_lane["car"] = lane
        assert ("car" in tally.changed_m) is changing
    assert math.isclose(sum(tally.changed_m.values()), 0.0)


def test_lanes_passed_within_a_step_are_no_lane_change() -> None:
    tally = _Tally(next_lanes={"a": ("b",), "b": ("c", "d"), "c": ("e",), "d": (), "e": ()})
    assert _leads_to(tally, "a", "b")
    assert _leads_to(tally, "a", "e")
    assert not _leads_to(tally, "c", "d")
    assert not _leads_to(tally, "b", "a")
