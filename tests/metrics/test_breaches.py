"""Each breach in a hand-worked encounter in which it led to the contact, and in one in which it did not.

The crossing and its lanes are those of ``encounters.crossing``; cars are 4 x 2 m.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.core.polylines import concatenate
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.breaches import breaches_of, conduct_breaches
from advdiff_sumo.metrics.collision import collisions, target_collision, tracks_collisions
from advdiff_sumo.metrics.encounter import encounter_of
from advdiff_sumo.metrics.summary import judged_collision
from advdiff_sumo.metrics.traffic_view import TrafficView
from tests.metrics.encounters import (
    DT_S,
    Car,
    blame,
    braking,
    broken,
    crossing,
    driven,
    record_of,
    signals_of,
    straight,
)

NORTH = math.pi / 2


# --- red lights and giving way ---------------------------------------------------------------------------


def lights(road: RoadMap, east: str, north: str):
    return signals_of(road, {("WC_1", "CE_1"): east, ("SC_0", "CN_0"): north}, 41)


@pytest.mark.parametrize(
    ("east", "north", "expected"),
    [
        ("G", "r", ([], ["red_light"])),
        ("r", "G", (["red_light"], [])),
        ("r", "r", (["red_light"], ["red_light"])),
        ("G", "u", ([], ["red_light"])),
    ],
)
def test_red_light(light_road, east, north, expected) -> None:
    # both 10 m/s; the eastward car is on the northward one's lane at about 3 s
    cars = straight("east", (-30, -1.6), 0, 10), straight("north", (1.6, -31), NORTH, 10)
    assert broken(record_of(*cars, signals=lights(light_road, east, north)), light_road) == expected
    mirrored = record_of(*cars[::-1], route=("SC", "CN"), signals=lights(light_road, east, north))
    assert broken(mirrored, light_road) == expected[::-1]


@pytest.mark.parametrize(
    ("red_from_s", "expected"),
    [
        (0.0, ([], ["red_light"])),
        (0.3, ([], ["red_light"])),
        (0.7, (["right_of_way"], [])),  # both on green: the target came later
        (1.5, (["right_of_way"], [])),
    ],
)
def test_a_long_vehicle_whose_front_passed_on_green_ran_no_red_light(
    light_road, red_from_s, expected
) -> None:
    """The signal when the front passes counts, not when the centre does. The stop line lies at x = -7.2."""
    bus = straight(
        "bus", (-15.7, -1.6), 0, 5, steps=51, size=(12.0, 2.5)
    )  # its front passes at 0.5, its centre at 1.7 s
    north = straight("north", (1.6, -31), NORTH, 9, steps=51)
    green, red = ({("WC_1", "CE_1"): letter, ("SC_0", "CN_0"): "G"} for letter in "Gr")
    before, after = (signals_of(light_road, letters, 51) for letters in (green, red))
    at = round(red_from_s / DT_S)
    record = record_of(north, bus, route=("SC", "CN"), signals=before[:at] + after[at:])
    assert broken(record, light_road) == expected


@pytest.mark.parametrize("length_m", [4.0, 12.0, 16.5])
def test_a_long_vehicle_whose_middle_is_still_before_the_line_ran_the_red_light(light_road, length_m) -> None:
    """The front is 4.6 m beyond the line at the contact; the centre has not entered yet."""
    bus = straight("bus", (-14.7 - 0.5 * length_m, -1.6), 0, 5, steps=41, size=(length_m, 2.5))
    south = straight("south", (-1.6, 22), -NORTH, 9, steps=41)
    signals = signals_of(light_road, {("WC_1", "CE_1"): "r", ("NC_0", "CS_0"): "G"}, 41)
    assert broken(record_of(south, bus, route=("NC", "CS"), signals=signals), light_road) == (
        [],
        ["red_light"],
    )
    assert blame(record_of(south, bus, route=("NC", "CS"), signals=signals), light_road) == (
        "junction",
        "other",
    )


def test_waiting_at_red_with_the_front_over_the_line_is_no_entry(light_road) -> None:
    waits = straight("waits", (-8.9, -1.6), 0, 0)  # its front is 0.3 m over the line
    turns = straight("turns", (-6, 12), -math.radians(95), 9)  # cuts the corner
    signals = signals_of(light_road, {("WC_1", "CE_1"): "r", ("NC_0", "CS_0"): "G"}, 41)
    assert "red_light" not in broken(record_of(waits, turns, signals=signals), light_road)[0]


def test_standing_over_the_line_at_red_and_entering_on_green_is_no_red_light_breach(light_road) -> None:
    ego = driven(
        "ego", (-8, -1.6), 0, np.where(np.arange(51) < 10, 0.0, 8.0)
    )  # its front is 1.2 m over the line
    north = straight("north", (1.6, -25), NORTH, 10, steps=51)
    green, red = ({("WC_1", "CE_1"): letter, ("SC_0", "CN_0"): "G"} for letter in "Gr")
    before, after = (signals_of(light_road, letters, 51) for letters in (red, green))
    assert "red_light" not in broken(record_of(ego, north, signals=before[:8] + after[8:]), light_road)[0]
    assert "red_light" in broken(record_of(ego, north, signals=before), light_road)[0]


def test_a_red_light_did_not_lead_to_a_collision_with_the_follower(light_road) -> None:
    # both run the red light eastward; the faster one behind hits the rear of the one ahead on the junction
    ego, lead = straight("ego", (-32, -1.6), 0, 14), straight("lead", (-14, -1.6), 0, 7)
    record = record_of(ego, lead, signals=lights(light_road, "r", "G"))
    assert broken(record, light_road) == (["ran_into"], [])


def test_without_signals_there_are_no_red_lights(light_road) -> None:
    cars = straight("east", (-30, -1.6), 0, 10), straight("north", (1.6, -31), NORTH, 10)
    own, other = broken(record_of(*cars), light_road)
    assert "red_light" not in (*own, *other)


def test_right_of_way_by_the_rows_of_the_net(road) -> None:
    east, north = straight("east", (-30, -1.6), 0, 10), straight("north", (1.6, -31), NORTH, 10)
    assert broken(record_of(east, north), road) == ([], ["right_of_way"])
    assert broken(record_of(north, east, route=("SC", "CN")), road) == (["right_of_way"], [])


def test_a_breach_without_a_recorded_entry_has_the_time_of_the_contact(road) -> None:
    """Both are on the junction from the first instant; the record ends 4 s after the contact."""
    east, north = (
        straight("east", (-8, -1.6), 0, 6, steps=61),
        straight("north", (1.6, -10), NORTH, 5, steps=61),
    )
    hit = target_collision(record_of(east, north), collisions(record_of(east, north)))
    assert hit is not None
    view = TrafficView.of_record(record_of(east, north), road)
    (breach,) = breaches_of(view, encounter_of(view, hit), 1)
    assert str(breach.kind) == "right_of_way"
    assert breach.time_s == pytest.approx(DT_S * hit.step)


def test_running_into_a_vehicle_that_has_stood_on_the_junction_for_a_second(road) -> None:
    # the bus enters at 10 m/s and stands across the street from about 2.5 s on; the target comes at 6.6 s
    bus = driven("bus", (1.6, -20), NORTH, braking(10, 0.6, 5.5, 81), size=(10.0, 2.5))
    assert abs(bus.xy_m[-1, 1] + 1.6) < 6.0, "the bus blocks the lane"
    ego = straight("ego", (-80, -1.6), 0, 11, steps=81)
    assert broken(record_of(ego, bus), road) == (["ran_into"], [])
    assert blame(record_of(ego, bus), road) == ("junction", "target")


def test_all_way_stop_the_later_one_gives_way(stop_road) -> None:
    slow = straight("slow", (-20, -1.6), 0, 4, steps=81)
    late = straight("late", (1.6, -60), NORTH, 10, steps=81)
    assert broken(record_of(slow, late), stop_road) == ([], ["right_of_way"])


def test_a_vehicle_that_has_not_reached_the_junction_has_not_joined_there(road) -> None:
    """Only the target has passed the junction, so their ways did not join there.

    "wrong" comes from the east, leaves the junction on the lane for eastward traffic at 4.5 s and meets "on" head-on,
    12 m before the junction.
    """
    steps = np.arange(61)
    left = np.minimum(5.6, np.maximum(0.0, 0.2 * (steps - 20)))  # from y = 1.6 over to -4 between 2 and 4.8 s
    wrong = driven("wrong", (50, 1.6), math.pi, np.full(61, 13.0), left=left)
    on = straight("on", (-68, -4), 0, 8.6, steps=61)
    assert broken(record_of(wrong, on, route=("EC", "CW")), road) == (["wrong_side"], [])
    assert broken(record_of(on, wrong), road) == ([], ["wrong_side"])


def test_both_ends_of_long_vehicles_meet_on_the_junction(road) -> None:
    """Their centres are not on the junction at the contact, whichever party comes first in the record."""
    west = straight("west", (33.5, 5.3), math.pi, 14.2, steps=41, size=(12.0, 2.5))
    south = straight("south", (-2.5, 54.2), -NORTH, 14.0, steps=41, size=(12.0, 2.5))
    assert broken(record_of(west, south, route=("EC", "CW")), road) == ([], ["right_of_way"])
    assert broken(record_of(south, west, route=()), road) == (["right_of_way"], [])


# --- the wrong side --------------------------------------------------------------------------------------


def test_oncoming_vehicle_on_the_targets_side(road) -> None:
    ego = straight("ego", (-150, -1.6), 0, 12)
    coming = straight("coming", (-80, 1.6), math.pi, 12, drift=1.0)  # 2.2 m over at 2.7 s
    assert broken(record_of(ego, coming), road) == ([], ["wrong_side"])
    assert broken(record_of(coming, ego), road) == (["wrong_side"], [])
    both = record_of(straight("ego", (-150, -0.4), 0, 12), straight("coming", (-80, 0.4), math.pi, 12))
    assert broken(both, road) == (["wrong_side"], ["wrong_side"])


def test_swerving_away_from_an_oncoming_vehicle_is_keeping_to_the_side(road) -> None:
    """The target leaves its lane to the right only to avoid the oncoming vehicle."""
    coming = driven("coming", (-80, 1.6), math.pi, np.full(41, 12.0), left=np.linspace(0, 6.4, 41))
    dodge = np.clip((0.1 * np.arange(41) - 1.8) * -2.0, -2.4, 0.0)
    ego = driven("ego", (-150, -1.6), 0, np.full(41, 12.0), left=dodge)
    assert broken(record_of(ego, coming), road) == ([], ["wrong_side"])
    assert blame(record_of(ego, coming), road)[1] == "other"
    assert blame(record_of(coming, ego), road)[1] == "target"


def test_overtaking_on_the_wrong_side_and_hit_from_behind_there(road) -> None:
    wrong = straight("wrong", (-100, 1.6), 0, 8)
    fast = straight("fast", (-120, 1.6), 0, 14)
    assert broken(record_of(wrong, fast), road)[0] == []


def test_a_lorry_that_follows_its_lane_over_a_junction_keeps_its_side(road) -> None:
    """Its bumpers keep to the centre of the lane that turns left, so its long box reaches out of it."""
    names = ("EC_1", "CS_0")
    link = next(x for x in road.lanes[names[0]].successors if x.to_lane == names[1])
    line = concatenate([road.lanes[x].line for x in (link.from_lane, *link.via, link.to_lane)])
    s_m = road.lanes[names[0]].length_m - 15.0 + 6.0 * 0.1 * np.arange(41)
    front, rear = (line.at(s_m + away_m)[0] for away_m in (6.0, -6.0))
    yaw = np.arctan2(*(front - rear).T[::-1])
    lorry = Car("lorry", 0.5 * (front + rear), yaw, np.full(41, 6.0), (12.0, 2.5))
    ego = straight("ego", (-42, -1.6), 0, 12)
    assert broken(record_of(ego, lorry), road) == ([], ["right_of_way"])
    assert broken(record_of(lorry, ego, route=("EC", "CS")), road) == (["right_of_way"], [])


# --- running into somebody -------------------------------------------------------------------------------


def test_running_into_a_vehicle_that_stands_or_brakes_as_expected(road) -> None:
    ego, still = straight("ego", (-100, -1.6), 0, 15), straight("still", (-80, -1.6), 0, 0)
    assert broken(record_of(ego, still), road) == (["ran_into"], [])
    assert broken(record_of(still, ego), road) == ([], ["ran_into"])
    for brake, expected in ((4.0, ["ran_into"]), (6.0, [])):
        lead = driven("lead", (-85, -1.6), 0, braking(12, 0.3, brake, 41))
        assert broken(record_of(straight("ego", (-95, -1.6), 0, 12), lead), road) == (expected, [])


def test_pushed_by_a_third_into_the_one_ahead(road) -> None:
    ahead = straight("ahead", (-80, -1.6), 0, 0)
    ego = driven("ego", (-87, -1.6), 0, np.where(np.arange(41) < 15, 0.0, 5.0))  # pushed on from 1.5 s
    third = driven("third", (-105.4, -1.6), 0, np.where(np.arange(41) < 16, 10.0, 5.0))
    record = record_of(ego, ahead, third)
    hits = [c for c in collisions(record) if 0 in c.rows and 1 in c.rows]
    assert len(hits) == 1
    view = TrafficView.of_record(record, road)
    assert breaches_of(view, encounter_of(view, hits[0]), 0) == ()
    assert str(judged_collision(record, road, hits[0]).fault.at_fault) == "other"


def test_a_target_that_stands_is_not_at_fault(road) -> None:
    """It moves by less than 0.1 m within half a second before it is hit."""
    ego = driven("ego", (-80, -4.8), 0, np.full(41, 0.08))
    cutter = straight("cutter", (-100, -1.6), 0, 10, drift=-1.5)
    assert blame(record_of(ego, cutter), road)[1] == "other"


# --- conduct ---------------------------------------------------------------------------------------------


def test_speeding_counts_for_the_vehicle_that_closes_in(road) -> None:
    # the limit is 13.89 m/s, 1.2 times that 16.67 m/s
    lead = straight("lead", (-120, -1.6), 0, 8)
    for speed, expected in ((16.5, ["ran_into"]), (17.0, ["speeding", "ran_into"])):
        assert broken(record_of(straight("ego", (-150, -1.6), 0, speed), lead), road)[0] == expected
    fast, faster = straight("fast", (-150, -1.6), 0, 17), straight("faster", (-165, -1.6), 0, 24)
    assert broken(record_of(fast, faster), road) == ([], ["speeding", "ran_into"])


def test_reversing(road) -> None:
    ego, back = straight("ego", (-150, -1.6), 0, 2), straight("back", (-130, -1.6), 0, -6)
    assert broken(record_of(ego, back), road) == ([], ["reversing"])
    jitter = driven("jitter", (-130, -1.6), 0, np.where(np.arange(61) % 2, -0.15, 0.15))
    assert broken(record_of(straight("ego", (-150, -1.6), 0, 4, steps=61), jitter), road)[1] == []


def test_leaving_the_road(road) -> None:
    ego = straight("ego", (-150, -4.8), 0, 12)
    out = straight("out", (-120, -30), NORTH, 12)  # over open ground
    assert "off_road" in broken(record_of(ego, out), road)[1]


def test_rules_of_conduct_hold_for_plans(road) -> None:
    plan = record_of(straight("calm", (-150, -1.6), 0, 12), straight("fast", (-150, -4.8), 0, 20)).tracks
    view = TrafficView(plan, road)
    assert conduct_breaches(view, 0, 0, plan.steps) == ()
    assert [str(x.kind) for x in conduct_breaches(view, 1, 0, plan.steps)] == ["speeding"]


# --- left-hand traffic -----------------------------------------------------------------------------------


def mirrored(car):
    """Return *car* with left and right exchanged."""
    return replace(car, xy_m=car.xy_m * (1.0, -1.0), yaw_rad=-car.yaw_rad)


@pytest.fixture(scope="module")
def left_road(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    """The crossing with traffic on the left: the mirror image along the x axis."""
    return crossing(tmp_path_factory.mktemp("left"), "priority", lefthand=True)


def test_left_hand_traffic_is_the_mirror_image(road, left_road) -> None:
    steps = 61
    ego = straight("ego", (-150, -4.8), 0, 15, steps)
    pairs = [
        (ego, straight("cutter", (-138, -1.6), 0, 10, steps, drift=-2.0)),
        (
            straight("ego", (-150, -1.6), 0, 12, steps),
            straight("on", (-80, 1.6), math.pi, 12, steps, drift=1.0),
        ),
        (
            straight("steady", (-150, -1.6), 0, 12, steps),
            straight("drift", (-150, -4.8), 0, 12, steps, drift=1),
        ),
        (straight("lead", (-16, -1.6), 0, 9, steps), straight("chaser", (-45, -1.6), 0, 15, steps)),
        (straight("east", (-30, -1.6), 0, 10, steps), straight("north", (1.6, -31), NORTH, 10, steps)),
    ]
    for pair in pairs:
        here, there = record_of(*pair), record_of(*map(mirrored, pair))
        assert broken(here, road) == broken(there, left_road), pair[1].name
        assert blame(here, road) == blame(there, left_road), pair[1].name


# --- plans -----------------------------------------------------------------------------------------------


def test_the_rules_hold_for_plans(road) -> None:
    """A candidate future of a background vehicle and the expected motion of the target, not driven yet."""
    plan = record_of(
        straight("ego", (-150, -4.8), 0, 15), straight("bv", (-138, -1.6), 0, 10, drift=-2.0)
    ).tracks
    view = TrafficView(plan, road)
    (contact,) = tracks_collisions(plan, target=0)
    case = encounter_of(view, contact)
    assert [str(x.kind) for x in breaches_of(view, case, 1)] == ["unsafe_lane_entry"]
    assert breaches_of(view, case, 0) == ()
