"""Define the options of the co-simulation and of seed scenes, with units and defaults."""

from __future__ import annotations

from typing import Literal, Self, TypeAlias

from pydantic import Field, model_validator

from advdiff_sumo.config import Options

Situation: TypeAlias = Literal[
    "any",
    "following",
    "merging",
    "lane-change",
    "yielding",
    "turning",
    "oncoming",
    "red-light",
    "yellow",
]
"""Situation of the target when an episode begins."""


class SimOptions(Options):
    """How SUMO and plans are stepped, and what is seen and recorded.

    Attributes:
        step_s: SUMO's step.
        model_step_s: spacing of histories and of replanning instants.
        replan_every: model steps between two plans.
        history_s: how much of the past planners and policies see; with a driving log at least a model step.
        lateral_resolution_m: SUMO's sublane width; 0 switches the sublane model off.
        control_radius_m: the policy may move background vehicles that are nearer to the target than this.
        release_factor: a moved vehicle is handed back beyond ``release_factor`` × ``control_radius_m``.
        observe_radius_m: planners and policies see road users up to here; policies also see those that a moved vehicle
            may come into conflict with.
        record_radius_m: the record contains road users that come this near to the target.
        record_plans: the record contains the plans of the target and of this number of vehicles nearest to it; 0: none.
        record_natural: the record contains what happened in the seed scene without attack.
        stop_at_collision: end the episode at the target's first collision.
    """

    step_s: float = Field(0.1, gt=0.0, le=0.5)
    model_step_s: float = Field(0.5, gt=0.0, le=2.0)
    replan_every: int = Field(1, ge=1, le=20)
    history_s: float = Field(2.0, ge=0.0, le=10.0)
    lateral_resolution_m: float = Field(0.4, ge=0.0, le=3.0)
    control_radius_m: float = Field(60.0, gt=0.0)
    release_factor: float = Field(1.2, ge=1.0)
    observe_radius_m: float = Field(80.0, gt=0.0)
    record_radius_m: float = Field(100.0, gt=0.0)
    record_plans: int = Field(8, ge=0, le=200)
    record_natural: bool = True
    stop_at_collision: bool = True

    @model_validator(mode="after")
    def _must_be_whole_steps(self) -> Self:
        for name, duration_s in (("model_step_s", self.model_step_s), ("history_s", self.history_s)):
            step_s = self.step_s if name == "model_step_s" else self.model_step_s
            if abs(duration_s / step_s - round(duration_s / step_s)) > 1e-6:
                raise ValueError(f"{name} = {duration_s} is no whole multiple of {step_s}")
        return self

    @property
    def substeps(self) -> int:
        """Number of SUMO steps in a model step."""
        return round(self.model_step_s / self.step_s)

    @property
    def history_steps(self) -> int:
        """Number of instants in a history, the present included."""
        return round(self.history_s / self.model_step_s) + 1


class SceneOptions(Options):
    """How seed scenes are found in running traffic.

    Attributes:
        warmup_s: natural traffic before the first scene may start.
        density_per_km: vehicles per kilometre of car lane in generated demand.
        max_vehicles: largest number of vehicles in generated demand, for large nets.
        trucks_share: share of trucks and buses in generated demand.
        pedestrians_per_km: pedestrians per kilometre of sidewalk in generated demand; the net needs crossings.
        min_neighbours: vehicles that must be within 50 m of the target at the start.
        min_route_m: route that the target must have ahead.
        min_speed_mps: lowest speed of the target at the start.
        situation: what the target must be about to do at the start: following, merging, lane-change,
            yielding, turning, oncoming, red-light, yellow, or any.
        spacing_s: natural traffic between two scenes from one warm-up.
        scenes_per_warmup: scenes taken from one stretch of natural traffic.
        stride_s: spacing of the scenes taken from one driving log.
    """

    warmup_s: float = Field(40.0, ge=5.0, le=7200.0)
    density_per_km: float = Field(5.0, gt=0.0, le=80.0)
    max_vehicles: int = Field(160, ge=2)
    trucks_share: float = Field(0.08, ge=0.0, le=1.0)
    pedestrians_per_km: float = Field(0.0, ge=0.0, le=500.0)
    min_neighbours: int = Field(3, ge=0)
    min_route_m: float = Field(120.0, ge=0.0)
    min_speed_mps: float = Field(1.0, ge=0.0)
    situation: Situation = "any"
    spacing_s: float = Field(10.0, gt=0.0)
    scenes_per_warmup: int = Field(5, ge=1)
    stride_s: float = Field(2.0, gt=0.0)
