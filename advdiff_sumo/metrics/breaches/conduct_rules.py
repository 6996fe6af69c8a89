"""Speeding, reversing and leaving the road, and whether such a breach led to a collision."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.metrics.breaches.breach import Breach, BreachKind
from advdiff_sumo.metrics.encounter import BREACH_WINDOW_S, Encounter
from advdiff_sumo.metrics.offroad import OFF_ROAD_SHARE, off_road_shares
from advdiff_sumo.metrics.traffic_view import TrafficView

#: Driving faster than this share of the limit, for at least ``_SPEEDING_S``, is a breach.
SPEEDING_SHARE = 1.2
_SPEEDING_S = 0.5
#: Driving backwards faster than this, over at least ``_REVERSED_M`` within a second, is reversing; less is log noise.
REVERSING_MPS = 0.1
_REVERSED_M = 0.2
_ROUNDING_M = 1e-9
#: A vehicle off the road that is slower than this is parked.
_OFF_ROAD_MPS = 0.5
#: Speeding led to the contact only if the party approached the other at least this fast.
_CLOSING_MPS = 1.0
_OFF_ROAD_EVERY_S = 0.5
#: Road users that may leave the road.
_MAY_LEAVE_ROAD = (AgentClass.PEDESTRIAN, AgentClass.BICYCLE)


def speeding_breach(view: TrafficView, case: Encounter, index: int) -> Breach | None:
    """Return the breach of having driven at over 1.2 × the limit while approaching the other."""
    party = case.parties[index]
    start = max(0, case.collision.step - view.steps(BREACH_WINDOW_S))
    if party.is_pedestrian or closing_mps(case, index) < _CLOSING_MPS or case.is_run_into(index):
        return None
    return drove_too_fast(view, party.row, start, case.collision.step + 1)


def drove_too_fast(view: TrafficView, row: int, start: int, stop: int) -> Breach | None:
    """Return the breach of driving at over 1.2 × the limit at instants *start* to *stop* (exclusive)."""
    speed = view.tracks.speed_mps[row, start:stop]
    limit = _limits_mps(view, row, start, stop)
    over = speed > SPEEDING_SHARE * limit + 1e-6
    if not _lasts(over, max(1, view.steps(_SPEEDING_S))):
        return None
    worst = int(np.argmax(np.where(over, speed / limit, 0.0)))
    text = f"drove at {3.6 * speed[worst]:.0f} km/h where {3.6 * limit[worst]:.0f} km/h are allowed"
    return Breach(BreachKind.SPEEDING, row, view.time_s(start + worst), text)


def _limits_mps(view: TrafficView, row: int, start: int, stop: int) -> FloatArray:
    """Return (N,) speed limits; inf off any lane."""
    limits, lanes = view.road.legal_limits_mps, view.place(row, start, stop).lane
    return np.array([np.inf if lane is None else limits[lane] for lane in lanes], dtype=np.float64)


def reversing_breach(view: TrafficView, case: Encounter, index: int) -> Breach | None:
    """Return the breach of reversing at the contact."""
    party, step = case.parties[index], case.collision.step
    if party.is_pedestrian or party.speed_mps >= -REVERSING_MPS:
        return None
    return drove_backwards(view, party.row, max(0, step - view.steps(1.0)), step + 1)


def drove_backwards(view: TrafficView, row: int, start: int, stop: int) -> Breach | None:
    """Return the breach of reversing at instants *start* to *stop* (exclusive)."""
    speed = view.tracks.speed_mps[row, start:stop]
    counted = np.where((speed > 0.0) | (speed < -REVERSING_MPS), speed, 0.0)
    position_m = np.concatenate(([0.0], np.cumsum(counted))) * view.tracks.dt_s
    if (np.maximum.accumulate(position_m) - position_m).max() < _REVERSED_M - _ROUNDING_M:
        return None
    return Breach(BreachKind.REVERSING, row, view.time_s(stop - 1), "was reversing")


def off_road(view: TrafficView, case: Encounter, index: int) -> Breach | None:
    """Return the breach of having left the road, unless the other ran into its rear."""
    if case.is_run_into(index):
        return None
    start = max(0, case.collision.step - view.steps(BREACH_WINDOW_S))
    return drove_off_road(view, case.parties[index].row, start, case.collision.step + 1)


def drove_off_road(view: TrafficView, row: int, start: int, stop: int) -> Breach | None:
    """Return the breach of moving with over half the box off the road at instants *start* to *stop* (exclusive)."""
    if view.tracks.classes[row] in _MAY_LEAVE_ROAD:
        return None
    steps = np.arange(stop - 1, start - 1, -max(1, view.steps(_OFF_ROAD_EVERY_S)))[::-1]
    steps = steps[view.tracks.valid[row, steps] & (view.tracks.speed_mps[row, steps] > _OFF_ROAD_MPS)]
    if not steps.size:
        return None
    share = off_road_shares(view.road, view.tracks, np.full(len(steps), row), steps)
    off = np.flatnonzero(share > OFF_ROAD_SHARE)
    if not off.size:
        return None
    return Breach(BreachKind.OFF_ROAD, row, view.time_s(int(steps[off[0]])), "was off the road")


def closing_mps(case: Encounter, index: int) -> float:
    """Return the speed of the party itself towards the other along the contact normal."""
    normal = case.collision.normal if index == 0 else -case.collision.normal
    return float(case.collision.velocity_mps[index] @ normal)


def _lasts(mask: BoolArray, count: int) -> bool:
    """Return whether *mask* (T,) is True at *count* successive instants."""
    runs = np.convolve(mask.astype(np.int64), np.ones(count, dtype=np.int64), mode="valid")
    return bool(len(mask) >= count and (runs == count).any())
