"""What a baseline expects of the target: a planner that drives it through the imagined future of the others.

The tested planner itself is not at hand while they plan; AdvDiffuser gives its baselines the lane-graph
planner as surrogate (Sec. IV-C), and so is the default here.
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
"""Planners that can stand for the target; by name, as nothing here may import planners."""
MODEL = "model"
_DRIVEN_STEPS = 2
"""Model steps of a surrogate's plan that are driven before it is asked again."""


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
    """What a surrogate does in the real scene, whatever the others are going to do.

    Attributes:
        states: (K, 4) x, y, yaw and speed at the model steps that are driven of its plan, world frame.
        memory: of the surrogate afterwards.
        rng: its random numbers, as it left them.
    """

    states: FloatArray
    memory: Any
    rng: np.random.Generator


def make_surrogate(name: str) -> Surrogate | None:
    """Return the planner *name*; None for "model".

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
    """Return what *planner* does now; all futures that are imagined of one scene begin with it.

    Args:
        road: the map.
        planner: drives the target.
        view: the scene; its agents are all that the planner sees.
        memory: of the planner.
        seed: of the planner's random numbers.
    """
    rng = np.random.default_rng(seed)
    scene = _scene(road, view, view.now)
    plan, memory = planner.plan(road, scene.copied(), memory, rng)
    return Answer(states_of(plan, scene)[:_DRIVEN_STEPS], memory, rng)


def imagine(
    road: RoadMap, planner: Surrogate, view: View, futures: Futures, answer: Answer, steps: int
) -> FloatArray:
    """Let *planner* drive the target for *steps* model steps while the others do what *futures* says.

    Args:
        road: the map.
        planner: drives the target.
        view: the scene.
        futures: of the view's agents, the target's row is not read.
        answer: what it does now.
        steps: at most those of *futures*.

    Returns:
        (steps, 4) x, y, yaw and speed at model steps, world frame.
    """
    own, memory, rng = answer.states, answer.memory, deepcopy(answer.rng)
    while len(own) < steps:
        scene = _scene(road, view, _history(view, futures, own))
        plan, memory = planner.plan(road, scene.copied(), memory, rng)
        own = np.concatenate((own, states_of(plan, scene)[:_DRIVEN_STEPS]))
    return own[:steps]


def states_of(plan: Plan, scene: Scene) -> FloatArray:
    """Return (K, 4) the states that *plan* has at model steps, K at least 1.

    Raises:
        ConfigError: it ends before the first.
    """
    now = scene.history.rows([scene.target])
    here = now.xy_m[0, -1], now.yaw_rad[0, -1], now.speed_mps[0, -1]
    if isinstance(plan, Controls):
        curvature = np.tan(plan.steer_rad) / wheelbase_m(float(now.size_m[0, 0]))
        xy, yaw, speed = rollout(*here, plan.accel_mps2, curvature, plan.dt_s)
    else:
        xy, yaw, speed = plan.xy_m, plan.yaw_rad, plan.speed_mps
    columns = np.column_stack((xy, np.unwrap(np.append(here[1], yaw))[1:], speed))
    columns = np.vstack((np.array([*here[0], here[1], here[2]]), columns))
    known = plan.dt_s * np.arange(len(columns))
    wanted = MODEL_STEP_S * np.arange(1, int(known[-1] / MODEL_STEP_S + 1e-6) + 1)
    if not len(wanted):
        raise ConfigError(
            f"the surrogate's plan lasts {known[-1]:g} s; it must last {MODEL_STEP_S:g} s at least"
        )
    return np.column_stack([np.interp(wanted, known, column) for column in columns.T])


def _history(view: View, futures: Futures, own: FloatArray) -> Tracks:
    """Return everybody's past after ``len(own)`` model steps, in which the target has driven *own* (K, 4)."""
    k, now = len(own), view.now

    def last(past: FloatArray, future: FloatArray, mine: FloatArray) -> FloatArray:
        ahead = future[:, 1 : k + 1].copy()
        ahead[0] = mine
        return np.concatenate((past, ahead), axis=1)[:, -HISTORY_STEPS:]

    valid = np.concatenate((now.valid, np.ones((now.agents, k), dtype=np.bool_)), axis=1)[:, -HISTORY_STEPS:]
    return replace(
        now,
        xy_m=last(now.xy_m, futures.xy_m, own[:, :2]),
        yaw_rad=last(now.yaw_rad, futures.yaw_rad, own[:, 2]),
        speed_mps=last(now.speed_mps, futures.speed_mps, own[:, 3]),
        valid=valid,
        t0_s=now.t0_s + k * now.dt_s,
    )


def _scene(road: RoadMap, view: View, history: Tracks) -> Scene:
    """Return the scene of *view* at the end of *history*."""
    routes = [view.scene.routes[row] for row in view.rows.tolist()]
    routes[0] = _ahead(road, history, routes[0])
    return Scene(history, 0, view.moved, tuple(routes), view.scene.signals)


def _ahead(road: RoadMap, history: Tracks, route: Sequence[str]) -> tuple[str, ...]:
    """Return *route* of the target from the edge that it is on; all of it where it is on none of its edges."""
    lane = road.locate_many(history.xy_m[:1, -1], history.yaw_rad[:1, -1])[0][0]
    edge = road.lanes[lane].edge_id if lane is not None else None
    return tuple(route[route.index(edge) :]) if edge in route else tuple(route)
