"""Define targets that SUMO drives: its car-following models and their options."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

from pydantic import Field, field_validator

from advdiff_sumo.config import Options
from advdiff_sumo.core.errors import did_you_mean
from advdiff_sumo.planners.planner_protocol import SumoDriver

CAR_FOLLOWING = (
    "Krauss",
    "KraussOrig1",
    "KraussPS",
    "KraussX",
    "PWagner2009",
    "BKerner",
    "IDM",
    "IDMM",
    "EIDM",
    "ACC",
    "CACC",
    "W99",
    "Wiedemann",
    "Daniel1",
)
"""SUMO's car-following models that drive on roads, as SUMO spells them.

Left out: Rail (trains), CC (platoons, needs Plexe), SmartSK (never moves in SUMO 1.28).
"""

_MODEL_PARAMS = """
    actionStepLength adaptFactor adaptTime apparentDecel apProb applyDriverState ccoolness cc1 cc2 cc3 cc4 cc5
    cc6 cc7 cc8 cc9 collisionAvoidanceGainGap collisionAvoidanceGainGapDot collisionAvoidanceGainSpace
    collisionAvoidanceGainSpeed collisionAvoidanceOverride collisionMinGapFactor delta desAccelProfile
    desiredMaxSpeed epsilonacc estimation gapClosingControlGainGap gapClosingControlGainGapDot
    gapClosingControlGainSpace gapClosingControlGainSpeed gapControlGainGap gapControlGainGapDot
    gapControlGainSpace gapControlGainSpeed hasDriverState impatience jerkmax k latAlignment maxAccelProfile
    maxSpeedLat maxvehpreview Mbegin Mflatness minGapLat phi security sigmaerror sigmagap sigmaleader
    sigmaStep speedControlGain speedControlGainCACC speedControlMinGap speedDev speedFactorPremature
    startupDelay stepping taccmax tauCACCToACC tauLast tmp1 tmp2 tmp3 tmp4 tmp5 tPersDrive tPersEstimate
    tpreview treaction vehdynamics
"""
_JUNCTION_PARAMS = """
    jmAdvance jmAllwayStopWait jmCrossingGap jmDriveAfterRedTime jmDriveAfterYellowTime jmDriveRedSpeed
    jmExtraGap jmIgnoreFoeProb jmIgnoreFoeSpeed jmIgnoreJunctionFoeProb jmIgnoreKeepClearTime jmSigmaMinor
    jmStoplineGap jmStoplineGapMinor jmStopSignWait jmTimegapMinor
"""
_LANE_CHANGE_PARAMS = """
    lcAccelLat lcAssertive lcContRight lcCooperative lcCooperativeHelpThreshold lcCooperativeHelpTime
    lcCooperativeMinSpeed lcCooperativeRoundabout lcCooperativeSpeed lcImpatience lcKeepRight
    lcKeepRightAcceptanceTime lcLaneDiscipline lcLookaheadLeft lcMaxDistLatStanding lcMaxSpeedLatFactor
    lcMaxSpeedLatStanding lcOpposite lcOvertakeDeltaSpeedFactor lcOvertakeRight lcPushy lcPushyGap lcSigma
    lcSpeedGain lcSpeedGainLookahead lcSpeedGainRemainTime lcSpeedGainRight lcSpeedGainUrgency lcStrategic
    lcStrategicLookahead lcSublane lcTimeToImpatience lcTurnAlignmentDistance
"""
PARAMS = frozenset((_MODEL_PARAMS + _JUNCTION_PARAMS + _LANE_CHANGE_PARAMS).split())
"""Further vType attributes of SUMO's schema that affect how a vehicle drives, not its type or looks."""

_DISTRIBUTION = re.compile(r"(normc?)\(([^()]*)\)")


class SpeedFactor(NamedTuple):
    """Desired speed over the limit; SUMO draws it for each vehicle from a truncated normal distribution.

    Attributes:
        mean: mean before truncation.
        deviation: standard deviation before truncation; 0: always the mean.
        low: smallest value.
        high: largest value.
    """

    mean: float
    deviation: float = 0.0
    low: float = 0.2
    high: float = 2.0

    @classmethod
    def read(cls, value: float | str) -> SpeedFactor:
        """Parse a number, "norm(mean,deviation)" or "normc(mean,deviation,low,high)".

        Raises:
            ValueError: the format is none of these, or the numbers make no sense.
        """
        match = _DISTRIBUTION.fullmatch(str(value).replace(" ", ""))
        name, texts = (match[1], match[2].split(",")) if match else ("", [str(value)])
        if len(texts) != {"": 1, "norm": 2, "normc": 4}[name]:
            raise ValueError("expected a number, norm(mean,deviation) or normc(mean,deviation,low,high)")
        try:
            numbers = [float(text) for text in texts]
        except ValueError:
            raise ValueError("expected a number, or SUMO's text such as normc(1,0.1,0.2,2)") from None
        bounds = {"": [0.0, min(0.2, numbers[0]), max(2.0, numbers[0])], "norm": [0.0, math.inf], "normc": []}
        factor = cls(*numbers, *bounds[name])
        if not (0.0 <= factor.low <= factor.mean <= factor.high and factor.mean > 0.0 <= factor.deviation):
            raise ValueError("0 <= low <= mean <= high, mean > 0 and deviation >= 0 must hold")
        return factor


class SumoDriverOptions(Options):
    """Options of SUMO-driven targets; None keeps SUMO's default for the vehicle class.

    Attributes:
        lane_change: SUMO's lane-change model; SL2015 is the one for sublanes.
        tau: desired time headway (s).
        accel: strongest acceleration (m/s²).
        decel: comfortable deceleration (m/s²).
        emergencyDecel: strongest deceleration (m/s²), at least ``decel``.
        minGap: gap to the leader at standstill (m).
        sigma: driver imperfection in [0, 1].
        speedFactor: desired speed over the limit: a number, or a distribution in SUMO's notation such as
            "normc(1,0.1,0.2,2)", from which each episode draws.
        maxSpeed: top speed (m/s).
        params: further vType attributes of :data:`PARAMS`.
    """

    lane_change: Literal["LC2013", "SL2015", "DK2008"] = "SL2015"
    tau: float | None = Field(None, gt=0.0, le=10.0)
    accel: float | None = Field(None, gt=0.0, le=20.0)
    decel: float | None = Field(None, gt=0.0, le=20.0)
    emergencyDecel: float | None = Field(None, gt=0.0, le=20.0)  # noqa: N815 - SUMO's spelling
    minGap: float | None = Field(None, ge=0.0, le=50.0)  # noqa: N815 - SUMO's spelling
    sigma: float | None = Field(None, ge=0.0, le=1.0)
    speedFactor: float | str | None = None  # noqa: N815 - SUMO's spelling
    maxSpeed: float | None = Field(None, gt=0.0, le=150.0)  # noqa: N815 - SUMO's spelling
    params: Mapping[str, float | str] = Field(default_factory=dict)

    @field_validator("lane_change", mode="before")
    @classmethod
    def _spell(cls, value: Any) -> Any:
        return value.strip().upper() if isinstance(value, str) else value

    @field_validator("params")
    @classmethod
    def _only_known(cls, params: Mapping[str, float | str]) -> Mapping[str, float | str]:
        for key in params:
            if key not in PARAMS:
                raise ValueError(f"SUMO has no driving attribute '{key}'; {_suggest(key)}")
        if "speedDev" in params:
            _check_deviation(params["speedDev"])
        return params

    @field_validator("speedFactor")
    @classmethod
    def _can_be_drawn(cls, value: float | str | None) -> float | str | None:
        if value is not None:
            SpeedFactor.read(value)
        return value

    @field_validator("emergencyDecel")
    @classmethod
    def _not_below_decel(cls, value: float | None, info: Any) -> float | None:
        decel = info.data.get("decel")
        if value is not None and decel is not None and value < decel:
            raise ValueError(f"must be at least decel = {decel}")
        return value


def _check_deviation(value: float | str) -> None:
    """Raise ValueError if *value* is no number of at least 0."""
    try:
        is_valid = 0.0 <= float(value) < math.inf
    except ValueError:
        is_valid = False
    if not is_valid:
        raise ValueError(f"speedDev = {value!r} is no number of at least 0")


def _suggest(key: str) -> str:
    """Return a hint for the unknown attribute *key*."""
    if key in SumoDriverOptions.model_fields:
        return f"'{key}' is an option of its own, set it beside 'params'"
    hint = did_you_mean(key, PARAMS)
    return hint if hint.startswith("did") else "SUMO's page on vehicle types lists them"


def sumo_driver(car_following: str, options: Mapping[str, Any]) -> SumoDriver:
    """Return the target that SUMO's *car_following* model drives.

    Args:
        car_following: one of :data:`CAR_FOLLOWING`.
        options: fields of :class:`SumoDriverOptions`.

    Raises:
        ConfigError: an option has no such name or value.
    """
    parsed = SumoDriverOptions.parse(options, f"options of target '{car_following}'")
    values = parsed.model_dump(exclude={"lane_change", "params"}, exclude_none=True)
    return SumoDriver(car_following, parsed.lane_change, {**values, **parsed.params})
