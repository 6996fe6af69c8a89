"""Speed without other road users: limits and bends of a motorway and of junctions, worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.manoeuvres.free_speed import FINE_TIMES_S, can_slow_for_bends, speeds_along
from advdiff_sumo.traffic.manoeuvres.required_braking import TargetWay, contact_share
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import CHECK_TIMES_S
from tests.traffic.manoeuvres.scenes import scene_on, view_of


def test_on_a_free_straight_the_speed_grows_by_half_a_metre_per_second_squared(motorway: RoadMap) -> None:
    """From 20 m/s it reaches 23 m/s and 129 m after 6 s. For 60 m, 20 t + t²/4 = 60, so t = 2.9 s."""
    target = view_of(motorway, target=(0, 50.0, 20.0)).target
    assert target is not None
    assert speeds_along(target.way, 20.0)[-1] == pytest.approx(23.0)
    assert target.free_distance_m[-1] == pytest.approx(129.0, abs=0.01)
    assert target.arrival_s(60.0) == pytest.approx(2.9, abs=0.06)
    assert target.arrival_s(500.0) == np.inf


def test_a_speed_above_the_limit_is_kept(motorway: RoadMap) -> None:
    target = view_of(motorway, target=(0, 50.0, 60.0)).target
    assert target is not None
    assert target.way.present_lane.speed_mps < 60.0
    assert speeds_along(target.way, 60.0)[:20] == pytest.approx(np.full(20, 60.0))


def test_braking_distance(motorway: RoadMap) -> None:
    """From 20 m/s at 8 m/s² at once: 25 m."""
    target = view_of(motorway, target=(0, 50.0, 20.0)).target
    assert target is not None
    driven, speed = target.braked_motion((8.0, 0.0), 0.0)
    assert driven[:, -1] == pytest.approx([25.0, 129.0], abs=0.05)
    assert speed[0, -1] == 0.0


def test_a_turning_vehicle_slows_for_the_bend(downtown: RoadMap) -> None:
    """A quarter turn over L metres has a radius of 2 L / π. At 2.5 m/s² it is driven at √(5 L / π)."""
    turns = [
        (lane, link)
        for lane in downtown.lanes.values()
        for link in lane.successors
        if not lane.is_internal and lane.length_m > 60.0 and link.direction == "r" and len(link.via) == 1
    ]
    assert turns
    for lane, link in turns[:5]:
        to = downtown.lanes[link.to_lane].edge_id
        scene = replace(
            scene_on({"target": (lane, lane.length_m - 25.0, 11.0)}), routes=((lane.edge_id, to),)
        )
        target = SituationView.of(downtown, scene).target
        assert target is not None
        bend = downtown.lanes[link.via[0]]
        yaw = bend.line.segment_yaw_rad
        turned = abs((float(yaw[-1] - yaw[0]) + np.pi) % (2.0 * np.pi) - np.pi)
        slowest = min(float(np.sqrt(2.5 * bend.length_m / turned)), bend.speed_mps)
        inside = (target.free_distance_m > 25.2) & (target.free_distance_m < 24.8 + bend.length_m)
        assert inside.any()
        assert np.diff(speeds_along(target.way, 11.0)).min() > -4.01 * FINE_TIMES_S[1]
        assert target.free_speed_mps[inside].max() < slowest + 0.3


def test_a_contact_that_does_not_depend_on_timing_has_a_share_of_one(motorway: RoadMap) -> None:
    """A vehicle that stands ahead is always hit; one that crosses at exactly one instant rarely."""
    target = view_of(motorway, target=(0, 50.0, 20.0)).target
    assert isinstance(target, TargetWay)
    ahead, yaw = target.way.line.at(target.way.lane.s_m + 60.0)
    across = np.array((-np.sin(float(yaw)), np.cos(float(yaw))))
    off_m = np.where(np.abs(CHECK_TIMES_S - 3.0) < 0.1, 0.0, 50.0)
    futures = np.stack((np.tile(ahead, (len(off_m), 1)), ahead + off_m[:, None] * across))
    size = np.full((2, 2), (4.5, 1.8))
    share = contact_share(target, futures, np.full(futures.shape[:2], float(yaw)), size)
    assert share[0] == 1.0
    assert 0.0 < share[1] < 0.6


def test_whether_a_vehicle_can_slow_for_a_bend(downtown: RoadMap) -> None:
    """A quarter turn over L metres allows √(8 L / π) at 4 m/s², and √(8 L / π + 150) 25 m before it, with 3 m/s²."""
    lane, link = next(
        (lane, link)
        for lane in downtown.lanes.values()
        for link in lane.successors
        if not lane.is_internal and lane.length_m > 60.0 and link.direction == "r" and len(link.via) == 1
    )
    scene = replace(
        scene_on({"target": (lane, lane.length_m - 35.0, 11.0)}),
        routes=((lane.edge_id, downtown.lanes[link.to_lane].edge_id),),
    )
    way = SituationView.of(downtown, scene).ways[0]
    bend = downtown.lanes[link.via[0]]
    turned = abs(float(bend.line.segment_yaw_rad[-1] - bend.line.segment_yaw_rad[0]))
    in_bend = 4.0 * bend.length_m / turned
    for driven, most in ((10.0, np.sqrt(in_bend + 150.0)), (36.0, np.sqrt(in_bend))):
        assert can_slow_for_bends(way, driven, 0.99 * most)
        assert not can_slow_for_bends(way, driven, 1.01 * most)
    assert can_slow_for_bends(way, 36.0 + bend.length_m, 20.0), "the bend is behind"
