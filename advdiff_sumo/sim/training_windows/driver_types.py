"""Draw vehicle types whose drivers and sizes vary as in real traffic.

Sources of the ranges: headways, accelerations and decelerations after Treiber and Kesting, Traffic Flow Dynamics (2013,
doi:10.1007/978-3-642-32460-4), table 11.2, widened; speed factors after SUMO's default spread; vehicle sizes as in
nuScenes' description and European registration statistics; all others cover the ranges that SUMO documents.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

CAR_FOLLOWING = ("Krauss", "IDM", "EIDM", "W99")
_MODEL_SHARES = (0.35, 0.35, 0.25, 0.05)
_ALIGNMENTS = ("center", "left", "right", "nice", "arbitrary")
_ALIGNMENT_SHARES = (0.72, 0.06, 0.06, 0.08, 0.08)
_CARELESS_SHARE, _DISTRACTED_SHARE, _SLOW_REACTION_SHARE = 0.12, 0.1, 0.15


@dataclass(frozen=True)
class VehicleKind:
    """One kind of vehicle.

    Attributes:
        vclass: SUMO's vehicle class.
        types: number of driver types that are drawn.
        share: of the traffic.
        length_m: shortest and longest.
        width_m: narrowest and widest.
        accel_mps2: weakest and strongest.
        decel_mps2: comfortable, weakest and strongest.
        top_mps: lowest and highest top speed.
    """

    vclass: str
    types: int
    share: float
    length_m: tuple[float, float]
    width_m: tuple[float, float]
    accel_mps2: tuple[float, float]
    decel_mps2: tuple[float, float]
    top_mps: tuple[float, float]


KINDS: Mapping[str, VehicleKind] = {
    "car": VehicleKind("passenger", 24, 0.78, (3.6, 5.2), (1.65, 2.05), (1.4, 3.2), (2.5, 5.0), (38.0, 60.0)),
    "van": VehicleKind("delivery", 4, 0.06, (5.0, 7.0), (1.95, 2.3), (1.0, 2.2), (2.5, 4.5), (32.0, 45.0)),
    "truck": VehicleKind("truck", 4, 0.05, (7.0, 16.5), (2.3, 2.55), (0.6, 1.3), (2.0, 4.0), (22.0, 27.0)),
    "bus": VehicleKind("bus", 3, 0.03, (9.5, 13.5), (2.5, 2.55), (0.8, 1.4), (2.0, 3.5), (22.0, 27.0)),
    "motorcycle": VehicleKind(
        "motorcycle", 3, 0.04, (1.9, 2.4), (0.7, 0.95), (2.5, 5.0), (3.5, 7.0), (38.0, 60.0)
    ),
    "bicycle": VehicleKind("bicycle", 3, 0.04, (1.6, 1.9), (0.55, 0.75), (0.7, 1.5), (2.0, 3.5), (4.0, 7.5)),
}


@dataclass(frozen=True)
class DriverType:
    """A vType: its id, kind of vehicle, attributes and parameters."""

    id: str
    kind: str
    attributes: Mapping[str, str]
    parameters: Mapping[str, str]


def driver_types(rng: np.random.Generator) -> list[DriverType]:
    """Return the driver types of one simulation, several for each kind of vehicle."""
    return [
        _driver_type(f"{name}{number}", name, kind, rng)
        for name, kind in KINDS.items()
        for number in range(kind.types)
    ]


def _driver_type(name: str, kind_name: str, kind: VehicleKind, rng: np.random.Generator) -> DriverType:
    """Return a random driver type called *name* of a kind of vehicle."""
    model = str(rng.choice(CAR_FOLLOWING, p=_MODEL_SHARES))
    size_share = rng.random()
    numbers = {
        "length": _interpolated(kind.length_m, size_share),
        "width": _interpolated(kind.width_m, np.clip(size_share + rng.normal(0.0, 0.2), 0.0, 1.0)),
        "accel": rng.uniform(*kind.accel_mps2),
        "decel": rng.uniform(*kind.decel_mps2),
        "emergencyDecel": rng.uniform(7.0, 9.0),
        "tau": rng.uniform(0.8, 2.2),
        "minGap": rng.uniform(1.0, 3.2),
        "maxSpeed": rng.uniform(*kind.top_mps),
    }
    mean = np.clip(rng.normal(1.0, 0.1), 0.75, 1.25)
    speed_factor = f"normc({mean:.3f},{rng.uniform(0.03, 0.12):.3f},0.6,1.5)"
    fixed = {"id": name, "vClass": kind.vclass, "carFollowModel": model, "speedFactor": speed_factor}
    fixed["latAlignment"] = str(rng.choice(_ALIGNMENTS, p=_ALIGNMENT_SHARES))
    if kind.vclass in ("motorcycle", "bicycle"):
        fixed["latAlignment"] = str(rng.choice(("center", "right", "arbitrary")))
    if model in ("Krauss", "W99"):
        numbers["sigma"] = rng.uniform(0.0, 0.6)
    numbers |= _lane_change_numbers(rng) | _junction_numbers(rng)
    if rng.random() < _SLOW_REACTION_SHARE:
        numbers["actionStepLength"] = float(rng.choice((0.2, 0.3, 0.5)))
    is_distracted = rng.random() < _DISTRACTED_SHARE
    device = {"has.driverstate.device": "true", "device.driverstate.initialAwareness": "0.6"}
    return DriverType(
        name,
        kind_name,
        fixed | {key: f"{value:.3f}" for key, value in numbers.items()},
        device if is_distracted else {},
    )


def _lane_change_numbers(rng: np.random.Generator) -> dict[str, float]:
    """Return random numbers of SUMO's lane-change model."""
    return {
        "lcStrategic": rng.uniform(0.6, 2.0),
        "lcCooperative": rng.uniform(0.3, 1.0),
        "lcSpeedGain": rng.lognormal(0.0, 0.5),
        "lcKeepRight": rng.uniform(0.0, 1.0),
        "lcSublane": rng.uniform(0.5, 1.5),
        "lcAssertive": float(np.clip(rng.lognormal(0.1, 0.4), 0.6, 2.5)),
        "lcImpatience": rng.uniform(0.0, 0.6),
        "lcSigma": rng.uniform(0.0, 0.15),
        "minGapLat": rng.uniform(0.3, 0.8),
        "maxSpeedLat": rng.uniform(0.6, 1.4),
        "lcAccelLat": rng.uniform(0.6, 1.4),
    }


def _junction_numbers(rng: np.random.Generator) -> dict[str, float]:
    """Return random numbers of SUMO's junction model; a few drivers are careless and may ignore others."""
    careful = {
        "impatience": rng.uniform(0.0, 0.5),
        "jmTimegapMinor": rng.uniform(0.7, 2.0),
        "jmDriveAfterYellowTime": rng.uniform(0.0, 1.5),
    }
    if rng.random() >= _CARELESS_SHARE:
        return careful
    careless = {"jmIgnoreFoeProb": rng.uniform(0.02, 0.15), "jmIgnoreFoeSpeed": rng.uniform(3.0, 12.0)}
    return careful | careless | {"jmTimegapMinor": rng.uniform(0.2, 0.7)}


def _interpolated(span: tuple[float, float], share: float) -> float:
    """Return the value at *share* of *span*; 0 is its beginning, 1 its end."""
    return span[0] + share * (span[1] - span[0])
