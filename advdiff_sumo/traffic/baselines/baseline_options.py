"""Options of the baselines, in the words of a user."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from advdiff_sumo.config import Options
from advdiff_sumo.traffic.licence import LicenceName


class BaselineOptions(Options):
    """What every baseline takes.

    Attributes:
        licence: what attackers may do, as of ``diffusion``: "lawful", "careless", or "reckless", as published.
        rounds: of the search for a plan; 0 is where the search starts from, exactly.
        attackers: most vehicles that attack at a time.
        surrogate: whose reaction the search expects of the target: "lane_graph", "model" (the traffic model's
            prediction), or a planner of one's own as an entry point or ``package.module:Class``.
        refresh: rounds after which the surrogate reacts to the search's latest plan.
        replan: model steps of 0.5 s of a plan that are driven before the next one.
        weights: a bundle of networks, or "closed-loop" for the shipped one of that name; empty: "traffic".
        device: "auto": a GPU where there is one, else the CPU; or a name that PyTorch knows.
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
    """Options of ``strive``; weights of the loss as published with the paper, latents counted in deviations.

    Attributes:
        rate: step of Adam, in deviations of the prior.
        temperature: of the latents that the search starts from: 0 is the prior's mean, 1 a draw from it.
        persistence: how much of a vehicle's latent, as the search left it, the next plan starts from.
        adversarial: weight of the squared distance to the target, soft over vehicles and time.
        vehicles: weight of vehicles that collide with each other.
        target: weight of vehicles that collide with the target although they do not attack.
        road: weight of leaving the road.
        prior: weight of latents that the prior finds unlikely.
        prior_attacker: the same for who attacks.
        start: weight of the distance from the natural latents.
        start_attacker: the same for who attacks.
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
        initial: what drives everybody before the search: "simnet", or "model" (the decoder at the prior's mean).
        simnet: a SimNet of one's own; empty: the shipped one.
        candidates: action sequences that are tried in a round.
        spread: deviation of the first round's, as a share of the bounds.
        accel_mps2: how far a searched acceleration may be from the initial one.
        steer_share: the same for the curvature, as a share of the largest at the speed.
        jerk_mps3: largest change of acceleration in a second.
        swerve_mps3: largest change of lateral acceleration in a second.
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
