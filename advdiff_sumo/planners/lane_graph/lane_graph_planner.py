"""The rule-based planner: predict, propose, score, choose.

After the road driving of Junior (Montemerlo et al. 2008, doi:10.1002/rob.20258, Sec. 5): a route over the lane
graph, smooth candidates at several lateral offsets along the lane, scored for obstacles and lane keeping, and
precedence at junctions. AdvDiffuser uses such a planner as its rule-based target (Sec. IV).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.bicycle import Limits
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.plan import Plan, Trajectory
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.core.tracking import track
from advdiff_sumo.maps import Link, RoadMap
from advdiff_sumo.planners.lane_graph.chains import route_ahead
from advdiff_sumo.planners.lane_graph.duties import Duties, duties
from advdiff_sumo.planners.lane_graph.lane_graph_options import LaneGraphOptions
from advdiff_sumo.planners.lane_graph.memory import LaneGraphMemory
from advdiff_sumo.planners.lane_graph.others import Others, others_near, ways_of
from advdiff_sumo.planners.lane_graph.path import Geometry
from advdiff_sumo.planners.lane_graph.predict import STEP_S, Ego, Forecast, forecast
from advdiff_sumo.planners.lane_graph.profiles import Modes, drive, leaders, modes
from advdiff_sumo.planners.lane_graph.proposal_score import (
    ProposalStates,
    collision_cost,
    driving_cost,
    followers,
    overrun_cost,
    precedence_cost,
)
from advdiff_sumo.planners.lane_graph.variants import Place, TargetState, Variant, locate, variants

_PLAN_STEP_S = 0.1
_PLAN_STEPS = 20
_CLAIM_M = 60.0
_STOPPED_WITHIN_M = 3.0  # of a line: who stands there has stopped for it
_STOPS_SHORT_M = 1.5  # at most, of the gap that it aims at


class LaneGraphPlanner:
    """Drives the target along its route; see :class:`LaneGraphOptions` for what may be set.

    Raises:
        ConfigError: an option has no such name or value.
    """

    def __init__(self, **options: Any) -> None:
        self.options = LaneGraphOptions.parse(options, "options of target 'lane_graph'")

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> LaneGraphMemory:
        """Return an empty memory with room for the reference lines of *road*."""
        del scene, rng
        return LaneGraphMemory(Geometry.of(road))

    def plan(
        self, road: RoadMap, scene: Scene, memory: LaneGraphMemory, rng: np.random.Generator
    ) -> tuple[Plan, LaneGraphMemory]:
        """Return 2 s of states at 0.1 s that a bicycle drove, and the new memory."""
        del rng
        steps = round(self.options.horizon_s / STEP_S)
        state = TargetState.of(scene, memory.accel_mps2, memory.curvature_1pm)
        geometry = memory.geometry
        waited = scene.time_s - memory.waiting_since_s.get(scene.target_id, scene.time_s)
        # 1. where am I, and which lanes serve the route
        place = locate(geometry, state, scene.routes[scene.target], memory, waited)
        if place is None:
            return _brake(state), memory
        # 2. what will the others do
        others = others_near(scene)
        ways = ways_of(geometry, scene, others)
        ego = Ego(state.xy_m, state.speed_mps, state.length_m, _claims(memory, state))
        future = forecast(road, scene, others, ways, ego, steps)
        # 3. what may I do
        sides = variants(geometry, state, place, memory, self.options)
        rules = list[Duties]()
        for side in sides:
            if rules and side.chain is sides[0].chain:  # shifts within the lane: the same duties
                rules.append(rules[0])
            else:
                rules.append(duties(geometry, scene, state, side, others, ways, memory, self.options))
        choice = modes(sides, rules, self.options)
        candidates = self._candidates(sides, choice, state, others, future, steps)
        # 4. which of it is best
        behind, unsafe = followers(sides, choice, state, others, future)
        cost = unsafe + overrun_cost(choice, rules, candidates, state)
        cost += collision_cost(candidates, state, future, behind, self.options)
        cost += precedence_cost(
            sides,
            choice,
            rules,
            candidates,
            state,
            others,
            ways,
            future,
            memory.committed,
            waited,
            self.options,
        )
        target = next((lane for lane in memory.lanes if not lane.startswith(":")), None)
        cost += driving_cost(sides, choice, candidates, state, target, self.options)
        best = int(np.argmin(cost))
        # 5. drive it as a bicycle
        side = sides[int(choice.variant[best])]
        plan = _driven(side, candidates, best, state)
        rule = rules[int(choice.variant[best])]
        halt = max(_STOPPED_WITHIN_M, self.options.stop_gap_m + _STOPS_SHORT_M)
        return plan, _remember(
            memory, scene, state, place, side, rule, candidates.s_m[best], plan, others, halt
        )

    def _candidates(
        self,
        sides: list[Variant],
        choice: Modes,
        state: TargetState,
        others: Others,
        future: Forecast,
        steps: int,
    ) -> ProposalStates:
        now = replace(
            future,
            xy_m=others.xy_m[future.other][:, None],
            yaw_rad=others.yaw_rad[future.other][:, None],
            speed_mps=others.speed_mps[future.other][:, None],
        )
        ahead = leaders(sides, state, future, now)
        s, speed, accel = drive(sides, choice, ahead, state, self.options, steps)
        xy, yaw = np.empty((*s.shape, 2)), np.empty(s.shape)
        for v, side in enumerate(sides):
            rows = choice.variant == v
            xy[rows], yaw[rows] = side.poses(s[rows])
        return ProposalStates(xy, yaw, speed, s, accel)


def _claims(memory: LaneGraphMemory, state: TargetState) -> tuple[Link, ...]:
    """Return the links ahead on the path chosen last, which those who must yield are expected to leave free."""
    if not memory.lanes:
        return ()
    path = memory.geometry.path(memory.lanes, memory.links)
    s = float(path.project(state.xy_m)[0])
    near = [(a < s + _CLAIM_M) and (s < b) for a, b in zip(path.stop_m, path.exit_m, strict=True)]
    return tuple(link for link, claimed in zip(path.links, near, strict=True) if claimed)


def _driven(side: Variant, candidates: ProposalStates, best: int, state: TargetState) -> Trajectory:
    """Return what a bicycle makes of the chosen candidate."""
    coarse = STEP_S * np.arange(candidates.s_m.shape[1] + 1)
    fine = _PLAN_STEP_S * np.arange(1, _PLAN_STEPS + 1)
    speed = np.interp(fine, coarse, np.append(state.speed_mps, candidates.speed_mps[best]))
    before = np.append(state.speed_mps, speed[:-1])
    s = side.s_m + np.cumsum(0.5 * (speed + before) * _PLAN_STEP_S)
    xy, yaw = side.poses(s)
    start = (state.xy_m, np.asarray(state.yaw_rad), np.asarray(state.speed_mps))
    driven = track(start, (xy, wrap_angle(yaw), speed), np.asarray(state.length_m), _PLAN_STEP_S, Limits())
    return Trajectory(*driven, dt_s=_PLAN_STEP_S)


def _brake(state: TargetState) -> Trajectory:
    """Return a straight stop, for a target that no lane is near to."""
    fine = _PLAN_STEP_S * np.arange(1, _PLAN_STEPS + 1)
    speed = np.maximum(state.speed_mps - 4.0 * fine, 0.0)
    before = np.append(state.speed_mps, speed[:-1])
    s = np.cumsum(0.5 * (speed + before) * _PLAN_STEP_S)
    ahead = np.array([np.cos(state.yaw_rad), np.sin(state.yaw_rad)])
    return Trajectory(state.xy_m + s[:, None] * ahead, np.full(len(s), state.yaw_rad), speed, _PLAN_STEP_S)


def _remember(
    memory: LaneGraphMemory,
    scene: Scene,
    state: TargetState,
    place: Place,
    side: Variant,
    rule: Duties,
    s_m: FloatArray,
    plan: Trajectory,
    others: Others,
    halt_m: float,
) -> LaneGraphMemory:
    """Return what to know at the next plan; who stands *halt_m* or less before a line has stopped there."""
    ahead = [(link, line - side.s_m - state.front_m) for link, line in rule.passing]
    stopped = memory.stopped
    for link, distance in ahead:
        if state.speed_mps < 0.3 and distance < halt_m:
            stopped = (link.from_lane, link.to_lane)
    passed = s_m[-1] + state.front_m
    committed = {(x.from_lane, x.to_lane) for x, line in rule.passing if line < passed}
    over = place.over
    if over is not None:
        committed.add((over.from_lane, over.to_lane))
    curvature, accel = _inputs(plan, state, scene.least_plan_s)
    given = route_ahead(memory.geometry.road, place.lane_id, scene.routes[scene.target] or place.route)
    return replace(
        memory,
        lanes=side.chain.lanes,
        links=side.chain.links,
        route=place.route,
        detour=place.route[:2] != given[:2] and len(given) > 1 and place.route[:1] == given[:1],
        serves=side.chain.serves,
        curvature_1pm=curvature,
        accel_mps2=accel,
        committed=frozenset(committed),
        stopped=stopped,
        waiting_since_s=_waiting(memory, scene, state, others),
    )


def _inputs(plan: Trajectory, state: TargetState, next_s: float) -> tuple[float, float]:
    """Return curvature and acceleration that the plan has when the next one is due, *next_s* from now."""
    k = min(max(round(next_s / plan.dt_s) - 1, 1), len(plan.speed_mps) - 1)
    driven = max(0.5 * float(plan.speed_mps[k] + plan.speed_mps[k - 1]) * plan.dt_s, 1e-3)
    turned = float(wrap_angle(float(plan.yaw_rad[k] - plan.yaw_rad[k - 1])))
    curvature = turned / driven if driven > 0.05 else state.curvature_1pm
    return curvature, float(plan.speed_mps[k] - plan.speed_mps[k - 1]) / plan.dt_s


def _waiting(memory: LaneGraphMemory, scene: Scene, state: TargetState, others: Others) -> dict[str, float]:
    names = [scene.history.ids[row] for row in others.rows.tolist()] + [scene.target_id]
    speeds = [*others.speed_mps.tolist(), state.speed_mps]
    known = memory.waiting_since_s
    pairs = zip(names, speeds, strict=True)
    return {name: known.get(name, scene.time_s) for name, speed in pairs if speed < 0.5}
