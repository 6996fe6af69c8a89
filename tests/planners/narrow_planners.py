"""Define planners that are sound, except that they see only the nearest road users."""

from __future__ import annotations

from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.plan import Plan
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.defects.planted_fault import seen_from_target
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
