"""Complete a SUMO-driven target with what is known per episode only: side of the road, and drawn desired speed."""

from __future__ import annotations

from dataclasses import replace
from statistics import NormalDist

from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.planners.planner_protocol import LEFT_OFFSET_M, SumoDriver, Target
from advdiff_sumo.planners.sumo_models import SpeedFactor

_MIN_PROBABILITY = 1e-12  # keeps the inverse distribution function finite


def as_driven(target: Target, lefthand: bool, seed: SeedTree) -> Target:
    """Return *target* with its vType attributes in this episode; return a planner unchanged.

    Args:
        target: what drives the tested vehicle.
        lefthand: whether traffic keeps left; SUMO then counts lateral positions from left to right.
        seed: the episode's node of the seed tree.
    """
    if not isinstance(target, SumoDriver):
        return target
    params = dict(target.params)
    if LEFT_OFFSET_M in params:
        left_m = float(params.pop(LEFT_OFFSET_M))
        params["latAlignment"] = -left_m if lefthand else left_m
    if params.keys() & {"speedFactor", "speedDev"}:
        speed_factor = SpeedFactor.read(params.get("speedFactor", 1.0))
        if "speedDev" in params:  # SUMO prefers it to the deviation in the text of speedFactor
            speed_factor = speed_factor._replace(deviation=float(params["speedDev"]))
        params |= {"speedFactor": _draw(speed_factor, seed.child("speed-factor")), "speedDev": 0.0}
    return replace(target, params=params)


def _draw(speed_factor: SpeedFactor, seed: SeedTree) -> float:
    """Return a number drawn from the normal distribution, truncated at its bounds."""
    if speed_factor.deviation == 0.0:
        return speed_factor.mean
    normal = NormalDist(speed_factor.mean, speed_factor.deviation)
    low, high = normal.cdf(speed_factor.low), normal.cdf(speed_factor.high)
    probability = max(low + float(seed.generator().random()) * (high - low), _MIN_PROBABILITY)
    return min(
        max(normal.inv_cdf(min(probability, 1.0 - _MIN_PROBABILITY)), speed_factor.low), speed_factor.high
    )
