"""Verdicts of encounters worked by hand on the crossing of ``encounters.crossing``; cars are 4 x 2 m."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.collision import collisions, target_collision
from advdiff_sumo.metrics.offroad import target_leaves_road
from advdiff_sumo.metrics.reference.drive_contact import Touch
from advdiff_sumo.metrics.verdict import YARDSTICK, Verdict, avoids, judge
from tests.metrics.encounters import braking, driven, record_of, signals_of, straight

NORTH = math.pi / 2


def verdict(record, road: RoadMap, solvable: bool | None = None) -> Verdict:
    """Return the verdict of the target's first collision."""
    hit = target_collision(record, collisions(record))
    assert hit is not None, "the record was meant to hold a collision"
    return judge(record, road, hit, solvable)


def test_running_into_a_stopping_leader_is_a_valid_failure(road) -> None:
    # 30 m behind at 12 m/s a leader brakes at 3 m/s²: it needs 24 m, the careful driver 9 + 9.5 m
    ego = straight("ego", (-150, -1.6), 0, 12, steps=81)
    lead = driven("lead", (-116, -1.6), 0, braking(12, 0.5, 3.0, 81))
    result = verdict(record_of(ego, lead), road)
    assert result.valid_failure
    assert result.lawful
    assert result.preventable
    assert set(result.preventable_by) >= {"CC_human_driver", "RSS", "FSM"}
    assert not result.unavoidable
    assert result.spare_m is not None
    assert result.spare_m > 1.0
    assert result.impact_left_mps is None
    assert "'lead' broke no rule" in result.sentence
    assert "the target ran into the rear of 'lead'" in result.sentence


def test_a_cut_in_at_a_third_of_a_second_is_unavoidable(road) -> None:
    # a car 1 m ahead at 3 m/s, 0.6 m over the line at once and wholly inside within a second
    ego = straight("ego", (-150, -4.8), 0, 13, steps=41)
    cutter = driven("cutter", (-142, -1.6), 0, np.full(41, 3.0), left=np.maximum(-3.2, -0.8 * np.arange(41)))
    result = verdict(record_of(ego, cutter), road)
    assert not result.valid_failure
    assert not result.lawful
    assert result.preventable is False
    assert result.preventable_by == ()
    assert result.unavoidable is None  # the clairvoyant search was not run
    assert result.impact_left_mps is not None
    assert result.impact_left_mps > 1.0
    assert result.spare_m is None
    assert result.sentence.startswith("Even a careful and competent driver")
    searched = {x: verdict(record_of(ego, cutter), road, solvable=x) for x in (False, True)}
    assert [searched[x].unavoidable for x in (False, True)] == [True, False]
    assert "no drive was found that avoids it; 'cutter'" in searched[False].sentence
    assert "a drive exists that avoids it" in searched[True].sentence


@pytest.mark.parametrize(("present_s", "counts"), [(0.6, False), (0.9, True)])
def test_who_appeared_within_the_time_to_react_is_no_failure(road, present_s: float, counts: bool) -> None:
    """At 10 m/s the front at x = −118 reaches the rear at −82 after 3.6 s."""
    record = record_of(straight("ego", (-120, -1.6), 0, 10), straight("still", (-80, -1.6), 0, 0))
    valid = record.tracks.valid.copy()
    valid[1, : round((3.6 - present_s) / record.tracks.dt_s)] = False
    xy = np.where(valid[..., None], record.tracks.xy_m, np.nan)
    result = verdict(replace(record, tracks=replace(record.tracks, valid=valid, xy_m=xy)), road)
    assert result.valid_failure is counts
    assert (str(result.fault.at_fault) == "target") is counts
    assert ("'still' appeared 0.6 s before, too late to react to" in result.sentence) is not counts


def test_rear_ended_while_standing(road) -> None:
    still, fast = straight("still", (-80, -1.6), 0, 0), straight("fast", (-110, -1.6), 0, 12)
    result = verdict(record_of(still, fast), road)
    assert not result.valid_failure
    assert [str(x.kind) for x in result.other_breaches] == ["ran_into"]
    assert result.target_breaches == ()
    assert result.sentence == (
        "Even a careful and competent driver who stands still is run into at 12.0 m/s; "
        "'fast' ran into the target, which stood."
    )


def test_a_driver_does_not_reverse(road) -> None:
    """The target reverses 6 m into a standing vehicle; a driver who stands where it set off stays clear."""
    back = driven("back", (-80, -1.6), 0, np.where(np.arange(51) < 10, 0.0, -2.0))
    still = straight("still", (-90, -1.6), 0, 0, steps=51)
    result = verdict(record_of(back, still), road)
    assert result.valid_failure
    assert result.sentence == (
        "A careful and competent driver who stands still stays 6.0 m clear; 'still' broke no rule; "
        "the target was reversing."
    )


def test_who_came_from_where(road) -> None:
    """The lorry (18 m) enters beside the target's front; the walker stood; the car comes from off the road."""
    slow = np.full(61, 10.0)
    lorry = driven(
        "lorry", (-108, -4.8), 0, slow, left=np.clip(0.1 * np.arange(-10, 51), 0, 3.2), size=(18, 2.5)
    )
    beside = verdict(record_of(straight("ego", (-114, -1.6), 0, 10, steps=61), lorry), road)
    assert str(beside.kind) == "cut_in"
    assert beside.fault.reason == "'lorry' moved into the lane of the target beside it."
    assert "'lorry' moved sideways into the lane of the target, beside it." in beside.sentence
    ego = straight("ego", (-132, -4.8), 0, 12, steps=61)
    walker = driven(
        "walker", (-100, -4.8), NORTH, 0 * slow, size=(0.6, 0.6), agent_class=AgentClass.PEDESTRIAN
    )
    assert "the target ran into 'walker', who stood." in verdict(record_of(ego, walker), road).sentence
    car = driven("car", (-100, -16), NORTH, np.full(61, 4.0))
    assert "m are needed) and was off the road." in verdict(record_of(ego, car), road).sentence


def test_a_driver_that_stands_where_the_target_set_off_stays_clear(road) -> None:
    """The bumper gap is 0.5 m, from -58 to -57.5; the target accelerates at 2 m/s² from 2 s on."""
    ego = driven("ego", (-60, -4.8), 0, np.maximum(0.0, 0.2 * np.arange(-20, 41)))
    ahead = straight("ahead", (-55.5, -4.8), 0, 0, steps=61)
    result = verdict(record_of(ego, ahead), road)
    assert result.valid_failure
    assert result.sentence.startswith(
        "A careful and competent driver who stands still stays 0.5 m clear; 'ahead' broke no rule"
    )


def test_red_light_runner_seen_from_both_sides(light_road) -> None:
    east, north = straight("east", (-30, -1.6), 0, 10), straight("north", (1.6, -31), NORTH, 10)
    lights = signals_of(light_road, {("WC_1", "CE_1"): "G", ("SC_0", "CN_0"): "r"}, 41)
    result = verdict(record_of(east, north, signals=lights), light_road)
    assert not result.valid_failure
    assert "'north' entered the junction on red" in result.sentence
    mirrored = verdict(record_of(north, east, route=("SC", "CN"), signals=lights), light_road)
    assert mirrored.valid_failure
    assert mirrored.lawful
    assert [str(x.kind) for x in mirrored.target_breaches] == ["red_light"]


def test_what_the_record_lacks_is_named(light_road) -> None:
    east, north = straight("east", (-30, -1.6), 0, 10), straight("north", (1.6, -31), NORTH, 10)
    result = verdict(record_of(east, north, route=()), light_road)
    assert result.not_judged[0] == "red lights (no signals recorded)"
    assert any("no route recorded" in x for x in result.not_judged)
    assert "Not judged: red lights" in result.sentence


@pytest.mark.parametrize(("held", "fault"), [((), "unclear"), (("g", "g"), "target"), (("g", "G"), "target")])
def test_the_right_of_way_at_a_light_is_unknown_without_signals(light_road, held, fault) -> None:
    """The net's rows do not decide here: they apply to two vehicles that have green at the same time."""
    north, east = straight("north", (1.6, -31), NORTH, 10), straight("east", (-30, -1.6), 0, 10)
    ways = ("SC_0", "CN_0"), ("WC_1", "CE_1")
    signals = signals_of(light_road, dict(zip(ways, held, strict=True)), 41) if held else ()
    result = verdict(record_of(north, east, route=("SC", "CN"), signals=signals), light_road)
    assert str(result.fault.at_fault) == fault
    assert [str(x.kind) for x in result.target_breaches] == (["right_of_way"] if held else [])
    assert result.other_breaches == ()
    assert ("right of way (no signals recorded)" in result.not_judged) is (not held)


def test_leaving_the_road_is_a_valid_failure(road) -> None:
    record = record_of(straight("ego", (-150, -4.8), 0, 10, drift=-1.0))
    left = target_leaves_road(record, road)
    assert left is not None
    result = judge(record, road, left)
    assert result.valid_failure
    assert result.lawful is None
    assert result.preventable is None


@pytest.mark.parametrize("solvable", [None, False, True])
def test_preventable_is_never_unavoidable(road, solvable) -> None:
    ego = straight("ego", (-150, -1.6), 0, 12, steps=81)
    lead = driven("lead", (-116, -1.6), 0, braking(12, 0.5, 3.0, 81))
    result = verdict(record_of(ego, lead), road, solvable)
    assert result.solvable is solvable
    assert result.unavoidable is False
    assert "a drive" not in result.sentence


@pytest.mark.parametrize(
    ("gap_m", "contact_step"),
    [
        pytest.param(6.0, 23, id="within the record"),
        pytest.param(14.0, 38, id="after the record's end"),
        pytest.param(60.0, None, id="never"),
    ],
)
def test_a_rear_end_by_a_follower_does_not_count_against_the_driver(road, gap_m, contact_step) -> None:
    # The target drives 12 m/s, 15 m behind a leader at 7 m/s: contact at 3.0 s; the record ends at 3.1 s. The careful
    # driver drives 9.46 m in 0.8 s, 5.34 m in 0.5 s and 3.07 m in 0.4 s, then 6.54 m/s from 1.7 s on. It is then 6.0 m
    # nearer to the leader, and 2.53 m behind the position at constant 12 m/s. A follower at 12 m/s, gap_m behind,
    # reaches it at 1.7 + (gap_m - 2.53) / 5.46 s: 2.34 and 3.80 s. The drive ends 3 s after the record.
    ego, lead = straight("ego", (-150, -1.6), 0, 12, steps=32), straight("lead", (-131, -1.6), 0, 7, steps=32)
    behind = straight("behind", (-154 - gap_m, -1.6), 0, 12, steps=32)
    result = verdict(record_of(ego, lead, behind), road)
    drive = result.drives[YARDSTICK]
    assert drive.contact_step == contact_step
    assert [touch.from_behind for touch in drive.touches] == [True] * len(drive.touches)
    assert result.valid_failure
    assert result.preventable
    assert result.spare_m == pytest.approx(9.0, abs=0.6)
    assert result.sentence.startswith("A careful and competent driver who brakes")


def test_the_remaining_impact_is_that_of_the_collision_that_counts(road) -> None:
    """The contact with the follower comes first, but does not count."""
    ego, lead = (
        straight("ego", (-150, -1.6), 0, 12),
        driven("lead", (-133, -1.6), 0, braking(12, 0.3, 8.0, 41)),
    )
    alone = verdict(record_of(ego, lead), road)
    followed = verdict(record_of(ego, lead, straight("tail", (-155.5, -1.6), 0, 12)), road)
    drive = followed.drives[YARDSTICK]
    assert [touch.name for touch in drive.touches] == ["tail", "lead"]
    assert followed.preventable is False
    assert followed.impact_left_mps == pytest.approx(alone.impact_left_mps)
    assert followed.sentence == alone.sentence
    assert alone.valid_failure is alone.sentence.endswith("; it counts, as the target is at fault.")
    assert alone.valid_failure


def test_a_contact_after_the_record_and_after_one_that_does_not_count_is_reported(road) -> None:
    """The careful driver is hit from behind and stands, with its front at -127.6 m.

    A car comes from the right at 5 m/s, 22.4 m from the driver's side: 4.48 s. The record ends at 3.1 s.
    """
    ego, lead = straight("ego", (-150, -1.6), 0, 12, steps=32), straight("lead", (-110, -1.6), 0, 0, steps=32)
    tail = straight("tail", (-156, -1.6), 0, 12, steps=32)
    result = verdict(record_of(ego, lead, tail, straight("cross", (-128, -27), NORTH, 5, steps=32)), road)
    drive = result.drives[YARDSTICK]
    assert [(touch.name, touch.step) for touch in drive.touches] == [("tail", 16), ("cross", 44)]
    assert drive.states.xy_m[44, 0] == pytest.approx(-129.6, abs=0.1)
    assert result.sentence.startswith(
        "Even a careful and competent driver who brakes 2.2 s before contact is run"
    )
    assert "into by 'cross' at 5.0 m/s" in result.sentence


def test_an_overlap_at_the_takeover_does_not_count_against_the_driver(road) -> None:
    """The log places that car there, so no driver could avoid it. 29 m suffice to stop from 10 m/s."""
    ego, lead = straight("ego", (-150, -1.6), 0, 10, steps=61), straight("lead", (-115, -1.6), 0, 0, steps=61)
    beside = straight("beside", (-152, -3.4), 0, 10, steps=61)  # 0.2 m of it lie in the target
    result = verdict(record_of(ego, lead, beside), road)
    alone = verdict(record_of(ego, lead), road)
    assert result.preventable_by == alone.preventable_by == tuple(alone.drives)
    assert result.sentence == alone.sentence


def test_which_contacts_of_the_careful_driver_count(road) -> None:
    ego, lead = straight("ego", (-150, -1.6), 0, 12, steps=32), straight("lead", (-131, -1.6), 0, 7, steps=32)
    record = record_of(ego, lead, straight("behind", (-200, -1.6), 0, 12, steps=32))
    hit = target_collision(record, collisions(record))
    assert hit is not None
    clear = judge(record, road, hit).drives[YARDSTICK]
    by_behind, by_lead = Touch(40, "behind", 5.0, from_behind=True), Touch(50, "lead", 5.0, from_behind=True)
    in_front = Touch(50, "behind", 5.0, from_behind=False)
    for touches, pusher, outcome in [
        ((), None, True),
        ((by_behind,), None, True),
        ((by_behind,), 2, False),
        ((by_lead,), None, False),
        ((by_behind, by_lead), None, False),
        ((in_front,), None, False),
        ((by_behind, replace(in_front, name="another")), None, False),
        ((replace(in_front, from_start=True),), None, True),
        ((replace(in_front, from_start=True),), 2, False),
    ]:
        assert avoids(record, hit, replace(clear, touches=touches), pusher) is outcome
