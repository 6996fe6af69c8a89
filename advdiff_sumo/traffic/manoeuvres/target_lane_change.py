"""The target's own lane change: under way, or required by its route; and plans that leave it no room there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import takewhile

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.maps.lanes import SIDES, Side, lanes_beside
from advdiff_sumo.traffic.manoeuvres.required_braking import BRAKING_MPS2, TargetWay, needed_braking
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.ways import Way

_UNDER_WAY_MPS, _UNDER_WAY_M = 0.4, 0.4  # least lateral speed and offset, both away from the centre line


def target_entering(view: SituationView) -> TargetWay | None:
    """Return the target on the lane beside that it is changing to, as its lateral motion shows; None if to none.

    On a junction it is None: the lanes there have no neighbours.
    """
    target = view.target
    if target is None:
        return None
    offset_m, drift_mps = target.way.lane.offset_m, target.way.drift_mps
    sign = np.sign(drift_mps)
    if sign * drift_mps < _UNDER_WAY_MPS or sign * offset_m < _UNDER_WAY_M:
        return None
    return _on_lane_beside(view, target, "left" if sign > 0 else "right")


def blocks_lane_change(
    view: SituationView, rows: Sequence[int], xy_m: FloatArray, yaw_rad: FloatArray
) -> BoolArray:
    """Return (R,) which plans enter the lane that the target changes to, so that braking no longer suffices there.

    A target whose route goes on only from the lane beside is assumed to change now. It brakes if necessary. Vehicles
    on that lane or on the target's own are left out.

    Args:
        view: the scene.
        rows: (R,) rows of the vehicles.
        xy_m: (R, T, 2) centres at ``CHECK_TIMES_S``.
        yaw_rad: (R, T) headings.
    """
    blocks = np.zeros(len(rows), dtype=np.bool_)
    changing = target_entering(view) or _target_that_must_change(view)
    if changing is None:
        return blocks
    used = {changing.way.present_lane.id, view.ways[view.scene.target].present_lane.id}
    away = [k for k, r in enumerate(rows) if r not in view.ways or view.ways[r].present_lane.id not in used]
    sizes = view.scene.history.size_m[[rows[k] for k in away]]
    needed = needed_braking(changing, xy_m[away], yaw_rad[away], sizes, np.zeros(len(away)))
    blocks[away] = needed > BRAKING_MPS2[-1]
    return blocks


def required_side(view: SituationView) -> Side | None:
    """Return the side to which the target has to change lanes for its route, the nearer one; None if to neither."""
    target, row = view.target, view.scene.target
    if target is None or _keeps_route(view, target.way):
        return None
    lane, s_m = target.way.present_lane, target.way.lane.s_m
    changes: dict[Side, int] = {}
    for side in SIDES:
        beside = takewhile(lambda x: x.is_drivable, lanes_beside(view.road.lanes, lane.id, side))
        for count, goal in enumerate(beside, 1):
            way = view.way_from(goal.line.at(min(s_m, goal.length_m)), view.scene.routes[row])
            if way is not None and _keeps_route(view, way):
                changes[side] = count
                break
    return min(changes, key=lambda side: changes[side], default=None)


def _target_that_must_change(view: SituationView) -> TargetWay | None:
    """Return the target on the lane beside from which its route goes on; None if it needs no lane change."""
    target = view.target
    if target is None or _keeps_route(view, target.way):
        return None
    beside = (_on_lane_beside(view, target, side) for side in ("left", "right"))
    return next(
        (changed for changed in beside if changed is not None and _keeps_route(view, changed.way)), None
    )


def _on_lane_beside(view: SituationView, target: TargetWay, side: str) -> TargetWay | None:
    way = view.neighbour_way(view.scene.target, side)
    if way is None:
        return None
    left_m = view.position_on(way, view.scene.target)[1]
    return replace(target, way=Way(replace(way.lane, offset_m=left_m), target.way.drift_mps))


def _keeps_route(view: SituationView, way: Way) -> bool:
    """Return whether *way* neither ends nor leaves the target's route, as far as that is known."""
    route, lanes = view.scene.routes[view.scene.target], way.lane.lanes
    return way.lane.end_m == np.inf and all(x.is_internal or not route or x.edge_id in route for x in lanes)
