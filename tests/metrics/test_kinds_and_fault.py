"""Each kind of collision and each rule of fault on a hand-made record on the crossing.

Right-hand traffic; lanes along x: EC_0 y = 4.8, EC_1 1.6 (westward), WC_1 -1.6, WC_0 -4.8 (eastward);
along y: SC_0 x = 1.6 (northward), NC_0 x = -1.6. The street along x has priority.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.metrics.collision import collisions, target_collision
from advdiff_sumo.metrics.offroad import background_off_road, target_leaves_road
from advdiff_sumo.metrics.safe_gap import safe_gap_m
from advdiff_sumo.metrics.summary import attacker_visible, judged_collision, summarise
from tests.metrics.encounters import braking, driven

NORTH = math.pi / 2


def outcome(record, road) -> tuple[str, str, str]:
    """Return kind, fault and reason of the target's first collision."""
    hit = target_collision(record, collisions(record))
    assert hit is not None, "the record was meant to hold a collision"
    result = judged_collision(record, road, hit)
    return str(result.kind), str(result.fault.at_fault), result.fault.reason


def test_rear_end_striking_and_struck(straight, record_of, road) -> None:
    fast, slow = straight("fast", (-100, -1.6), 0, 15), straight("slow", (-80, -1.6), 0, 10)
    assert outcome(record_of(fast, slow), road)[:2] == ("rear_end_striking", "target")
    kind, fault, reason = outcome(record_of(slow, fast), road)
    assert (kind, fault) == ("rear_end_struck", "other")
    assert reason == "'fast' ran into the rear of the target."


def test_standing_vehicles(straight, record_of, road) -> None:
    moving, still = straight("moving", (-100, -1.6), 0, 15), straight("still", (-80, -1.6), 0, 0)
    assert outcome(record_of(moving, still), road)[1:] == (
        "target",
        "The target ran into 'still', which was standing.",
    )
    assert outcome(record_of(still, moving), road)[1:] == (
        "other",
        "The target stood still when 'moving' ran into it.",
    )


@pytest.mark.parametrize(("stops_after_s", "fault"), [(0.9, "target"), (0.1, "other")])
def test_stopping_in_the_way_of_who_has_priority(straight, record_of, road, stops_after_s, fault) -> None:
    """From 10 m/s, 6 m/s² stop the target in 1.7 s across the lane of the other, who is there at 2.8 or 3.8 s."""
    north = driven("north", (1.6, -19 + 8 * (0.9 - stops_after_s)), NORTH, braking(10, stops_after_s, 6, 61))
    east = straight("east", (-34.5 - 12 * (fault == "other"), -1.6), 0, 12, steps=61)
    record = record_of(north, east, route=("SC", "CN"))
    assert outcome(record, road)[:2] == ("junction", fault)


def test_cut_in_with_too_small_a_gap_is_the_others_fault(straight, record_of, road) -> None:
    ego = straight("ego", (-150, -4.8), 0, 15)
    cutter = straight("cutter", (-138, -1.6), 0, 10, drift=-2.0)
    kind, fault, reason = outcome(record_of(ego, cutter), road)
    assert (kind, fault) == ("cut_in", "other")
    # in the lane (0.3 m over its edge) from 0.5 s: 12 - 0.5 * 5 - 4 = 5.5 m; needed 11.25 + 125 / 12 = 21.7 m
    assert reason == "'cutter' entered the target's lane 5.5 m ahead at 0.5 s, where 21.7 m are needed."
    kind, fault, _ = outcome(record_of(cutter, ego), road)
    assert (kind, fault) == ("cut_in", "target")


def test_a_vehicle_that_appeared_recently_can_cut_in(straight, record_of, road) -> None:
    ego = straight("ego", (-150, -4.8), 0, 15)
    cutter = straight("cutter", (-138, -1.6), 0, 10, drift=-2.0)
    cutter.xy_m[:3] = np.nan  # there from 0.3 s on, in the lane from 0.5 s on: 5.5 m ahead, 21.7 m needed
    kind, fault, reason = outcome(record_of(ego, cutter), road)
    assert (kind, fault) == ("cut_in", "other")
    assert reason == "'cutter' entered the target's lane 5.5 m ahead at 0.5 s, where 21.7 m are needed."


def test_cut_in_with_room_to_brake_is_the_followers_fault(straight, record_of, road) -> None:
    ego = straight("ego", (-150, -4.8), 0, 10)
    cutter = straight("cutter", (-122, -1.6), 0, 2, drift=-2.0)
    cutter.xy_m[16:, 1] = -4.8
    # at 0.5 s: 28 - 4 - 4 = 20 m ahead; needed 7.5 + 96 / 12 = 15.5 m; contact 2.5 s later
    assert outcome(record_of(ego, cutter), road)[:2] == ("cut_in", "target")
    assert outcome(record_of(cutter, ego), road)[:2] == ("cut_in", "other")
    assert safe_gap_m(10, 2) == pytest.approx(15.5)
    assert safe_gap_m(5, 30) == 0.0


def test_a_lane_entered_long_ago_makes_no_cut_in(straight, record_of, road) -> None:
    ego = straight("ego", (-180, -4.8), 0, 12, steps=61)
    lead = straight("lead", (-156, -4.8), 0, 8, steps=61)
    lead.xy_m[:10, 1] = np.linspace(-1.6, -4.8, 10)
    assert outcome(record_of(ego, lead), road)[:2] == ("rear_end_striking", "target")


def test_a_sideswipe_is_the_fault_of_the_drifting_vehicle(straight, record_of, road) -> None:
    steady, drifting = (
        straight("steady", (-150, -1.6), 0, 12),
        straight("drifting", (-150, -4.8), 0, 12, drift=1),
    )
    assert outcome(record_of(steady, drifting), road)[:2] == ("side", "other")
    assert outcome(record_of(drifting, steady), road)[:2] == ("side", "target")


def test_head_on_is_the_fault_of_the_vehicle_that_left_its_side(straight, record_of, road) -> None:
    ego = straight("ego", (-150, -1.6), 0, 12)
    coming = straight("coming", (-80, 1.6), math.pi, 12, drift=1.0)
    assert outcome(record_of(ego, coming), road)[:2] == ("head_on", "other")
    assert outcome(record_of(coming, ego), road)[:2] == ("head_on", "target")


def test_head_on_with_both_over_the_line_is_unclear(straight, record_of, road) -> None:
    ego = straight("ego", (-150, -0.4), 0, 12)
    coming = straight("coming", (-80, 0.4), math.pi, 12)
    assert outcome(record_of(ego, coming), road)[:2] == ("head_on", "unclear")


def test_if_both_left_their_lanes_the_one_that_hits_with_its_front_is_at_fault(
    straight, record_of, road
) -> None:
    """No lane is within 20 m of the two."""
    ego, out = straight("ego", (-100, -40), 0, 10), straight("out", (-70, -60), NORTH, 6.5)
    reason = "The target ran into the side of 'out' with its front."
    assert outcome(record_of(ego, out), road) == ("side", "target", reason)
    assert outcome(record_of(out, ego), road)[:2] == ("side", "other")
    abreast = (
        straight("left", (-100, -40), 0, 10, drift=-0.5),
        straight("right", (-100, -43), 0, 10, drift=0.5),
    )
    assert outcome(record_of(*abreast), road)[:2] == ("side", "unclear")


def test_wrong_way(straight, record_of, road) -> None:
    ego = straight("ego", (-150, -4.8), 0, 12)
    wrong = straight("wrong", (-80, -4.8), math.pi, 12)
    assert outcome(record_of(ego, wrong), road) == (
        "head_on",
        "other",
        "'wrong' drove against the direction of its lane.",
    )
    assert outcome(record_of(wrong, ego), road)[1] == "target"


def test_lane_rules_do_not_apply_to_pedestrians(straight, record_of, road) -> None:
    """They walk beside or across a lane, against its direction. The lane ends at y = -6.4."""
    ego = straight("ego", (-150, -4.8), 0, 12, steps=51)
    pavement = replace(
        straight("walker", (-100, -7.2), math.pi, 1.3, steps=51, size=(0.6, 0.6)),
        agent_class=AgentClass.PEDESTRIAN,
    )
    swerves = straight("ego", (-150, -4.8), 0, 12, steps=51, drift=-0.4)
    assert outcome(record_of(swerves, pavement), road) == (
        "head_on",
        "target",
        "The target was out of its lane, 'walker' was not.",
    )
    # at 120° over the lane, in it from 0.9 s on, 32 m ahead: 9 + 12 = 21 m are needed
    askew = replace(
        straight("walker", (-104, -7.5), math.radians(120), 1.3, steps=51, size=(0.6, 0.6)),
        agent_class=AgentClass.PEDESTRIAN,
    )
    kind, fault, reason = outcome(record_of(ego, askew), road)
    assert (kind, fault) == ("side", "target")
    assert reason.startswith("'walker' entered the target's lane 32.")


def test_reversing(straight, record_of, road) -> None:
    ego = straight("ego", (-150, -1.6), 0, 2)
    back = straight("back", (-130, -1.6), 0, -6)
    assert outcome(record_of(ego, back), road)[1:] == ("other", "'back' was reversing.")


def test_crossing_from_outside_any_lane(straight, record_of, road) -> None:
    ego = straight("ego", (-150, -1.6), 0, 12)
    out = straight("out", (-120, -30), NORTH, 12)  # out of the verge, far from the junction
    kind, fault, _ = outcome(record_of(ego, out), road)
    assert (kind, fault) == ("side", "other")


def crossing_pair(straight, gap: float = 0.0):
    """Return an eastward and a northward car that meet on the junction, the second *gap* s later."""
    east = straight("east", (-30, -1.6), 0, 10)
    north = straight("north", (1.6, -31 - 10 * gap), NORTH, 10)
    return east, north


def test_junction_by_the_right_of_way_rows(straight, record_of, road) -> None:
    east, north = crossing_pair(straight)
    kind, fault, reason = outcome(record_of(east, north, route=("WC", "CE")), road)
    assert (kind, fault) == ("junction", "other")
    assert reason == "'north' had to give way to the target at the junction."
    assert outcome(record_of(north, east, route=("SC", "CN")), road)[:2] == ("junction", "target")


def test_red_light_beats_right_of_way(straight, record_of, light_road) -> None:
    east, north = crossing_pair(straight)
    link = light_road.links["WC_1", "CE_1"]
    other = light_road.links["SC_0", "CN_0"]
    state = ["g"] * (1 + max(x.tls_index for x in light_road.links.values()))
    state[link.tls_index], state[other.tls_index] = "r", "G"
    signals = tuple({link.tls_id: "".join(state)} for _ in range(41))
    record = record_of(east, north, signals=signals)
    assert outcome(record, light_road) == ("junction", "target", "The target entered the junction on red.")
    state[link.tls_index], state[other.tls_index] = "G", "r"
    signals = tuple({link.tls_id: "".join(state)} for _ in range(41))
    assert outcome(replace(record, signals=signals), light_road)[1:] == (
        "other",
        "'north' entered the junction on red.",
    )


def test_all_way_stop_goes_to_the_first(straight, record_of, stop_road) -> None:
    slow = straight("slow", (-20, -1.6), 0, 4, steps=81)
    late = straight("late", (1.6, -60), NORTH, 10, steps=81)
    kind, fault, reason = outcome(record_of(slow, late), stop_road)
    assert (kind, fault) == ("junction", "other")
    assert "before 'late'" in reason
    assert outcome(record_of(late, slow, route=("SC", "CN")), stop_road)[1] == "target"


def test_the_fronts_decide_which_vehicle_comes_first(straight, record_of, stop_road) -> None:
    """The centre of the bus comes 1.1 s after that of the car, but its front comes 0.5 s before the car's.

    The lines lie at x = -7.2 and y = -10.4. The front of the bus passes at 0.5 s, that of the car at 1.0 or 2.0 s.
    """
    bus = straight("bus", (-14.7, -1.6), 0, 3, steps=61, size=(12.0, 2.5))
    at_once = straight("at once", (1.6, -18.4), NORTH, 6, steps=61)
    assert outcome(record_of(bus, at_once), stop_road)[:2] == ("junction", "unclear")
    later = straight("later", (1.6, -24.4), NORTH, 6, steps=61)
    assert outcome(record_of(bus, later), stop_road) == (
        "junction",
        "other",
        "The target was on the junction 1.5 s before 'later'.",
    )


def test_same_approach_on_a_junction_is_a_rear_end(straight, record_of, road) -> None:
    ego, lead = straight("ego", (-32, -1.6), 0, 14), straight("lead", (-14, -1.6), 0, 7)
    assert outcome(record_of(ego, lead), road)[:2] == ("rear_end_striking", "target")


def test_leaving_the_road_is_the_targets_fault(straight, record_of, road) -> None:
    # the carriageway ends at y = -6.4: half the 2 m wide box is beyond it when the centre is
    ego = straight("ego", (-150, -4.8), 0, 10, drift=-1.0)
    record = record_of(ego)
    left = target_leaves_road(record, road)
    assert left is not None
    assert left.time_s == pytest.approx(1.6, abs=0.02)
    metrics = summarise(record, road)
    assert metrics.target_collision
    assert metrics.struck is None
    assert target_leaves_road(record_of(straight("ego", (-150, -20), 0, 10)), road) is None  # never was on it


@pytest.mark.parametrize("agent_class", [AgentClass.PEDESTRIAN, AgentClass.BICYCLE])
def test_pedestrians_and_bicycles_may_leave_the_road(straight, record_of, road, agent_class) -> None:
    """Also as the target, such as one of a log."""
    small = straight("small", (-150, -4.8), 0, 5, drift=-1.0, size=(1.8, 0.6))
    record = record_of(replace(small, agent_class=agent_class))
    assert target_leaves_road(record, road) is None
    assert not summarise(record, road).target_collision
    assert target_leaves_road(record_of(small), road) is not None


def test_the_earlier_of_two_ends_counts(straight, record_of, road) -> None:
    ego = straight("ego", (-150, -4.8), 0, 10, drift=-1.0)
    near, far = straight("near", (-140, -5.5), 0, 0), straight("far", (-120, -7.8), 0, 0)
    assert summarise(record_of(ego, near), road).left_road is None
    later = summarise(record_of(ego, far), road)
    assert (later.struck, later.left_road is not None) == (None, True)


def test_background_off_road_counts_only_what_is_added(straight, record_of, road) -> None:
    ego = straight("ego", (-150, -1.6), 0, 0)
    parked = straight("parked", (-100, -6.4), 0, 0)  # half off the road from the start
    leaving = straight("leaving", (-100, 4.8), math.pi, 5, drift=-1.0)
    alone = background_off_road(record_of(ego, parked), road)
    assert (alone.mean_share, alone.max_share, alone.vehicles) == (pytest.approx(0), pytest.approx(0), 0)
    both = background_off_road(record_of(ego, parked, leaving), road)
    assert both.max_share == pytest.approx(1.0)
    assert both.vehicles == 1
    # every 0.5 s from 0 to 4 s the box has moved 0, 0.5 ... 4 m sideways; 0.6 m of margin, 2 m of width
    added = np.clip((0.5 * np.arange(9) - 0.6) / 2.0, 0.0, 1.0)
    assert both.mean_share == pytest.approx(added.sum() / 18, abs=1e-3)
    assert background_off_road(record_of(ego), road).mean_share is None


def test_visibility_looks_back_one_second(straight, record_of, road) -> None:
    record = record_of(straight("ego", (-100, -1.6), 0, 15), straight("lead", (-80, -1.6), 0, 10))
    hit = target_collision(record, collisions(record))
    assert hit is not None
    assert attacker_visible(record, hit) is None
    for seen_at, expected in (
        (hit.step, True),
        (hit.step - 9, True),
        (hit.step - 10, False),
        (hit.step + 1, False),
    ):
        seen = tuple(frozenset({"lead"} if k == seen_at else ()) for k in range(41))
        assert attacker_visible(replace(record, visible=seen), hit) is expected
