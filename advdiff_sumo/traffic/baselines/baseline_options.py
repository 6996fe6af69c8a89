"""Options of the baselines."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from advdiff_sumo.config import Options
from advdiff_sumo.traffic.licence import LicenceName


class BaselineOptions(Options):
    """Options of every baseline.

    Attributes:
        licence: what attackers may do, as in ``diffusion``: "lawful", "careless", or "reckless", as published.
        rounds: rounds of the search for a plan; 0: exactly the plan from which the search starts.
        attackers: largest number of simultaneous attackers.
        surrogate: model of the target's reaction in the search: "lane_graph", "model" (the traffic model's
            prediction), or your own planner as an entry point or ``package.module:Class``.
        refresh: rounds after which the surrogate reacts to the search's latest plan.
        replan: number of model steps of 0.5 s of a plan that are driven before the next plan.
        weights: a bundle of networks, or "closed-loop" for the shipped one of that name; empty: "traffic".
        device: "auto": a GPU if there is one, else the CPU; or a device name of PyTorch.
    """

    licence: LicenceName = "lawful"
    rounds: int = Field(20, ge=0, le=1000)
    attackers: int = Field(2, ge=1, le=8)
    surrogate: str = "lane_graph"
    refresh: int = Field(5, ge=1, le=1000)
    replan: int = Field(1, ge=1, le=12)
    weights: str = ""
    device: str = "auto"


class StriveOptions(BaselineOptions):
    """Options of ``strive``; the loss has the weights published with the paper; latents are in standard deviations.

    Attributes:
        rate: learning rate of Adam, in standard deviations of the prior.
        temperature: factor on the noise of the latents from which a search starts: 0: the prior's mean; 1: a draw.
        persistence: share of a vehicle's searched latent with which the next search starts.
        adversarial: weight of the squared distance to the target, soft-minimised over vehicles and time.
        vehicles: weight of vehicles that collide with each other.
        target: weight of vehicles that collide with the target although they are no attackers.
        road: weight of leaving the road.
        prior: weight of latents that are unlikely under the prior.
        prior_attacker: the same for attackers.
        start: weight of the distance from the natural latents.
        start_attacker: the same for attackers.
    """

    rate: float = Field(0.4, gt=0.0, le=10.0)
    temperature: float = Field(0.0, ge=0.0, le=1.0)
    persistence: float = Field(0.9, ge=0.0, le=1.0)
    adversarial: float = Field(2.0, ge=0.0)
    vehicles: float = Field(20.0, ge=0.0)
    target: float = Field(20.0, ge=0.0)
    road: float = Field(20.0, ge=0.0)
    prior: float = Field(1.0, ge=0.0)
    prior_attacker: float = Field(0.005, ge=0.0)
    start: float = Field(0.5, ge=0.0)
    start_attacker: float = Field(0.05, ge=0.0)


class AdvSimOptions(BaselineOptions):
    """Options of ``advsim``.

    Attributes:
        initial: source of the initial futures: "simnet", or "model" (the decoder at the prior's mean).
        simnet: file of your own SimNet; empty: the shipped one.
        candidates: number of action sequences in a round.
        spread: standard deviation of the first round's candidates, as a share of the bounds.
        accel_mps2: largest difference of a searched acceleration from the initial one.
        steer_share: the same for curvature, as a share of the largest one at the speed.
        jerk_mps3: largest rate of change of acceleration.
        swerve_mps3: largest rate of change of lateral acceleration.
        comfort: weight of the surrogate's discomfort beside the distance.
        effort: weight of the distance from the initial actions.
    """

    initial: Literal["simnet", "model"] = "simnet"
    simnet: str = ""
    candidates: int = Field(32, ge=4, le=4096)
    spread: float = Field(0.4, gt=0.0, le=2.0)
    accel_mps2: float = Field(6.0, gt=0.0)
    steer_share: float = Field(0.6, gt=0.0, le=2.0)
    jerk_mps3: float = Field(10.0, gt=0.0)
    swerve_mps3: float = Field(8.0, gt=0.0)
    comfort: float = Field(0.1, ge=0.0)
    effort: float = Field(0.05, ge=0.0)
