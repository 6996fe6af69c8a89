"""What of a SUMO-driven target only its episode knows: the side of the road, and a desired speed that is drawn."""

from __future__ import annotations

from dataclasses import replace
from statistics import NormalDist

from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.planners.planner_protocol import LEFT_OFFSET_M, SumoDriver, Target
from advdiff_sumo.planners.sumo_models import SpeedFactor

_LEAST_SHARE = 1e-12


def as_driven(target: Target, lefthand: bool, seed: SeedTree) -> Target:
    """Return *target* with the vType attributes that SUMO takes in this episode; a planner as it is.

    Args:
        target: what drives the tested vehicle.
        lefthand: whether traffic keeps left; SUMO counts lateral places from left to right then.
        seed: the episode's node of the seed tree.
    """
    if not isinstance(target, SumoDriver):
        return target
    params = dict(target.params)
    if LEFT_OFFSET_M in params:
        left_m = float(params.pop(LEFT_OFFSET_M))
        params["latAlignment"] = -left_m if lefthand else left_m
    if params.keys() & {"speedFactor", "speedDev"}:
        wanted = SpeedFactor.read(params.get("speedFactor", 1.0))
        if "speedDev" in params:  # for SUMO it comes before the text's own
            wanted = wanted._replace(deviation=float(params["speedDev"]))
        params |= {"speedFactor": _drawn(wanted, seed.child("speed-factor")), "speedDev": 0.0}
    return replace(target, params=params)


def _drawn(wanted: SpeedFactor, seed: SeedTree) -> float:
    """Return a number of the normal distribution cut off at its bounds."""
    if wanted.deviation == 0.0:
        return wanted.mean
    normal = NormalDist(wanted.mean, wanted.deviation)
    low, high = normal.cdf(wanted.low), normal.cdf(wanted.high)
    share = max(low + float(seed.generator().random()) * (high - low), _LEAST_SHARE)
    return min(max(normal.inv_cdf(min(share, 1.0 - _LEAST_SHARE)), wanted.low), wanted.high)
