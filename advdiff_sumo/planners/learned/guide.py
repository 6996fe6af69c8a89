"""Find the lines along the route: the target's lane, the neighbouring lane that the route needs, red lights."""

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

_RED_BRAKE_MPS2, _YELLOW_BRAKE_MPS2 = 6.0, 3.0  # the target does not stop for a signal if that needs more
_MIN_STEP_M = 0.3  # a shorter step says nothing of the curvature


@dataclass(frozen=True)
class Guide:
    """Lines along the route, from the target's present position on.

    Attributes:
        lines: the first one keeps the lane; a second one leads to the neighbouring lane that the route needs.
        stop_m: arc length along the first line at which the front must stop for a signal; inf for none.
        state: present state of the target.
    """

    lines: tuple[Variant, ...]
    stop_m: float
    state: TargetState


def guide_of(road: RoadMap, scene: Scene, memory: LaneMemory) -> tuple[Guide | None, LaneMemory]:
    """Return the lines to follow, None off the lanes, and the memory for tracking the lane.

    Args:
        road: the map.
        scene: the present scene.
        memory: memory of the lane-graph planner, whose tracking of route and lane is used.
    """
    state, geometry = state_of(scene), memory.geometry
    place = locate(geometry, state, scene.routes[scene.target], memory, 0.0)
    if place is None:
        return None, memory
    choices = variants(geometry, state, place, memory, LaneGraphOptions())
    keep = choices[0]
    needed_side = np.sign(keep.chain.changes)
    lines = (keep, *(choice for choice in choices if choice.side == needed_side and needed_side != 0))
    memory = replace(memory, lanes=keep.chain.lanes, links=keep.chain.links, route=place.route)
    return Guide(lines, _signal_line(road, scene, state, keep), state), memory


def state_of(scene: Scene) -> TargetState:
    """Return the present state of the target, with the curvature of the last model step."""
    row, history = scene.target, scene.history
    return TargetState.of(scene, 0.0, _curvature(history.xy_m[row], history.yaw_rad[row]))


def _curvature(xy_m: FloatArray, yaw_rad: FloatArray) -> float:
    """Return the curvature driven over the last step; 0 if unknown or nearly standing."""
    if len(yaw_rad) < 2 or not np.isfinite(yaw_rad[-2]):
        return 0.0
    driven = float(np.hypot(*(xy_m[-1] - xy_m[-2])))
    return float(wrap_angle(float(yaw_rad[-1] - yaw_rad[-2]))) / driven if driven > _MIN_STEP_M else 0.0


def _signal_line(road: RoadMap, scene: Scene, state: TargetState, line: Variant) -> float:
    """Return the arc length of the first stop line ahead at which the target must and can stop; inf for none."""
    front = line.s_m + state.front_m
    for link, stop in zip(line.path.links, line.path.stop_m, strict=True):
        distance = stop - front
        if distance < -0.5:
            continue
        duty = rule_at(road, link, scene.signals).duty
        required_mps2 = state.speed_mps**2 / (2.0 * max(distance, 0.1))
        if (duty is Duty.STOP and required_mps2 < _RED_BRAKE_MPS2) or (
            duty is Duty.CLEAR and required_mps2 < _YELLOW_BRAKE_MPS2
        ):
            return float(stop)
    return float("inf")
