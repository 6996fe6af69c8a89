"""Vehicles that accompany the target while its leader stops: beside and behind it, and nearer than the leader.

They drive lawfully and block nobody. A planner that tracks only the nearest few road users, or only the nearest one
ahead, tracks them instead of the leader.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence

import numpy as np

from advdiff_sumo.core.frames import local_from_world
from advdiff_sumo.metrics.safe_gap import safe_gap_m
from advdiff_sumo.traffic.licence import LAWFUL, Licence
from advdiff_sumo.traffic.manoeuvres.licence_rules import lawful_manoeuvres
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.prescribed_severity import target_brakes
from advdiff_sumo.traffic.manoeuvres.repertoire import BESIDE_M, MIN_HEADING_COSINE, MIN_STOPPING_SPEED_MPS
from advdiff_sumo.traffic.manoeuvres.required_braking import TargetWay
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import ADAPTS_S, SpeedProfile
from advdiff_sumo.traffic.manoeuvres.ways import Way

ACCOMPANIES = "accompanies"
"""Kind of manoeuvre of a vehicle that keeps its place beside or behind the target."""
COMPANY_SIZE = 3
"""Number of vehicles that are nearer to the target than its leader."""
_LENGTH_M = 4.6
_FRONT_SHARE, _LEVEL_SHARE = 0.4, -0.1
"""Places ahead of and level with the target, as shares of the spacing of two cars on one lane."""
_REACH_M = (-45.0, 66.0)  # a vehicle between these distances ahead of the target is part of the company
_MIN_ASIDE_M = 2.0
_CLOSING_PER_S, _ACCEL_MPS2 = 0.4, 2.0
"""Speed difference per metre off the place, and largest acceleration."""
_MIN_SPEED_SHARE, _MAX_SLOWER_MPS = 0.5, 7.0
"""A vehicle that falls back to its place keeps this share of the target's speed, and is at most so much slower."""
_BRAKES_MPS2, _DRIFTS_MPS = 2.5, 0.5
"""A target that brakes harder responds to something; one that moves sideways faster changes lanes, and needs room."""
_FASTER_MPS, _SETTLED_MPS, _JOINS_M = 1.5, 1.0, 45.0
"""Speed difference to gain on the target; largest one of a settled company; distance within which that counts."""


def car_spacing_m(speed_mps: float) -> float:
    """Return the distance between the centres of two cars that keep the lawful gap at *speed_mps*."""
    return LAWFUL.gap_share * safe_gap_m(speed_mps, speed_mps) + LAWFUL.spare_m + _LENGTH_M


def company_places(view: SituationView) -> dict[str, tuple[float, ...]]:
    """Return side → distances ahead of the target at which vehicles accompany it; side "" is its own lane.

    With a lane on either side none is needed behind it. Without any there is no company.
    """
    target = view.target
    if target is None:
        return {}
    spacing = car_spacing_m(target.speed_mps)
    front = _FRONT_SHARE * spacing, (_FRONT_SHARE - 1.0) * spacing
    sides = [side for side in ("left", "right") if has_lane_beside(view, target, side)]
    if len(sides) == 2:
        return {sides[0]: front, sides[1]: (_LEVEL_SHARE * spacing,)}
    return {sides[0]: front, "": (-spacing,)} if sides else {}


def has_lane_beside(view: SituationView, target: TargetWay, side: str) -> bool:
    """Return whether there is a lane to the target's *side* that neither ends nor leads into the target's way.

    Lanes of a junction have no neighbours: there, return whether a vehicle accompanies the target on that side.
    """
    if target.way.present_lane.is_internal:
        return bool(company_rows(view, side))
    way = view.neighbour_way(view.scene.target, side)
    return way is not None and way.lane.end_m == np.inf and not _joins(target, way)


def _joins(target: TargetWay, way: Way) -> bool:
    """Return whether *way* begins on or leads into a lane of the target's way."""
    return not {lane.id for lane in target.way.lane.lanes}.isdisjoint(lane.id for lane in way.lane.lanes)


def insertion_places(view: SituationView, least_m: float) -> Iterator[tuple[str, float]]:
    """Yield (side, distance ahead of the target) where missing vehicles are inserted, at least *least_m* away.

    A vehicle with a place behind the target on a lane beside it is inserted ahead and falls back, unless the lane
    allows it to drive faster than the target.
    """
    target, row = view.target, view.scene.target
    if target is None:
        return
    for side, places_m in company_places(view).items():
        way = view.neighbour_way(row, side) if side else target.way
        fastest = float(target.free_speed_mps.max()) + _FASTER_MPS
        can_gain = not side or (way is not None and way.lane.speed_mps >= fastest)
        next_m = least_m
        for place_m in reversed(places_m[len(company_rows(view, side)) :]):
            if place_m < 0.0 and (can_gain or place_m <= -least_m):
                yield side, min(place_m, -least_m)
            else:
                yield side, max(place_m, next_m)
                next_m = max(place_m, next_m) + car_spacing_m(target.speed_mps)


def company_manoeuvres(
    view: SituationView, busy: Container[int], licence: Licence | None = LAWFUL
) -> list[Manoeuvre]:
    """Return how the vehicles of the company, except the *busy* ones, reach or keep their ``company_places``.

    If the target brakes or changes lanes, SUMO drives them.
    """
    if view.target is None or view.target.speed_mps < MIN_STOPPING_SPEED_MPS:
        return []
    if target_brakes(view, _BRAKES_MPS2) or abs(view.target.way.drift_mps) > _DRIFTS_MPS:
        return []
    manoeuvres = []
    for side, places_m in company_places(view).items():
        free = [row for row in company_rows(view, side) if row not in busy]
        manoeuvres += [
            _keep_place(view, view.target, row, place_m) for row, place_m in _assigned(view, free, places_m)
        ]
    return lawful_manoeuvres(view, manoeuvres, licence)


def company_rows(view: SituationView, side: str) -> Sequence[int]:
    """Return the movable rows on the lane to the target's *side*, or behind it for "", nearest first.

    Vehicles on the target's own way, or on one that leads into it, are left out: in a bend they may seem beside it.
    """
    if not side:
        return [row for row in (view.follower,) if row is not None and row in view.movable]
    if view.target is None:
        return []
    history, target = view.scene.history, view.scene.target
    yaw = history.yaw_rad[:, -1]
    sign = 1.0 if side == "left" else -1.0
    rows = []
    for row in view.movable:
        ahead, left = local_position(view, row)
        is_beside = _MIN_ASIDE_M < sign * left < BESIDE_M and _REACH_M[0] < ahead < _REACH_M[1]
        same_way = np.cos(yaw[row] - yaw[target]) > MIN_HEADING_COSINE
        if is_beside and same_way and not _joins(view.target, view.ways[row]):
            rows.append((abs(ahead), row))
    return [row for _, row in sorted(rows)]


def local_position(view: SituationView, row: int) -> tuple[float, float]:
    """Return the position of *row* ahead of the target and to its left, along and across the target's heading."""
    history, target = view.scene.history, view.scene.target
    yaw = float(history.yaw_rad[target, -1])
    ahead, left = local_from_world(history.xy_m[row, -1], history.xy_m[target, -1], yaw)
    return float(ahead), float(left)


def _assigned(
    view: SituationView, rows: Sequence[int], places_m: tuple[float, ...]
) -> Iterator[tuple[int, float]]:
    """Yield (row, place) for the nearest of *rows*, in the order in which they drive."""
    nearest = sorted(rows[: len(places_m)], key=lambda row: -local_position(view, row)[0])
    if len(nearest) == len(places_m):
        yield from zip(nearest, places_m, strict=True)
    else:
        for row in nearest:
            ahead_m = local_position(view, row)[0]
            yield row, min(places_m, key=lambda place: abs(place - ahead_m))


def _keep_place(view: SituationView, target: TargetWay, row: int, place_m: float) -> Manoeuvre:
    """Return the speed that brings *row* gently to *place_m* ahead of the target."""
    way, speed = view.ways[row], view.speed(row)
    limit = way.lane.speed_mps
    lowest = max(_MIN_SPEED_SHARE * target.speed_mps, target.speed_mps - _MAX_SLOWER_MPS)
    target_then = target.speed_mps + ADAPTS_S * view.speed_gain_mps2(view.scene.target)
    missing_m = place_m - local_position(view, row)[0]
    wish = float(np.clip(target_then + _CLOSING_PER_S * missing_m, min(lowest, limit), limit))
    profile = SpeedProfile.adapting(wish, speed, _ACCEL_MPS2, _ACCEL_MPS2, 0.0, limit)
    return Manoeuvre(ACCOMPANIES, row, way, profile, is_positioning=True)


def is_settled(view: SituationView) -> bool:
    """Return whether the company comes no nearer: all vehicles of it that are near are about as fast as the target."""
    speed = view.speed(view.scene.target)
    company = (
        (row, local_position(view, row)[0])
        for side, places_m in company_places(view).items()
        for row in company_rows(view, side)[: len(places_m)]
    )
    return all(
        abs(view.speed(row) - speed) <= _SETTLED_MPS for row, ahead in company if abs(ahead) < _JOINS_M
    )
