"""Drive the target by rules: predict, propose, score, choose.

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
from advdiff_sumo.planners.lane_graph.profiles import Combinations, combinations, drive, leaders
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
_CLAIM_M = 60.0  # links within this distance are claimed
_STOPPED_WITHIN_M = 3.0  # a target that stands so close to a stop line has stopped for it
_STOP_TOLERANCE_M = 1.5  # IDM stops so much before the intended gap to the line, at most


class LaneGraphPlanner:
    """Drives the target along its route; for its options see :class:`LaneGraphOptions`.

    Raises:
        ConfigError: an option has no such name or value.
    """

    def __init__(self, **options: Any) -> None:
        self.options = LaneGraphOptions.parse(options, "options of target 'lane_graph'")

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> LaneGraphMemory:
        """Return an empty memory with a cache for the reference lines of *road*."""
        del scene, rng
        return LaneGraphMemory(Geometry.of(road))

    def plan(
        self, road: RoadMap, scene: Scene, memory: LaneGraphMemory, rng: np.random.Generator
    ) -> tuple[Plan, LaneGraphMemory]:
        """Return 2 s of states at steps of 0.1 s, driven by a bicycle model, and the new memory."""
        del rng
        steps = round(self.options.horizon_s / STEP_S)
        state = TargetState.of(scene, memory.accel_mps2, memory.curvature_1pm)
        geometry = memory.geometry
        waited_s = scene.time_s - memory.waiting_since_s.get(scene.target_id, scene.time_s)
        # 1. Locate the target, and find the lanes that follow the route.
        place = locate(geometry, state, scene.routes[scene.target], memory, waited_s)
        if place is None:
            return _brake(state), memory
        # 2. Predict the others.
        others = others_near(scene)
        ways = ways_of(geometry, scene, others)
        ego = Ego(state.xy_m, state.speed_mps, state.length_m, _claims(memory, state))
        predicted = forecast(road, scene, others, ways, ego, steps)
        # 3. Propose candidates.
        lateral = variants(geometry, state, place, memory, self.options)
        all_duties = list[Duties]()
        for variant in lateral:
            # shifts within the lane have the same duties
            if all_duties and variant.chain is lateral[0].chain:
                all_duties.append(all_duties[0])
            else:
                all_duties.append(duties(geometry, scene, state, variant, others, ways, memory, self.options))
        combos = combinations(lateral, all_duties, self.options)
        candidates = self._candidates(lateral, combos, state, others, predicted, steps)
        # 4. Score the candidates and choose the cheapest.
        ignored, unsafe = followers(lateral, combos, state, others, predicted)
        cost = unsafe + overrun_cost(combos, all_duties, candidates, state)
        cost += collision_cost(candidates, state, predicted, ignored, self.options)
        cost += precedence_cost(
            lateral,
            combos,
            all_duties,
            candidates,
            state,
            others,
            ways,
            predicted,
            memory.committed,
            waited_s,
            self.options,
        )
        target_lane = next((lane for lane in memory.lanes if not lane.startswith(":")), None)
        cost += driving_cost(lateral, combos, candidates, state, target_lane, self.options)
        chosen = int(np.argmin(cost))
        # 5. Follow it with a bicycle model.
        variant = lateral[int(combos.variant[chosen])]
        plan = _driven(variant, candidates, chosen, state)
        own_duties = all_duties[int(combos.variant[chosen])]
        halt_m = max(_STOPPED_WITHIN_M, self.options.stop_gap_m + _STOP_TOLERANCE_M)
        return plan, _remember(
            memory, scene, state, place, variant, own_duties, candidates.s_m[chosen], plan, others, halt_m
        )

    def _candidates(
        self,
        lateral: list[Variant],
        combos: Combinations,
        state: TargetState,
        others: Others,
        predicted: Forecast,
        steps: int,
    ) -> ProposalStates:
        """Return the candidates: the poses, speeds and accelerations of each combination."""
        now = replace(
            predicted,
            xy_m=others.xy_m[predicted.other][:, None],
            yaw_rad=others.yaw_rad[predicted.other][:, None],
            speed_mps=others.speed_mps[predicted.other][:, None],
        )
        leading = leaders(lateral, state, predicted, now)
        s, speed, accel = drive(lateral, combos, leading, state, self.options, steps)
        xy, yaw = np.empty((*s.shape, 2)), np.empty(s.shape)
        for v, variant in enumerate(lateral):
            rows = combos.variant == v
            xy[rows], yaw[rows] = variant.poses(s[rows])
        return ProposalStates(xy, yaw, speed, s, accel)


def _claims(memory: LaneGraphMemory, state: TargetState) -> tuple[Link, ...]:
    """Return the links ahead on the previous path; vehicles that must yield there are expected to do so."""
    if not memory.lanes:
        return ()
    path = memory.geometry.path(memory.lanes, memory.links)
    s = float(path.project(state.xy_m)[0])
    near = [line < s + _CLAIM_M and s < beyond for line, beyond in zip(path.stop_m, path.exit_m, strict=True)]
    return tuple(link for link, claimed in zip(path.links, near, strict=True) if claimed)


def _driven(variant: Variant, candidates: ProposalStates, chosen: int, state: TargetState) -> Trajectory:
    """Return the trajectory of a bicycle model that follows the chosen candidate."""
    candidate_time_s = STEP_S * np.arange(candidates.s_m.shape[1] + 1)
    time_s = _PLAN_STEP_S * np.arange(1, _PLAN_STEPS + 1)
    speed = np.interp(time_s, candidate_time_s, np.append(state.speed_mps, candidates.speed_mps[chosen]))
    previous = np.append(state.speed_mps, speed[:-1])
    s = variant.s_m + np.cumsum(0.5 * (speed + previous) * _PLAN_STEP_S)
    xy, yaw = variant.poses(s)
    present = (state.xy_m, np.asarray(state.yaw_rad), np.asarray(state.speed_mps))
    driven = track(present, (xy, wrap_angle(yaw), speed), np.asarray(state.length_m), _PLAN_STEP_S, Limits())
    return Trajectory(*driven, dt_s=_PLAN_STEP_S)


def _brake(state: TargetState) -> Trajectory:
    """Return a straight stop, for a target that is near no lane."""
    time_s = _PLAN_STEP_S * np.arange(1, _PLAN_STEPS + 1)
    speed = np.maximum(state.speed_mps - 4.0 * time_s, 0.0)
    previous = np.append(state.speed_mps, speed[:-1])
    s = np.cumsum(0.5 * (speed + previous) * _PLAN_STEP_S)
    ahead = np.array([np.cos(state.yaw_rad), np.sin(state.yaw_rad)])
    return Trajectory(state.xy_m + s[:, None] * ahead, np.full(len(s), state.yaw_rad), speed, _PLAN_STEP_S)


def _remember(
    memory: LaneGraphMemory,
    scene: Scene,
    state: TargetState,
    place: Place,
    variant: Variant,
    own_duties: Duties,
    s_m: FloatArray,
    plan: Trajectory,
    others: Others,
    halt_m: float,
) -> LaneGraphMemory:
    """Return the memory for the next plan.

    A target that stands *halt_m* or less before a stop line has stopped for it.
    """
    ahead = [(link, line - variant.s_m - state.front_m) for link, line in own_duties.passing]
    stopped = memory.stopped
    for link, distance in ahead:
        if state.speed_mps < 0.3 and distance < halt_m:
            stopped = (link.from_lane, link.to_lane)
    end_m = s_m[-1] + state.front_m
    committed = {(x.from_lane, x.to_lane) for x, line in own_duties.passing if line < end_m}
    current_link = place.link
    if current_link is not None:
        committed.add((current_link.from_lane, current_link.to_lane))
    curvature, accel = _inputs(plan, state, scene.least_plan_s)
    route_on = route_ahead(memory.geometry.road, place.lane_id, scene.routes[scene.target] or place.route)
    return replace(
        memory,
        lanes=variant.chain.lanes,
        links=variant.chain.links,
        route=place.route,
        detour=place.route[:2] != route_on[:2] and len(route_on) > 1 and place.route[:1] == route_on[:1],
        follows_route=variant.chain.follows_route,
        curvature_1pm=curvature,
        accel_mps2=accel,
        committed=frozenset(committed),
        stopped=stopped,
        waiting_since_s=_waiting(memory, scene, state, others),
    )


def _inputs(plan: Trajectory, state: TargetState, next_s: float) -> tuple[float, float]:
    """Return the planned curvature and acceleration at the next plan, *next_s* from now."""
    k = min(max(round(next_s / plan.dt_s) - 1, 1), len(plan.speed_mps) - 1)
    driven = max(0.5 * float(plan.speed_mps[k] + plan.speed_mps[k - 1]) * plan.dt_s, 1e-3)
    turned = float(wrap_angle(float(plan.yaw_rad[k] - plan.yaw_rad[k - 1])))
    curvature = turned / driven if driven > 0.05 else state.curvature_1pm
    return curvature, float(plan.speed_mps[k] - plan.speed_mps[k - 1]) / plan.dt_s


def _waiting(memory: LaneGraphMemory, scene: Scene, state: TargetState, others: Others) -> dict[str, float]:
    """Return the time at which each vehicle that stands now came to a stop."""
    ids = [scene.history.ids[row] for row in others.rows.tolist()] + [scene.target_id]
    speeds = [*others.speed_mps.tolist(), state.speed_mps]
    since_s = memory.waiting_since_s
    pairs = zip(ids, speeds, strict=True)
    return {vehicle_id: since_s.get(vehicle_id, scene.time_s) for vehicle_id, speed in pairs if speed < 0.5}
