"""Predicts the target's reaction for the baselines: a surrogate planner drives it among planned futures.

The tested planner itself is not available while a baseline plans. AdvDiffuser gives its baselines the lane-graph
planner as surrogate (Sec. IV-C), which is also the default here.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any, Protocol, cast

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.bicycle import rollout, wheelbase_m
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.plan import Controls, Plan
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.model_options import HISTORY_STEPS, MODEL_STEP_S
from advdiff_sumo.models.view import View
from advdiff_sumo.plugins import Registry
from advdiff_sumo.traffic.planning.futures import Futures

SURROGATES = Registry(
    kind="surrogate",
    group="advdiff_sumo.planners",
    builtins={"lane_graph": "advdiff_sumo.planners.lane_graph:LaneGraphPlanner"},
)
"""Planners that can represent the target; by name, as ``traffic`` must not import planners."""
MODEL = "model"
_DRIVEN_STEPS = 2
"""Model steps of a surrogate's plan that are driven before it plans again."""


class Surrogate(Protocol):
    """A planner as in ``planners.planner_protocol``."""

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> Any:
        """Return the memory for an episode that begins in *scene*."""
        ...

    def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> tuple[Plan, Any]:
        """Return a plan of the target, at least one model step long, and the new memory."""
        ...


@dataclass(frozen=True)
class Answer:
    """The surrogate's plan in the real scene, before it reacts to planned futures.

    Attributes:
        states: (K, 4) x, y, yaw and speed at the driven model steps of its plan, world frame.
        memory: memory of the surrogate afterwards.
        rng: its random generator afterwards.
    """

    states: FloatArray
    memory: Any
    rng: np.random.Generator


def make_surrogate(name: str) -> Surrogate | None:
    """Return the planner called *name*; None for "model".

    Raises:
        UnknownNameError: there is none of that name.
        ConfigError: it cannot be imported, or does not plan.
    """
    if name == MODEL:
        return None
    factory = SURROGATES.load(name)
    if not all(callable(getattr(factory, method, None)) for method in ("start", "plan")):
        raise ConfigError(
            f"surrogate '{name}' cannot stand for the target: it is no class with the methods start and plan; "
            "give a planner, or leave it at lane_graph"
        )
    return cast("Surrogate", factory())


def ask(road: RoadMap, planner: Surrogate, view: View, memory: Any, seed: int) -> Answer:
    """Return the plan of *planner* in the present scene, with which all its reactions in this scene begin.

    Args:
        road: the map.
        planner: drives the target.
        view: the scene; the planner sees its agents only.
        memory: memory of the planner.
        seed: seed of the planner's random numbers.
    """
    rng = np.random.default_rng(seed)
    scene = _scene(road, view, view.now)
    plan, memory = planner.plan(road, scene.copied(), memory, rng)
    return Answer(states_of(plan, scene)[:_DRIVEN_STEPS], memory, rng)


def drive_surrogate(
    road: RoadMap, planner: Surrogate, view: View, futures: Futures, answer: Answer, steps: int
) -> FloatArray:
    """Let *planner* drive the target for *steps* model steps while the others drive *futures*.

    Args:
        road: the map.
        planner: drives the target.
        view: the scene.
        futures: futures of the view's agents; the target's row is not read.
        answer: the planner's plan in the present scene.
        steps: number of steps, at most those of *futures*.

    Returns:
        (steps, 4) x, y, yaw and speed at model steps, world frame.
    """
    states, memory, rng = answer.states, answer.memory, deepcopy(answer.rng)
    while len(states) < steps:
        scene = _scene(road, view, _history(view, futures, states))
        plan, memory = planner.plan(road, scene.copied(), memory, rng)
        states = np.concatenate((states, states_of(plan, scene)[:_DRIVEN_STEPS]))
    return states[:steps]


def states_of(plan: Plan, scene: Scene) -> FloatArray:
    """Return the states (K, 4) of *plan* at model steps; K is at least 1.

    Raises:
        ConfigError: the plan ends before the first model step.
    """
    now = scene.history.rows([scene.target])
    present = now.xy_m[0, -1], now.yaw_rad[0, -1], now.speed_mps[0, -1]
    if isinstance(plan, Controls):
        curvature = np.tan(plan.steer_rad) / wheelbase_m(float(now.size_m[0, 0]))
        xy, yaw, speed = rollout(*present, plan.accel_mps2, curvature, plan.dt_s)
    else:
        xy, yaw, speed = plan.xy_m, plan.yaw_rad, plan.speed_mps
    columns = np.column_stack((xy, np.unwrap(np.append(present[1], yaw))[1:], speed))
    columns = np.vstack((np.array([*present[0], present[1], present[2]]), columns))
    plan_time = plan.dt_s * np.arange(len(columns))
    model_time = MODEL_STEP_S * np.arange(1, int(plan_time[-1] / MODEL_STEP_S + 1e-6) + 1)
    if not len(model_time):
        raise ConfigError(
            f"the surrogate's plan lasts {plan_time[-1]:g} s; it must last {MODEL_STEP_S:g} s at least"
        )
    return np.column_stack([np.interp(model_time, plan_time, column) for column in columns.T])


def _history(view: View, futures: Futures, states: FloatArray) -> Tracks:
    """Return the history K model steps from now, in which the target has driven *states* (K, 4)."""
    k, now = len(states), view.now

    def latest(past: FloatArray, future: FloatArray, target: FloatArray) -> FloatArray:
        driven = future[:, 1 : k + 1].copy()
        driven[0] = target
        return np.concatenate((past, driven), axis=1)[:, -HISTORY_STEPS:]

    valid = np.concatenate((now.valid, np.ones((now.agents, k), dtype=np.bool_)), axis=1)[:, -HISTORY_STEPS:]
    return replace(
        now,
        xy_m=latest(now.xy_m, futures.xy_m, states[:, :2]),
        yaw_rad=latest(now.yaw_rad, futures.yaw_rad, states[:, 2]),
        speed_mps=latest(now.speed_mps, futures.speed_mps, states[:, 3]),
        valid=valid,
        t0_s=now.t0_s + k * now.dt_s,
    )


def _scene(road: RoadMap, view: View, history: Tracks) -> Scene:
    """Return the scene of *view* at the end of *history*."""
    routes = [view.scene.routes[row] for row in view.rows.tolist()]
    routes[0] = _route_ahead(road, history, routes[0])
    return Scene(history, 0, view.moved, tuple(routes), view.scene.signals)


def _route_ahead(road: RoadMap, history: Tracks, route: Sequence[str]) -> tuple[str, ...]:
    """Return the target's *route* from its present edge on; all of it if that edge is not on it."""
    lane = road.locate_many(history.xy_m[:1, -1], history.yaw_rad[:1, -1])[0][0]
    edge = road.lanes[lane].edge_id if lane is not None else None
    return tuple(route[route.index(edge) :]) if edge in route else tuple(route)
