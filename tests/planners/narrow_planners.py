"""Define planners that are sound, except that they do not see some road users, always or for a while."""

from __future__ import annotations

from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.plan import Plan
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.defects.planted_defect import seen_from_target
from advdiff_sumo.planners.lane_graph.lane_graph_planner import LaneGraphPlanner


class NearestThree(LaneGraphPlanner):
    """``lane_graph`` that sees only the nearest three road users, from centre to centre."""

    most = 3

    def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> tuple[Plan, Any]:
        """Return the plan of a planner that sees no other road users."""
        apart = self.apart_m(scene)
        apart[scene.target] = np.inf
        hidden = np.ones(len(apart), dtype=np.bool_)
        hidden[[scene.target, *np.argsort(apart, kind="stable")[: self.most].tolist()]] = False
        return super().plan(road, scene.without(hidden), memory, rng)

    def apart_m(self, scene: Scene) -> FloatArray:
        """Return (A,) the distance of each road user; inf for those that do not count."""
        place, _ = seen_from_target(scene)
        return np.where(scene.history.valid[:, -1], np.hypot(*place.T), np.inf)


class NearestAhead(NearestThree):
    """``lane_graph`` that sees only the nearest road user ahead of its centre, on whichever lane."""

    most = 1

    def apart_m(self, scene: Scene) -> FloatArray:
        """Return (A,) the distance of each road user ahead; inf for those behind."""
        return np.where(seen_from_target(scene)[0][:, 0] > 0.0, super().apart_m(scene), np.inf)


class WithoutMirrors(LaneGraphPlanner):
    """``lane_graph`` that sees nobody behind its front axle, roughly: neither beside nor behind it."""

    def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> tuple[Plan, Any]:
        """Return the plan of a planner that sees only who is ahead."""
        ahead_m, left_m = seen_from_target(scene)[0].T
        hidden = (ahead_m < -1.0) | ((ahead_m < 4.0) & (np.abs(left_m) > 1.5))
        hidden[scene.target] = False
        return super().plan(road, scene.without(hidden & scene.history.valid[:, -1]), memory, rng)


class WithoutRearMirror(LaneGraphPlanner):
    """``lane_graph`` that sees nobody whose centre is 1 m or more behind its own."""

    def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> tuple[Plan, Any]:
        """Return the plan of a planner that does not see who is behind."""
        hidden = (seen_from_target(scene)[0][:, 0] < -1.0) & scene.history.valid[:, -1]
        hidden[scene.target] = False
        return super().plan(road, scene.without(hidden), memory, rng)


class SetsOffWithoutLooking(LaneGraphPlanner):
    """``lane_graph`` that for 3 s after it has stood sees nobody who heads across its way."""

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> Any:
        """Return the planner's memory, and when it last stood."""
        return super().start(road, scene, rng), -np.inf

    def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> tuple[Plan, Any]:
        """Return the plan of a planner that sees only who drives its way."""
        memory, stood_s = memory
        if scene.history.speed_mps[scene.target, -1] < 0.3:
            stood_s = scene.time_s
        hidden = np.abs(seen_from_target(scene)[1]) > 0.4
        hidden &= (scene.time_s < stood_s + 3.0) & scene.history.valid[:, -1]
        hidden[scene.target] = False
        plan, memory = super().plan(road, scene.without(hidden), memory, rng)
        return plan, (memory, stood_s)
