"""A simple planner as a starting point: pure pursuit of the route's lane, and the Intelligent Driver Model (IDM).

It ignores signals and the right of way (IDM: Treiber, Hennecke and Helbing 2000, doi:10.1103/PhysRevE.62.1805)::

    advdiff-sumo run --target examples.follower:Follower
"""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.frames import local_from_world
from advdiff_sumo.core.plan import Controls
from advdiff_sumo.core.polylines import Polyline
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap

STEPS, STEP_S = 10, 0.1
LANE_HALF_WIDTH_M = 1.5
WHEELBASE_SHARE = 0.6
"""Wheelbase as a share of the vehicle's length."""


class Follower:
    """Follows the lane of its route and the lead vehicle in it.

    Args:
        headway_s: desired time headway.
    """

    def __init__(self, headway_s: float = 1.5) -> None:
        self.headway_s = headway_s

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> None:
        """Return the memory of a new episode: None, since none is needed."""
        del road, scene, rng

    def plan(
        self, road: RoadMap, scene: Scene, memory: None, rng: np.random.Generator
    ) -> tuple[Controls, None]:
        """Return accelerations and steering angles for one second."""
        del rng
        now, me, route = scene.history, scene.target, scene.routes[scene.target]
        xy_m, yaw_rad = now.xy_m[me, -1], float(now.yaw_rad[me, -1])
        speed_mps = max(float(now.speed_mps[me, -1]), 0.0)
        pose = road.locate(xy_m, yaw_rad, route=route or None)
        paths = road.lane_path(route, pose.lane_id, 100.0, start_s_m=pose.s_m) if pose and route else []
        if not paths:  # not on a lane, or not on the route: stop
            return _constant(-3.0, 0.0), memory
        x, y = local_from_world(paths[0].line.at(max(5.0, speed_mps))[0], xy_m, yaw_rad)
        curvature = 2.0 * y / max(x * x + y * y, 1.0)
        desired_mps = min(float(paths[0].speed_mps[0]), np.sqrt(2.0 / max(abs(curvature), 1e-3)))
        gap_m, lead_mps = leader(scene, paths[0].line)
        desired_m = 2.0 + speed_mps * self.headway_s + max(speed_mps * (speed_mps - lead_mps) / 3.5, 0.0)
        accel_mps2 = 1.5 * (1.0 - (speed_mps / desired_mps) ** 4 - (desired_m / max(gap_m, 0.5)) ** 2)
        steer_rad = np.arctan(WHEELBASE_SHARE * now.size_m[me, 0] * curvature)
        return _constant(accel_mps2, steer_rad), memory


def leader(scene: Scene, line: Polyline) -> tuple[float, float]:
    """Return the gap in m to the lead vehicle on *line* and its speed in m/s; without one, those of the line's end."""
    now, me = scene.history, scene.target
    length_m = float(now.size_m[me, 0])
    gap_m, lead_mps = line.length_m - 0.5 * length_m, 0.0
    for other in np.flatnonzero(now.valid[:, -1]):
        s_m, offset_m = line.project(now.xy_m[other, -1])
        other_gap_m = float(s_m) - 0.5 * (length_m + now.size_m[other, 0])
        is_ahead = 0.0 < s_m < line.length_m and abs(offset_m) < LANE_HALF_WIDTH_M
        if other != me and is_ahead and other_gap_m < gap_m:
            gap_m, lead_mps = other_gap_m, max(float(now.speed_mps[other, -1]), 0.0)
    return gap_m, lead_mps


def _constant(accel_mps2: float, steer_rad: float) -> Controls:
    """Return a plan with constant acceleration and steering angle, limited to what a car can do."""
    accel, steer = np.clip(accel_mps2, -8.0, 1.5), np.clip(steer_rad, -0.6, 0.6)
    return Controls(np.full(STEPS, accel), np.full(STEPS, steer), STEP_S)
