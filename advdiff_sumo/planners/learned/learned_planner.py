"""Drive the target by a trained traffic model: sample joint futures, make candidates from them, choose one.

A traffic model knows no route and no rules. The planner draws several futures. It prefers the candidate that
stays on the road and the route and collides in no sample. Candidates are the target's motion in each sample,
each sample's speeds along the lanes of the route, and braking.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import torch

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.bicycle import Limits
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.plan import Plan, Trajectory
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.core.threads import one_thread
from advdiff_sumo.core.tracking import track
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.model_options import MODEL_STEP_S
from advdiff_sumo.models.shipped_weights import device_of
from advdiff_sumo.models.view import View, look
from advdiff_sumo.planners.lane_graph.memory import LaneGraphMemory as LaneMemory
from advdiff_sumo.planners.lane_graph.path import Geometry
from advdiff_sumo.planners.lane_graph.variants import Variant
from advdiff_sumo.planners.learned.candidate_score import Around, cost, followers
from advdiff_sumo.planners.learned.candidates import RAW, Candidates, candidates, driven_m
from advdiff_sumo.planners.learned.guide import Guide, guide_of
from advdiff_sumo.planners.learned.learned_options import (
    DiffusionPlannerOptions,
    LearnedOptions,
    SimNetPlannerOptions,
    TrafficSimPlannerOptions,
)
from advdiff_sumo.planners.learned.models import DiffusionModel, Model, SimNetModel, TrafficSimModel

HORIZON_STEPS = 8
"""Model steps of a predicted future: 4 s."""
_PLAN_STEP_S, _PLAN_STEPS = 0.1, 20


@dataclass(frozen=True)
class LearnedMemory:
    """What a learned target remembers from plan to plan.

    Attributes:
        lanes: memory of the lane-graph planner, which tracks the lane.
        noise: id → starting noise of the chosen diffusion sample.
    """

    lanes: LaneMemory
    noise: Mapping[str, FloatArray] = field(default_factory=dict)


class LearnedPlanner:
    """Base class of the three targets.

    Attributes:
        options: the checked options.
        model: the trained model.
    """

    Options: ClassVar[type[LearnedOptions]]
    Networks: ClassVar[type[Any]]
    name: ClassVar[str]

    @one_thread()
    def __init__(self, **options: Any) -> None:
        """Check the options and read the networks.

        Raises:
            ConfigError: an option has no such name or value, or there is no such device.
            WeightsError: the networks are missing or unusable.
        """
        whose = f"target '{self.name}'"
        self.options = self.Options.parse(options, f"options of {whose}")
        device = device_of(self.options.device, whose)
        self.model: Model = self.Networks(self.options, device)

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> LearnedMemory:
        """Return an empty memory, and compute the map's table of pieces."""
        del scene, rng
        _ = road.pieces(self.model.map_view)
        return LearnedMemory(LaneMemory(Geometry.of(road)))

    @one_thread()
    def plan(
        self, road: RoadMap, scene: Scene, memory: LearnedMemory, rng: np.random.Generator
    ) -> tuple[Plan, LearnedMemory]:
        """Return the plan and the memory for the next plan."""
        generator = torch.Generator().manual_seed(int(rng.integers(2**62)))
        # 1. Predict joint futures with the model.
        all_agents = np.ones(scene.history.agents, dtype=np.bool_)
        view = look(road, scene, all_agents, self.options.agents, self.model.map_view)
        prediction = self.model.predict(view, memory.noise, generator, HORIZON_STEPS)
        # 2. Find the lines along the route.
        guide, lanes = guide_of(road, scene, memory.lanes)
        # 3. Propose candidates and choose the cheapest.
        xy, yaw, speed = _world(view, prediction.rollout)
        target_state = (
            view.now.xy_m[0, -1],
            float(view.now.yaw_rad[0, -1]),
            max(float(view.now.speed_mps[0, -1]), 0.0),
        )
        offered = candidates(
            xy[:, 0],
            yaw[:, 0],
            speed[:, 0],
            guide,
            target_state,
            MODEL_STEP_S,
            self.options.route,
            self.options.brakes,
        )
        around = _around(view, xy, yaw)
        scored_guide = guide if self.options.route else None
        chosen = int(np.argmin(cost(offered, around, road, scored_guide, view.now.size_m[0], MODEL_STEP_S)))
        # 4. Turn it into a plan.
        noise = prediction.noise[int(offered.sample[chosen])] if prediction.noise else {}
        return _driven(offered, chosen, guide, view), LearnedMemory(lanes, noise)


class SimNetPlanner(LearnedPlanner):
    """Planner on SimNet (Bergamini et al. 2021, doi:10.1109/ICRA48506.2021.9561666); see ``models.simnet``."""

    Options, Networks = SimNetPlannerOptions, SimNetModel
    name = "simnet"


class TrafficSimPlanner(LearnedPlanner):
    """Planner on the joint latent-variable model: encoder, prior and decoder of a traffic bundle.

    After TrafficSim (Suo et al. 2021, doi:10.1109/CVPR46437.2021.01026).
    """

    Options, Networks = TrafficSimPlannerOptions, TrafficSimModel
    name = "trafficsim"


class DiffusionPlanner(LearnedPlanner):
    """Planner on the latent diffusion without guide (AdvDiffuser, Sec. III-B)."""

    Options, Networks = DiffusionPlannerOptions, DiffusionModel
    name = "diffusion"


def _world(view: View, rollout: Rollout) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return positions (S, A, T, 2), headings and speeds (S, A, T) in the world's frame."""
    xy, yaw, speed = (
        tensor.detach().cpu().numpy().astype(np.float64)
        for tensor in (rollout.xy, rollout.yaw, rollout.speed)
    )
    return xy + view.now.xy_m[0, -1], yaw, speed


def _around(view: View, xy_m: FloatArray, yaw_rad: FloatArray) -> Around:
    """Return the others in the samples, and which of them follow the target."""
    now = view.now
    target_pose = now.xy_m[0, -1], float(now.yaw_rad[0, -1]), float(now.size_m[0, 0])
    is_follower = followers(now.xy_m[1:, -1], now.yaw_rad[1:, -1], target_pose)
    return Around(xy_m[:, 1:], yaw_rad[:, 1:], now.size_m[1:], is_follower)


def _driven(offered: Candidates, chosen: int, guide: Guide | None, view: View) -> Trajectory:
    """Return the chosen candidate as a plan; a bicycle model follows it if it is not a sample as it is."""
    if offered.line[chosen] == RAW or guide is None:
        return Trajectory(
            offered.xy_m[chosen], wrap_angle(offered.yaw_rad[chosen]), offered.speed_mps[chosen], MODEL_STEP_S
        )
    return _followed(guide.lines[max(int(offered.line[chosen]), 0)], offered.speed_mps[chosen], view)


def _followed(line: Variant, speed_mps: FloatArray, view: View) -> Trajectory:
    """Return the trajectory of a bicycle model that follows *line* at speeds (T,)."""
    now = view.now
    speed_now = max(float(now.speed_mps[0, -1]), 0.0)
    time_s = _PLAN_STEP_S * np.arange(1, _PLAN_STEPS + 1)
    model_time_s = MODEL_STEP_S * np.arange(len(speed_mps) + 1)
    speed = np.interp(time_s, model_time_s, np.append(speed_now, speed_mps))
    xy, yaw = line.poses(line.s_m + driven_m(speed, speed_now, _PLAN_STEP_S))
    state = now.xy_m[0, -1], now.yaw_rad[0, -1], np.asarray(speed_now)
    driven = track(state, (xy, wrap_angle(yaw), speed), now.size_m[0, 0], _PLAN_STEP_S, Limits())
    return Trajectory(*driven, dt_s=_PLAN_STEP_S)
