"""Hand-made scenes on a straight lane of the shipped motorway."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Lane
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView

LENGTH_M, WIDTH_M = 4.5, 1.8


def long_lane(road: RoadMap) -> Lane:
    """Return the rightmost lane of the longest edge with two lanes."""
    edges = [edge for edge in road.edges.values() if len(edge.lane_ids) > 1 and not edge.is_internal]
    longest = max(edges, key=lambda edge: edge.length_m)
    return road.lanes[longest.lane_ids[0]]


def lane_alone(road: RoadMap) -> Lane:
    """Return a driving lane with no lane beside it."""
    return next(
        lane
        for lane in road.lanes.values()
        if lane.is_drivable and not lane.is_internal and not lane.left_id and not lane.right_id
    )


def scene_on(lanes: Mapping[str, tuple[Lane, float, float]], time_s: float = 0.0) -> Scene:
    """Return a scene at *time_s* of vehicles, given as name → (lane, place along it, speed); the target comes first."""
    names = tuple(lanes)
    poses = [lane.line.at(s) for lane, s, _ in lanes.values()]
    count, steps = len(names), 5
    speed = np.array([v for _, _, v in lanes.values()])
    yaw = np.array([float(y) for _, y in poses])
    xy = np.array([p for p, _ in poses])
    back = 0.5 * np.arange(steps - 1, -1, -1)
    heading = np.stack((np.cos(yaw), np.sin(yaw)), axis=-1)
    history = Tracks(
        ids=names,
        classes=np.zeros(count, dtype=np.int64),
        size_m=np.tile([LENGTH_M, WIDTH_M], (count, 1)),
        xy_m=xy[:, None] - (speed[:, None] * back)[..., None] * heading[:, None],
        yaw_rad=np.repeat(yaw[:, None], steps, axis=1),
        speed_mps=np.repeat(speed[:, None], steps, axis=1),
        valid=np.ones((count, steps), dtype=np.bool_),
        t0_s=time_s - 2.0,
        dt_s=0.5,
    )
    movable = np.arange(count) > 0
    return Scene(history, 0, movable, tuple((lane.edge_id,) for lane, _, _ in lanes.values()), {})


def view_of(road: RoadMap, time_s: float = 0.0, **cars: tuple[int, float, float]) -> SituationView:
    """Return a view at *time_s* of cars, name → (lanes left of the rightmost, place, speed); the target comes first."""
    right = long_lane(road)
    lanes = [road.lanes[name] for name in road.edges[right.edge_id].lane_ids]
    return SituationView.of(road, scene_on({n: (lanes[k], s, v) for n, (k, s, v) in cars.items()}, time_s))


def shifted(view: SituationView, row: int, left_m: float, drift_mps: float = 0.0) -> SituationView:
    """Return *view* with *row* *left_m* beside its place, where it has moved with *drift_mps*."""
    history = view.scene.history
    normal = np.array((-np.sin(history.yaw_rad[row, -1]), np.cos(history.yaw_rad[row, -1])))
    past_s = history.dt_s * np.arange(1 - history.steps, 1)
    xy = history.xy_m.copy()
    xy[row] += (left_m + drift_mps * past_s)[:, None] * normal
    return SituationView.of(view.road, replace(view.scene, history=replace(history, xy_m=xy)))
