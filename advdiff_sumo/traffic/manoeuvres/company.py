"""Who drives beside and behind the target while its leader stops: lawful, in nobody's way, and nearer than the leader.

A planner that tracks the nearest few road users, or the nearest ahead alone, has them in mind in place of the leader.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence

import numpy as np

from advdiff_sumo.core.frames import local_from_world
from advdiff_sumo.metrics.safe_gap import safe_gap_m
from advdiff_sumo.traffic.licence import LAWFUL, Licence
from advdiff_sumo.traffic.manoeuvres.answers import TargetWay
from advdiff_sumo.traffic.manoeuvres.graded import target_brakes
from advdiff_sumo.traffic.manoeuvres.licence_rules import lawful_mask
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre, futures_of_manoeuvres
from advdiff_sumo.traffic.manoeuvres.repertoire import BESIDE_M, SAME_WAY, STOPS_FROM_MPS
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import SpeedProfile
from advdiff_sumo.traffic.manoeuvres.ways import Way

ACCOMPANIES = "accompanies"
"""What somebody does who keeps its place beside or behind the target."""
COMPANY_SIZE = 3
"""So many are nearer to the target than its leader."""
_LENGTH_M = 4.6
_FRONT_SHARE, _LEVEL_SHARE = 0.4, -0.1
"""Places ahead of and level with the target, as shares of the distance that two keep on one lane."""
_REACH_M = (-45.0, 66.0)
_LEAST_ASIDE_M = 2.0
_CLOSES_PER_S, _SETTLES_S, _GENTLY_MPS2 = 0.4, 0.8, 2.0
_SLOWEST_SHARE, _SLOWER_MPS = 0.5, 7.0
"""Who falls back to its place is no slower than this share of the target's speed, and by no more than that."""
_BRAKES_MPS2, _DRIFTS_MPS = 2.5, 0.5
"""Who brakes harder answers something; who moves sideways faster changes lanes, and is not to be hemmed in."""
_GAINS_MPS, _SETTLED_MPS, _JOINS_M = 1.5, 1.0, 45.0


def car_spacing_m(speed_mps: float) -> float:
    """Return how far apart the centres of two cars are that keep the lawful gap at *speed_mps*."""
    return LAWFUL.gap_share * safe_gap_m(speed_mps, speed_mps) + LAWFUL.spare_m + _LENGTH_M


def company_places(view: SituationView) -> dict[str, tuple[float, ...]]:
    """Return side → metres ahead of the target at which those are to drive that accompany it; "" is its own lane.

    With a lane on either side nobody need follow; with none at all there is no company.
    """
    target = view.target
    if target is None:
        return {}
    apart = car_spacing_m(target.speed_mps)
    front = _FRONT_SHARE * apart, (_FRONT_SHARE - 1.0) * apart
    sides = [side for side in ("left", "right") if _is_beside(view, target, side)]
    if len(sides) == 2:
        return {sides[0]: front, sides[1]: (_LEVEL_SHARE * apart,)}
    return {sides[0]: front, "": (-apart,)} if sides else {}


def _is_beside(view: SituationView, target: TargetWay, side: str) -> bool:
    """Return whether there is a lane to the target's *side* that neither ends nor leads into the target's way.

    A lane of a junction has none beside it: there it is whether somebody drives there.
    """
    if target.way.present_lane.is_internal:
        return bool(company_rows(view, side))
    way = view.neighbour_way(view.scene.target, side)
    return way is not None and way.lane.end_m == np.inf and not _joins(target, way)


def _joins(target: TargetWay, way: Way) -> bool:
    """Return whether *way* begins on or leads into a lane of the target's way."""
    return not {lane.id for lane in target.way.lane.lanes}.isdisjoint(lane.id for lane in way.lane.lanes)


def insertion_places(view: SituationView, least_m: float) -> Iterator[tuple[str, float]]:
    """Yield (side, metres ahead of the target) for where those come in that it lacks, *least_m* away at least.

    Who is to drive behind it on a lane beside comes in ahead and falls back, unless it may drive faster.
    """
    target, row = view.target, view.scene.target
    if target is None:
        return
    for side, ahead_m in company_places(view).items():
        way = view.neighbour_way(row, side) if side else target.way
        fastest = float(target.free_speed_mps.max()) + _GAINS_MPS
        gains = not side or (way is not None and way.lane.speed_mps >= fastest)
        next_m = least_m
        for at in reversed(ahead_m[len(company_rows(view, side)) :]):
            if at < 0.0 and (gains or at <= -least_m):
                yield side, min(at, -least_m)
            else:
                yield side, max(at, next_m)
                next_m = max(at, next_m) + car_spacing_m(target.speed_mps)


def company_manoeuvres(
    view: SituationView, busy: Container[int], licence: Licence | None = LAWFUL
) -> list[Manoeuvre]:
    """Return how those near, except the *busy* ones, get to their ``company_places`` or keep them.

    Once the target brakes, or changes lanes, they are their own drivers again.
    """
    if view.target is None or view.target.speed_mps < STOPS_FROM_MPS:
        return []
    if target_brakes(view, _BRAKES_MPS2) or abs(view.target.way.drift_mps) > _DRIFTS_MPS:
        return []
    out = []
    for side, ahead_m in company_places(view).items():
        near = [row for row in company_rows(view, side) if row not in busy]
        out += [_keeping(view, view.target, row, at) for row, at in _assigned(view, near, ahead_m)]
    futures = futures_of_manoeuvres(out, np.array([view.speed(m.row) for m in out]))
    keeps = lawful_mask(view, out, futures, licence) if out else ()
    return [m for m, keep in zip(out, keeps, strict=True) if keep]


def company_rows(view: SituationView, side: str) -> Sequence[int]:
    """Return the rows of those on the lane to the target's *side*, or behind it for "", that may be moved.

    Whoever drives on the target's way, aside of its heading in a bend, or leads into it is left out.
    """
    if not side:
        return [row for row in (view.follower,) if row is not None and row in view.movable]
    if view.target is None:
        return []
    now, target = view.scene.history, view.scene.target
    yaw = now.yaw_rad[:, -1]
    sign = 1.0 if side == "left" else -1.0
    rows = []
    for row in view.movable:
        ahead, left = _place(view, row)
        beside = _LEAST_ASIDE_M < sign * left < BESIDE_M and _REACH_M[0] < ahead < _REACH_M[1]
        same_way = np.cos(yaw[row] - yaw[target]) > SAME_WAY
        if beside and same_way and not _joins(view.target, view.ways[row]):
            rows.append((abs(ahead), row))
    return [row for _, row in sorted(rows)]


def _place(view: SituationView, row: int) -> tuple[float, float]:
    """Return how many metres *row* is ahead of the target, and to its left, along and across its heading."""
    now, target = view.scene.history, view.scene.target
    yaw = float(now.yaw_rad[target, -1])
    ahead, left = local_from_world(now.xy_m[row, -1], now.xy_m[target, -1], yaw)
    return float(ahead), float(left)


def _assigned(
    view: SituationView, near: Sequence[int], ahead_m: tuple[float, ...]
) -> Iterator[tuple[int, float]]:
    """Yield (row, place) for the nearest of *near*, in the order in which they drive."""
    some = sorted(near[: len(ahead_m)], key=lambda row: -_place(view, row)[0])
    if len(some) == len(ahead_m):
        yield from zip(some, ahead_m, strict=True)
    else:
        for row in some:
            at = _place(view, row)[0]
            yield row, min(ahead_m, key=lambda place: abs(place - at))


def _keeping(view: SituationView, target: TargetWay, row: int, ahead_m: float) -> Manoeuvre:
    """Return the speed that brings *row* gently to *ahead_m* of the target."""
    way, drives = view.ways[row], view.speed(row)
    limit = way.lane.speed_mps
    lowest = max(_SLOWEST_SHARE * target.speed_mps, target.speed_mps - _SLOWER_MPS)
    then = target.speed_mps + _SETTLES_S * view.speed_gain_mps2(view.scene.target)
    lacks = ahead_m - _place(view, row)[0]
    aims = float(np.clip(then + _CLOSES_PER_S * lacks, min(lowest, limit), limit))
    accel = float(np.clip((aims - drives) / _SETTLES_S, -_GENTLY_MPS2, _GENTLY_MPS2))
    return Manoeuvre(ACCOMPANIES, row, way, SpeedProfile(accel, _SETTLES_S, 0.0, 0.0, limit), sets_up=True)


def is_settled(view: SituationView) -> bool:
    """Return whether nobody of the company comes nearer: all of those near are about as fast as the target."""
    speed = view.speed(view.scene.target)
    near = (
        (row, _place(view, row)[0])
        for side, ahead_m in company_places(view).items()
        for row in company_rows(view, side)[: len(ahead_m)]
    )
    return all(abs(view.speed(row) - speed) <= _SETTLED_MPS for row, at in near if abs(at) < _JOINS_M)
