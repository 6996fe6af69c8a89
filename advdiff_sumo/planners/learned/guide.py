"""The route as lines to drive along: the target's lane, the one beside it that the route asks for, red lights."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.lane_graph.lane_graph_options import LaneGraphOptions
from advdiff_sumo.planners.lane_graph.memory import LaneGraphMemory as LaneMemory
from advdiff_sumo.planners.lane_graph.rules import Duty, rule_at
from advdiff_sumo.planners.lane_graph.variants import TargetState, Variant, locate, variants

_RED_BRAKE_MPS2, _YELLOW_BRAKE_MPS2 = 6.0, 3.0
_MOVING_M = 0.3


@dataclass(frozen=True)
class Guide:
    """Lines along the route, from the target's present place on.

    Attributes:
        lines: the first keeps the lane; a second one goes to the neighbouring lane that the route needs.
        stop_m: along the first line, where the front has to stop for a signal; inf for nowhere.
        state: the target now.
    """

    lines: tuple[Variant, ...]
    stop_m: float
    state: TargetState


def guide_of(road: RoadMap, scene: Scene, memory: LaneMemory) -> tuple[Guide | None, LaneMemory]:
    """Return the lines to follow, and the memory by which the place is tracked; None off the lanes.

    Args:
        road: the map.
        scene: now.
        memory: of the lane-graph planner, whose tracking of route and lane is used.
    """
    state, geometry = state_of(scene), memory.geometry
    place = locate(geometry, state, scene.routes[scene.target], memory, 0.0)
    if place is None:
        return None, memory
    options = variants(geometry, state, place, memory, LaneGraphOptions())
    keep = options[0]
    wanted = np.sign(keep.chain.changes)
    lines = (keep, *(v for v in options if v.side == wanted and wanted != 0))
    memory = replace(memory, lanes=keep.chain.lanes, links=keep.chain.links, route=place.route)
    return Guide(lines, _signal_line(road, scene, state, keep), state), memory


def state_of(scene: Scene) -> TargetState:
    """Return the target now; its curvature is that of the last model step."""
    row, history = scene.target, scene.history
    return TargetState.of(scene, 0.0, _curvature(history.xy_m[row], history.yaw_rad[row]))


def _curvature(xy_m: FloatArray, yaw_rad: FloatArray) -> float:
    if len(yaw_rad) < 2 or not np.isfinite(yaw_rad[-2]):
        return 0.0
    driven = float(np.hypot(*(xy_m[-1] - xy_m[-2])))
    return float(wrap_angle(float(yaw_rad[-1] - yaw_rad[-2]))) / driven if driven > _MOVING_M else 0.0


def _signal_line(road: RoadMap, scene: Scene, state: TargetState, line: Variant) -> float:
    """Return where the front has to stop: the first line ahead with a light at which one still can."""
    front = line.s_m + state.front_m
    for link, stop in zip(line.path.links, line.path.stop_m, strict=True):
        distance = stop - front
        if distance < -0.5:
            continue
        duty = rule_at(road, link, scene.signals).duty
        brake = state.speed_mps**2 / (2.0 * max(distance, 0.1))
        if (duty is Duty.STOP and brake < _RED_BRAKE_MPS2) or (
            duty is Duty.CLEAR and brake < _YELLOW_BRAKE_MPS2
        ):
            return float(stop)
    return float("inf")
