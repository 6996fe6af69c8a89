"""Plans that enter the lane to which the target must change, as its route goes on only from there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.traffic.manoeuvres.required_braking import BRAKING_MPS2, TargetWay, needed_braking
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.ways import Way


def blocks_lane_change(
    view: SituationView, rows: Sequence[int], xy_m: FloatArray, yaw_rad: FloatArray
) -> BoolArray:
    """Return (R,) which plans enter the lane that the target must change to, so that braking no longer suffices there.

    The target is assumed to change lanes now, and to brake if necessary. Vehicles on that lane or on the target's own
    are left out.

    Args:
        view: the scene.
        rows: (R,) rows of the vehicles.
        xy_m: (R, T, 2) centres at ``CHECK_TIMES_S``.
        yaw_rad: (R, T) headings.
    """
    blocks = np.zeros(len(rows), dtype=np.bool_)
    changing = _changing_target(view)
    if changing is None:
        return blocks
    used = {changing.way.present_lane.id, view.ways[view.scene.target].present_lane.id}
    away = [k for k, r in enumerate(rows) if r not in view.ways or view.ways[r].present_lane.id not in used]
    sizes = view.scene.history.size_m[[rows[k] for k in away]]
    needed = needed_braking(changing, xy_m[away], yaw_rad[away], sizes, np.zeros(len(away)))
    blocks[away] = needed > BRAKING_MPS2[-1]
    return blocks


def _changing_target(view: SituationView) -> TargetWay | None:
    """Return the target as it changes to the lane beside from which its route goes on; None if it needs no change."""
    target, row = view.target, view.scene.target
    if target is None or _keeps_route(view, target.way):
        return None
    for side in ("left", "right"):
        way = view.neighbour_way(row, side)
        if way is not None and _keeps_route(view, way):
            left = view.position_on(way, row)[1]
            return replace(target, way=Way(replace(way.lane, offset_m=left), target.way.drift_mps))
    return None


def _keeps_route(view: SituationView, way: Way) -> bool:
    """Return whether *way* neither ends nor leaves the target's route, as far as that is known."""
    route, lanes = view.scene.routes[view.scene.target], way.lane.lanes
    return way.lane.end_m == np.inf and all(x.is_internal or not route or x.edge_id in route for x in lanes)
