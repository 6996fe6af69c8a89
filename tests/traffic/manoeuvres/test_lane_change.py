"""Lane changes that are planned anew each half second: they continue, and take as long as the first plan says."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.scene import AgentClass, Scene, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.manoeuvres.licence_rules import lawful_mask
from advdiff_sumo.traffic.manoeuvres.manoeuvre import LATERAL_MPS, Manoeuvre, futures_of_manoeuvres
from advdiff_sumo.traffic.manoeuvres.repertoire import AFTER_CUT_IN_MPS2, KINDS
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import PLAN_DT_S, SpeedProfile
from advdiff_sumo.traffic.manoeuvres.ways import settling_offsets_m
from tests.traffic.manoeuvres.scenes import LENGTH_M, WIDTH_M, scene_on, view_of

SPEED_MPS, PLANS = 20.0, 12


def test_half_of_a_change_by_hand() -> None:
    """3 m in 3 s from rest: half of it is left after 1.5 s, at 1.5 of the mean speed, and the end is at rest."""
    share = np.array([0.0, 0.5, 1.0, 2.0])
    np.testing.assert_allclose(settling_offsets_m(3.0, 0.0, 3.0 * share, 3.0), [3.0, 1.5, 0.0, 0.0])
    np.testing.assert_allclose(settling_offsets_m(1.5, -1.5, 1.5 * share, 1.5), [1.5, 0.46875, 0.0, 0.0])


@given(st.floats(0.1, 4.0), st.floats(-3.0, 3.0), st.floats(0.5, 4.0), st.floats(0.0, 0.9))
def test_the_rest_of_a_change_is_what_was_planned(
    offset_m: float, drift_mps: float, lasts_s: float, passed: float
) -> None:
    whole = settling_offsets_m(offset_m, drift_mps, np.linspace(0.0, lasts_s, 1001), lasts_s)
    assert whole.min() >= 0.0  # it does not cross the line
    begin = round(1000 * passed)
    left_s = lasts_s * (1.0 - begin / 1000)
    slope = float(np.gradient(whole, lasts_s / 1000)[begin]) if begin else drift_mps
    rest = settling_offsets_m(float(whole[begin]), slope, np.linspace(0.0, left_s, 1001 - begin), left_s)
    np.testing.assert_allclose(rest, whole[begin:], atol=0.02)
    np.testing.assert_allclose(
        settling_offsets_m(-offset_m, -drift_mps, np.array([passed * lasts_s]), lasts_s),
        -whole[[begin]],
        atol=0.02,
    )


def next_scene(scene: Scene, xy_m: FloatArray, yaw_rad: FloatArray) -> Scene:
    """Return *scene* half a second later: the target drives straight on, the other is at this pose."""
    history = scene.history
    target_yaw = history.yaw_rad[0, -1]
    stride = PLAN_DT_S * history.speed_mps[0, -1]
    target = history.xy_m[0, -1] + stride * np.array([np.cos(target_yaw), np.sin(target_yaw)])
    xy = np.concatenate((history.xy_m[:, 1:], np.stack((target, xy_m))[:, None]), axis=1)
    yaw = np.concatenate((history.yaw_rad[:, 1:], np.array([target_yaw, yaw_rad])[:, None]), axis=1)
    later: Tracks = replace(history, xy_m=xy, yaw_rad=yaw, t0_s=history.t0_s + PLAN_DT_S)
    return replace(scene, history=later)


def driven(view: SituationView) -> tuple[list[float], list[float], list[float]]:
    """Return for each plan the other's offset from the target's line, its heading off it, and when it will enter."""
    beside, facing, enters = [], [], []
    target = view.target
    assert target is not None
    line = target.way.line
    along = float(view.scene.history.yaw_rad[0, -1])
    for _ in range(PLANS):
        goal = next((m.goal for m in KINDS["cut-in"](view, 1) if m.goal is not None), None)
        manoeuvre = Manoeuvre("cut-in", 1, view.ways[1], goal=goal)
        enters.append(manoeuvre.enters_s(view.scene.history.xy_m[1, -1]))
        futures = futures_of_manoeuvres([manoeuvre], np.array([SPEED_MPS]))
        xy, yaw, _ = futures.at_model_steps()
        beside.append(abs(float(line.project(xy[0, 0])[1])))
        facing.append(abs(float(wrap_angle(float(yaw[0, 0]) - along))))
        view = SituationView.of(view.road, next_scene(view.scene, xy[0, 0], yaw[0, 0]))
    return beside, facing, enters


def test_a_change_over_many_plans_takes_as_long_as_the_first_plan_says(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, SPEED_MPS), other=(1, 80.0 + LENGTH_M, SPEED_MPS))
    across = abs(view.on_target_way[1][1])
    beside, facing, enters = driven(view)
    assert all(after <= before for before, after in pairwise(beside))
    duration_s = PLAN_DT_S * (1 + next(k for k, left in enumerate(beside) if left < 0.3))
    assert duration_s == pytest.approx(across / LATERAL_MPS, abs=PLAN_DT_S)
    steepest = 1.5 * LATERAL_MPS / SPEED_MPS
    assert 0.8 * steepest < max(facing) < 1.2 * steepest
    assert max(facing[-3:]) < 0.02  # the lane bends by as much
    pending = [time_s for time_s in enters if time_s > 0.0]
    assert len(pending) == pytest.approx(pending[0] / PLAN_DT_S, abs=1.0)  # half a second less in each plan
    for before, after in pairwise(pending):
        assert before - after == pytest.approx(PLAN_DT_S, abs=0.25)


def test_a_vehicle_that_follows_its_lane_has_no_drift(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, SPEED_MPS), other=(1, 80.0, SPEED_MPS))
    assert view.ways[1].drift_mps == pytest.approx(0.0, abs=0.05)


def test_only_positions_on_the_lane_tell_the_drift(motorway: RoadMap) -> None:
    way = view_of(motorway, target=(0, 50.0, SPEED_MPS)).ways[0]
    s = np.array([20.0, 25.0, 30.0])
    left = np.array([1.6, 0.9, 0.4])  # 0.7 m, then 0.5 m: at 0.8 m/s now
    past = way.line.at(s, left)[0]
    assert way.with_drift(past, 0.5).drift_mps == pytest.approx((3 * 0.4 - 4 * 0.9 + 1.6) / 1.0)
    assert way.with_drift(past[1:], 0.5).drift_mps == pytest.approx(-1.0)
    assert way.with_drift(past[2:], 0.5).drift_mps == 0.0
    before = way.line.at(np.array([-15.0, -5.0, 5.0]), left, extrapolate=True)[0]
    assert way.with_drift(before, 0.5).drift_mps == 0.0
    assert way.with_drift(np.full((3, 2), np.nan), 0.5).drift_mps == 0.0


def test_a_lane_change_is_perceived_once_it_slows(motorway: RoadMap) -> None:
    """3.5 m at 1.1 m/s: entry after 1.2 s. Later braking is perceived later, earlier braking not before the entry."""
    view = view_of(motorway, target=(0, 50.0, SPEED_MPS), other=(1, 80.0 + LENGTH_M, SPEED_MPS))
    xy = view.scene.history.xy_m[1, -1]
    change = next(m for m in KINDS["cut-in"](view, 1) if m.goal is not None)
    enters = change.enters_s(xy)
    assert enters == pytest.approx(1.2, abs=0.1)
    for profile, perceived_s in (
        (SpeedProfile(), enters),
        (SpeedProfile(switch_s=2.0, then_mps2=-5.0), 2.0),
        (SpeedProfile(switch_s=0.5, then_mps2=-5.0), enters),
        (SpeedProfile(first_mps2=-2.0, switch_s=2.0, then_mps2=-5.0), enters),
    ):
        assert replace(change, profile=profile).perceivable_s(xy) == perceived_s
    keeps_lane = replace(change, goal=None, profile=SpeedProfile(switch_s=2.0, then_mps2=-5.0))
    assert keeps_lane.perceivable_s(xy) == 0.0


def test_a_cut_in_brakes_once_its_box_is_in_the_lane(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, SPEED_MPS), other=(1, 80.0 + LENGTH_M, SPEED_MPS))
    cut_ins = [m for m in KINDS["cut-in"](view, 1) if m.goal is not None and m.profile.then_mps2 < 0.0]
    assert len(cut_ins) == len(AFTER_CUT_IN_MPS2)
    for change in cut_ins:
        assert change.goal is not None
        across = float(change.goal.line.project(view.scene.history.xy_m[1, -1])[1])
        left = abs(float(change.goal_offsets_m(across, np.array([change.profile.switch_s]))[0]))
        assert left < 0.5 * (change.goal.present_lane.width_m - WIDTH_M)


@pytest.mark.parametrize(("agent_class", "hardest_mps2"), [(AgentClass.CAR, 8.5), (AgentClass.TRUCK, 7.0)])
def test_lorries_brake_no_harder_than_possible(
    motorway: RoadMap, agent_class: AgentClass, hardest_mps2: float
) -> None:
    view = view_of(motorway, target=(0, 50.0, SPEED_MPS), other=(0, 90.0, SPEED_MPS))
    classes = np.array([AgentClass.CAR, agent_class])
    history = replace(view.scene.history, classes=classes)
    view = SituationView.of(motorway, replace(view.scene, history=history))
    stops = [m.profile.then_mps2 for m in KINDS["hard-stop"](view, 1) if not m.is_positioning]
    assert min(stops) == -hardest_mps2
    assert len(set(stops)) == len(stops)


def test_a_vehicle_that_stands_within_a_lane_change_keeps_its_pose(motorway: RoadMap) -> None:
    """A moving one continues onto its lane."""
    view = view_of(motorway, target=(0, 100.0, 20.0), stands=(0, 130.0, 0.0), drives=(0, 160.0, 10.0))
    history = view.scene.history
    xy_m, yaw_rad = history.xy_m.copy(), history.yaw_rad + np.array([[0.0], [0.6], [0.0]])
    xy_m[1:] += 1.2 * np.stack((-np.sin(history.yaw_rad[1:]), np.cos(history.yaw_rad[1:])), axis=-1)
    scene = replace(view.scene, history=replace(history, xy_m=xy_m, yaw_rad=yaw_rad))
    xy, yaw = SituationView.of(motorway, scene).constant_speed_poses(np.array([1, 2]))
    np.testing.assert_array_equal(xy[0], np.broadcast_to(xy_m[1, -1], xy[0].shape))
    np.testing.assert_array_equal(yaw[0], yaw_rad[1, -1])
    assert abs(view.ways[2].line.project(xy[1, -1])[1]) < 0.01


@pytest.mark.parametrize(("speed_mps", "allowed"), [(8.0, True), (14.0, False)])
def test_nobody_cuts_in_on_a_lane_that_ends_too_soon_for_it(
    speed_mps: float, allowed: bool, motorway: RoadMap
) -> None:
    """From 56 m before the end: 3.1 s and a stop with 5 m/s² take 32 m at 8 m/s, 63 m at 14 m/s, beside the reserve."""
    lane = next(x for x in motorway.lanes.values() if x.is_drivable and x.left_id and not x.successors)
    beside = motorway.lanes[lane.left_id]
    place = lane.length_m - 56.0
    cars = {"target": (lane, place - 27.0, speed_mps), "other": (beside, place, speed_mps)}
    view = SituationView.of(motorway, scene_on(cars))
    changes = [m for m in KINDS["cut-in"](view, 1) if m.goal is not None and m.profile.then_mps2 == -5.0]
    futures = futures_of_manoeuvres(changes, np.full(len(changes), speed_mps))
    assert lawful_mask(view, changes, futures).tolist() == [allowed]
