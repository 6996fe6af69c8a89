"""Seed scenes of a situation: they contain it, and a message says if it never occurs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from advdiff_sumo.core.errors import SceneError
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.core.signal_letters import GREEN, RED, YELLOW
from advdiff_sumo.maps import Link, RoadMap
from advdiff_sumo.planners.planner_registry import make_target
from advdiff_sumo.sim.episode import Episode
from advdiff_sumo.sim.seed_scene import SeedScene
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sim.warmup_scenes import NaturalTraffic
from advdiff_sumo.traffic.policy_registry import make_policy

OPTIONS = SceneOptions(warmup_s=20.0, scenes_per_warmup=3, density_per_km=10.0, min_speed_mps=4.0)


def scenes(networks: Path, situation: str, net: str = "downtown") -> tuple[RoadMap, list[SeedScene]]:
    road = RoadMap.read(networks / f"{net}.net.xml")
    options = SceneOptions.parse({**OPTIONS.model_dump(), "situation": situation})
    source = NaturalTraffic(road, None, options, SimOptions(), 5.0, SeedTree(3))
    return road, source.batch(0)


def episode_of(scene: SeedScene, road: RoadMap, horizon_s: float = 0.5) -> Any:
    """Return the record of *horizon_s* from *scene* on, and its timing."""
    target, policy = make_target("careful", {}), make_policy("sumo", {})
    return Episode(
        0, scene, road, target, policy, ("careful", "sumo"), SimOptions(), horizon_s, SeedTree(1)
    ).run()


def approach(road: RoadMap, scene: SeedScene) -> tuple[Link, float, float]:
    """Return the target's link over the next junction, the distance of its centre to the stop line, and its speed."""
    now, row = scene.history, scene.history.index[scene.target]
    pose = road.locate(now.xy_m[row, -1], float(now.yaw_rad[row, -1]))
    assert pose is not None
    lane, beyond = road.lanes[pose.lane_id], scene.routes[scene.target][1]
    (link,) = [x for x in lane.successors if road.lanes[x.to_lane].edge_id == beyond]
    return link, lane.length_m - pose.s_m, float(now.speed_mps[row, -1])


def test_a_follower_has_a_leader_in_its_lane(networks: Path) -> None:
    road, found = scenes(networks, "following")
    for scene in found:
        now = scene.history
        row = now.index[scene.target]
        pose = road.locate(now.xy_m[row, -1], float(now.yaw_rad[row, -1]))
        assert pose is not None
        line = road.lanes[pose.lane_id].line
        along, across = line.project(now.xy_m[:, -1])
        ahead = (along > pose.s_m + 1.0) & (np.abs(across) < 1.6)
        assert (ahead & (along < pose.s_m + max(3.5 * now.speed_mps[row, -1], 10.0))).any()


def test_a_turning_target_has_a_turn_ahead(networks: Path) -> None:
    road, found = scenes(networks, "turning")
    for scene in found:
        route = scene.routes[scene.target]
        links = [
            link
            for name in road.edges[route[0]].lane_ids
            for link in road.lanes[name].successors
            if road.lanes[link.to_lane].edge_id == route[1]
        ]
        assert {link.direction.lower() for link in links} <= {"l", "r"}


def edges_ahead_without_change(road: RoadMap, lane_id: str, route: tuple[str, ...]) -> tuple[str, ...]:
    """Return the edges of *route* that can be driven from *lane_id* on without a lane change."""
    lane = road.lanes[lane_id]
    for number, following in enumerate(route[1:], 1):
        beyond = [x.to_lane for x in lane.successors if road.lanes[x.to_lane].edge_id == following]
        if not beyond:
            return route[:number]
        lane = road.lanes[beyond[0]]
    return route


@pytest.mark.parametrize("net", ["downtown", "motorway"])
def test_a_target_that_must_change_lanes_is_beside_another_vehicle(networks: Path, net: str) -> None:
    """Straight on it gets off its route within 100 m or 20 s; somebody is beside it, 14 m behind to 5 m ahead."""
    road, found = scenes(networks, "lane-change", net)
    for scene in found:
        now, row, route = scene.history, scene.history.index[scene.target], scene.routes[scene.target]
        pose = road.locate(now.xy_m[row, -1], float(now.yaw_rad[row, -1]))
        assert pose is not None
        edges = edges_ahead_without_change(road, pose.lane_id, route)
        assert len(edges) < len(route)
        due_m = sum(road.edges[edge].length_m for edge in edges) - pose.s_m
        speed_mps = float(now.speed_mps[row, -1])
        assert max(50.0, 6.0 * speed_mps) - 1.0 < due_m < max(100.0, 20.0 * speed_mps) + 1.0
        lane = road.lanes[pose.lane_id]
        along_m, across_m = lane.line.project(now.xy_m[:, -1], extrapolate=True)
        is_beside = (np.abs(across_m) > 2.0) & (np.abs(across_m) < 5.0)
        assert (is_beside & (along_m - pose.s_m > -14.5) & (along_m - pose.s_m < 5.5)).any()


def test_sumo_drives_a_target_on_the_route_that_needs_a_lane_change(networks: Path) -> None:
    """In the natural log, one of three targets is on the next edge of its route, or on its lane, after 12 s."""
    road = RoadMap.read(networks / "downtown-left.net.xml")
    options = OPTIONS.model_copy(update={"situation": "lane-change"})
    found = NaturalTraffic(road, None, options, SimOptions(), 15.0, SeedTree(3)).batch(0)
    driven = []
    for scene in found:
        log, row, route = scene.log, scene.log.index[scene.target], scene.routes[scene.target]
        places = [
            road.locate(xy, float(yaw), route=list(route))
            for xy, yaw in zip(log.xy_m[row, log.valid[row]], log.yaw_rad[row, log.valid[row]], strict=True)
        ]
        driven.append(
            {road.lanes[place.lane_id].edge_id for place in places if place is not None} & {route[1]}
        )
    assert any(driven)


def test_a_target_that_meets_oncoming_traffic_turns_left_with_priority_from_ahead(networks: Path) -> None:
    """The lane from ahead leads straight over the junction where the target, turning across it, must wait."""
    road, found = scenes(networks, "oncoming")
    for scene in found:
        link, distance_m, _ = approach(road, scene)
        assert 14.9 < distance_m < 60.1
        assert link.direction.lower() == "l"
        from_ahead = [
            x
            for name in road.junctions[link.junction_id].incoming_lanes
            for x in road.lanes[name].successors
            if abs(wrap_angle(_end_yaw(road, name) - _end_yaw(road, link.from_lane))) > np.deg2rad(120.0)
        ]
        assert any(road.must_yield(link, x) and x.direction == "s" for x in from_ahead)


def _end_yaw(road: RoadMap, lane_id: str) -> float:
    return float(road.lanes[lane_id].line.segment_yaw_rad[-1])


def test_a_target_before_a_red_light_is_the_first_one_there(networks: Path) -> None:
    """One of the links of its route at the end of its edge is red in the first step of the episode."""
    road, found = scenes(networks, "red-light")
    for scene in found:
        here, beyond = scene.routes[scene.target][:2]
        lanes = [road.lanes[name] for name in road.edges[here].lane_ids]
        links = [x for lane in lanes for x in lane.successors if road.lanes[x.to_lane].edge_id == beyond]
        record, _ = episode_of(scene, road)
        assert {"r", "u"} & {link.signal(record.signals[0]) for link in links}


def test_a_light_turns_yellow_in_time_to_stop_and_red_before_the_target_arrives(networks: Path) -> None:
    """By the lights in the record of the next eight seconds, if the target keeps its speed."""
    road, found = scenes(networks, "yellow")
    for scene in found:
        link, distance_m, speed_mps = approach(road, scene)
        record, _ = episode_of(scene, road, 8.0)
        letters = [link.signal(states) for states in record.signals]
        assert letters[0] in GREEN
        yellow_s = 0.1 * next(k for k, letter in enumerate(letters) if letter in YELLOW)
        red_s = 0.1 * next(k for k, letter in enumerate(letters) if letter in RED)
        assert red_s - 0.2 <= distance_m / speed_mps <= red_s + 3.2
        assert distance_m - speed_mps * yellow_s >= 0.97 * (speed_mps + speed_mps**2 / 6.0)


@pytest.mark.slow
def test_a_situation_that_never_comes_is_said(networks: Path) -> None:
    road = RoadMap.read(networks / "motorway.net.xml")
    options = OPTIONS.model_copy(update={"situation": "turning", "min_speed_mps": 60.0})
    source = NaturalTraffic(road, None, options, SimOptions(), 5.0, SeedTree(3))
    with pytest.raises(SceneError, match="is 'turning'"):
        source.batch(0)
