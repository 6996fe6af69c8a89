"""The four performance models of UN Regulation No. 157 as functions of a one-dimensional encounter.

``CC_human_driver`` is the careful and competent human driver (UN R157, Annex 4, Appendix 3), ``Reg157`` the
requirement on the system (paragraph 5.2.5.2), ``RSS`` responsibility-sensitive safety (Shalev-Shwartz, Shammah and
Shashua 2017, arXiv:1708.06374, Definitions 1, 6 and 9), ``FSM`` the fuzzy safety model (Mattas et al. 2020,
doi:10.1016/j.aap.2020.105743; in the regulation since its 01 series of amendments). The four are compared in
Mattas et al. 2022, doi:10.1016/j.aap.2022.106743.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, quotient

GRAVITY_MPS2 = 9.81
#: Full braking according to the regulation: 0.774 g.
FULL_BRAKE_MPS2 = 0.774 * GRAVITY_MPS2
#: Full braking is reached in 0.6 s: 0.774 g / 0.6 s.
BRAKE_JERK_MPS3 = 12.65
#: The human driver reacts to a cut-in with at most this time to collision.
CRITICAL_TTC_S = 2.0
#: Tolerance for rounded positions in comparisons.
TIE_M = 1e-9

_HUMAN_HEADWAY_S = 2.0
# Reg157: lateral distance of a relevant vehicle, braking, delay, additional time.
_REG_LATERAL_M, _REG_BRAKE_MPS2, _REG_DELAY_S, _REG_BUFFER_S = 0.5, 6.0, 0.35, 0.1
# RSS: acceleration during the response, braking of both, response time; lateral margin and braking.
_RSS_ACCEL_MPS2, _RSS_BRAKE_MPS2, _RSS_RESPONSE_S = 3.0, 6.0, 0.75
_RSS_MARGIN_M, _RSS_LATERAL_MPS2 = 0.3, 1.0
# FSM: response time, comfortable and full braking of the ego, full braking of the other; margins.
_FSM_RESPONSE_S, _FSM_COMFORT_MPS2, _FSM_BRAKE_MPS2, _FSM_OTHER_MPS2 = 0.75, 4.0, 6.0, 7.0
_FSM_MARGIN_M, _FSM_LATERAL_S = 2.0, 0.1


@dataclass(frozen=True)
class Situation:
    """The ego and one other road user along and across the ego's way; all arrays of one shape (…).

    Attributes:
        ego_mps: ego speed v.
        ego_accel_mps2: ego acceleration over the last step.
        other_mps: speed u of the other along the way.
        gap_m: bumper gap d along the way; negative when the boxes are beside each other.
        lateral_gap_m: gap y between the boxes across the way; negative when they overlap.
        lateral_mps: speed w at which the lateral gap closes; 0 or less when it does not.
        lengths_m: sum of both lengths.
    """

    ego_mps: FloatArray
    ego_accel_mps2: FloatArray
    other_mps: FloatArray
    gap_m: FloatArray
    lateral_gap_m: FloatArray
    lateral_mps: FloatArray
    lengths_m: FloatArray

    @property
    def closing_mps(self) -> FloatArray:
        """Speed (…,) at which the ego closes in, v − u."""
        return np.asarray(self.ego_mps - self.other_mps)

    @property
    def ttc_s(self) -> FloatArray:
        """Time to collision (…,), d / (v − u); inf where the ego does not close in."""
        return quotient(self.gap_m, self.closing_mps)

    @property
    def passed(self) -> BoolArray:
        """Whether the ego's centre is beyond the other's (…,), so that braking no longer helps."""
        return np.asarray(self.gap_m + 0.5 * self.lengths_m < 0.0)


@dataclass(frozen=True)
class DriverModel:
    """One reference driver.

    Attributes:
        name: as in the regulation's tool.
        demand: returns the deceleration (…,) in m/s² that the model requires; 0 where it calls the situation safe.
        delay_s: time from the first unsafe instant until it brakes.
        coast_mps2: deceleration during this delay, from which the braking grows.
        jerk_mps3: rate at which the deceleration grows; inf for at once.
    """

    name: str
    demand: Callable[[Situation], FloatArray]
    delay_s: float
    coast_mps2: float
    jerk_mps3: float


def human_demand(situation: Situation) -> FloatArray:
    """Return full braking (…,) where the boxes overlap laterally and the ego has not passed the other.

    Whether a cut-in is critical depends on the instant of entering: its time to collision is then at most
    ``CRITICAL_TTC_S``. The caller, who knows that instant, decides this.
    """
    unsafe = (situation.lateral_gap_m <= TIE_M) & ~situation.passed
    return np.where(unsafe, FULL_BRAKE_MPS2, 0.0)


def regulation_demand(situation: Situation) -> FloatArray:
    """Return 6 m/s² (…,) where y ≤ 0.5 m and |TTC| ≤ (v − u) / (2 · 6) + 0.35 s + 0.1 s (par. 5.2.5.2)."""
    least_ttc_s = situation.closing_mps / (2.0 * _REG_BRAKE_MPS2) + _REG_DELAY_S + _REG_BUFFER_S
    near = situation.lateral_gap_m <= _REG_LATERAL_M + TIE_M
    unsafe = near & (np.abs(situation.ttc_s) <= least_ttc_s) & ~situation.passed
    return np.where(unsafe, _REG_BRAKE_MPS2, 0.0)


def following_gap_m(model: DriverModel, speed_mps: FloatArray) -> FloatArray:
    """Return the gap (…,) at which *model* follows a leader at *speed_mps*.

    The human driver keeps two seconds. ``Reg157`` does not define following and uses the same gap. RSS keeps a gap from
    which its safe distance remains after a response in which the leader brakes at 6 m/s². FSM keeps the least gap that
    its proactive metric calls safe.
    """
    if model.name == "RSS":
        leader_mps = np.maximum(speed_mps - _RSS_BRAKE_MPS2 * _RSS_RESPONSE_S, 0.0)
        return rss_distance_m(speed_mps, leader_mps) + 0.5 * _RSS_BRAKE_MPS2 * _RSS_RESPONSE_S**2
    if model.name == "FSM":
        inverse_braking = 1.0 / (2.0 * _FSM_COMFORT_MPS2) - 1.0 / (2.0 * _FSM_OTHER_MPS2)
        return speed_mps * _FSM_RESPONSE_S + speed_mps**2 * inverse_braking + 2.0 * _FSM_MARGIN_M
    return _HUMAN_HEADWAY_S * speed_mps


def rss_distance_m(ego_mps: FloatArray, other_mps: FloatArray) -> FloatArray:
    """Return the safe longitudinal distance (…,) of RSS, Definition 1, not clipped at 0."""
    rho, accel, brake = _RSS_RESPONSE_S, _RSS_ACCEL_MPS2, _RSS_BRAKE_MPS2
    v_after = ego_mps + rho * accel
    return ego_mps * rho + 0.5 * accel * rho**2 + v_after**2 / (2.0 * brake) - other_mps**2 / (2.0 * brake)


def rss_lateral_m(lateral_mps: FloatArray) -> FloatArray:
    """Return the safe lateral distance (…,) of RSS, Definition 6, from an ego that keeps to its way."""
    rho, accel = _RSS_RESPONSE_S, _RSS_LATERAL_MPS2
    w_after = lateral_mps + rho * accel
    return _RSS_MARGIN_M + 0.5 * (lateral_mps + w_after) * rho + w_after**2 / (2.0 * accel)


def rss_demand(situation: Situation) -> FloatArray:
    """Return full braking (…,) where both distances of RSS are too short (Definition 9, the proper response)."""
    too_close = situation.gap_m < rss_distance_m(situation.ego_mps, np.maximum(situation.other_mps, 0.0))
    too_close_laterally = situation.lateral_gap_m < rss_lateral_m(np.maximum(situation.lateral_mps, 0.0))
    return np.where(too_close & too_close_laterally & ~situation.passed, FULL_BRAKE_MPS2, 0.0)


def proactive_metric(situation: Situation) -> FloatArray:
    """Return PFS (…,) in [0, 1]: 0 if the ego can stop comfortably when the other brakes fully, 1 if it cannot stop."""
    v, u = situation.ego_mps, np.maximum(situation.other_mps, 0.0)
    base = v * _FSM_RESPONSE_S - u**2 / (2.0 * _FSM_OTHER_MPS2)
    unsafe = base + v**2 / (2.0 * _FSM_BRAKE_MPS2)
    safe = base + v**2 / (2.0 * _FSM_COMFORT_MPS2) + _FSM_MARGIN_M
    return _ramp_down(situation.gap_m - _FSM_MARGIN_M - TIE_M, unsafe, safe)


def critical_metric(situation: Situation) -> FloatArray:
    """Return CFS (…,) in [0, 1]: as :func:`proactive_metric`, for an other that keeps its speed.

    The ego keeps its present acceleration (not below comfortable braking) during the response. If this makes it as
    slow as the other, both bounds are the distance by which it closes in until then.
    """
    v, u = situation.ego_mps, situation.other_mps
    accel = np.maximum(situation.ego_accel_mps2, -_FSM_COMFORT_MPS2)
    v_after = v + accel * _FSM_RESPONSE_S
    matched = v_after <= u
    closing, closing_after = v - u, np.maximum(v_after - u, 0.0)
    response_m = (0.5 * (v + v_after) - u) * _FSM_RESPONSE_S
    until_equal_m = closing**2 / (2.0 * np.maximum(np.abs(accel), 1e-9))
    unsafe = np.where(matched, until_equal_m, response_m + closing_after**2 / (2.0 * _FSM_BRAKE_MPS2))
    safe = np.where(matched, until_equal_m, response_m + closing_after**2 / (2.0 * _FSM_COMFORT_MPS2))
    return np.where(closing > 0.0, _ramp_down(situation.gap_m, unsafe, safe), 0.0)


def fuzzy_demand(situation: Situation) -> FloatArray:
    """Return the braking (…,) of the FSM: PFS · 4 m/s², or 4 + CFS · 2 m/s² where CFS > 0."""
    critical = critical_metric(situation)
    proactive = proactive_metric(situation)
    comfort, emergency = _FSM_COMFORT_MPS2, _FSM_BRAKE_MPS2 - _FSM_COMFORT_MPS2
    braking = np.where(critical > 0.0, comfort + emergency * critical, comfort * proactive)
    braking = np.minimum(braking, FULL_BRAKE_MPS2)
    return np.where(_laterally_unsafe(situation), braking, 0.0)


def _laterally_unsafe(situation: Situation) -> BoolArray:
    """Return whether the other is in the ego's way, or will be before the ego has passed it (FSM's lateral check)."""
    closing, w = situation.closing_mps, situation.lateral_mps
    inside = situation.lateral_gap_m <= TIE_M
    pass_s = quotient(situation.gap_m + situation.lengths_m, closing)
    enter_s = quotient(situation.lateral_gap_m, w)
    entering = (w > 0.0) & (closing > 0.0) & (enter_s <= pass_s + _FSM_LATERAL_S)
    return np.asarray(~situation.passed & (inside | entering))


def _ramp_down(value: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return (…,) 1 for *value* up to *low*, 0 from *high* on, linear between."""
    width = high - low
    line = (high - value) / np.where(width > 0.0, width, 1.0)
    return np.asarray(np.where(width > 0.0, np.clip(line, 0.0, 1.0), value < high))


HUMAN = DriverModel("CC_human_driver", human_demand, 0.75, 0.4, BRAKE_JERK_MPS3)
REGULATION = DriverModel("Reg157", regulation_demand, _REG_DELAY_S, 0.0, np.inf)
RSS = DriverModel("RSS", rss_demand, _RSS_RESPONSE_S, 0.0, BRAKE_JERK_MPS3)
FSM = DriverModel("FSM", fuzzy_demand, _FSM_RESPONSE_S, 0.0, BRAKE_JERK_MPS3)

MODELS: Mapping[str, DriverModel] = {model.name: model for model in (HUMAN, REGULATION, RSS, FSM)}
"""The reference drivers by name; the first is the legal yardstick."""
