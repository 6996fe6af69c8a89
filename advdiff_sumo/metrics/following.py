"""Longitudinal time to collision and DRAC of the target towards the vehicles ahead in its lane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.lane_entry import INTRUSION_M
from advdiff_sumo.metrics.placement import reach_across_m

#: Vehicles count up to this distance ahead along the lane.
LOOK_AHEAD_M = 100.0


@dataclass(frozen=True)
class Following:
    """Gaps of the target to each agent ahead of it in its lane, A agents, T instants.

    Attributes:
        gap_m: (A, T) bumper to bumper along the lane; NaN for agents whose centres are not ahead in its lane,
            negative side by side.
        closing_mps: (A, T) target's speed along the lane minus the other's.
    """

    gap_m: FloatArray
    closing_mps: FloatArray

    def time_to_collision(self) -> FloatArray:
        """Return (A, T) gap / closing speed in s (Hayward 1972); inf if not closing, NaN if not ahead."""
        closing, gap = np.where(self.closing_mps > 0.0, self.closing_mps, np.nan), self._ahead_m()
        return np.where(np.isnan(closing) & ~np.isnan(gap), np.inf, gap / closing)

    def deceleration_to_avoid(self) -> FloatArray:
        """Return (A, T) DRAC in m/s²: closing speed² / (2 gap); 0 if not closing, NaN if not ahead.

        Cooper and Ferguson (1976); the form for two speeds as in Almqvist, Hydén and Risser (1991), "Use of speed
        limiters in cars for increased safety and a better environment". Gaps below 1 cm count as 1 cm, so that the
        value stays finite until the contact.
        """
        closing = np.maximum(self.closing_mps, 0.0)
        return np.asarray(closing**2 / (2.0 * np.maximum(self._ahead_m(), 0.01)))

    def _ahead_m(self) -> FloatArray:
        """Return (A, T) gaps, NaN also for vehicles side by side in one lane, which require no braking."""
        return np.where(self.gap_m >= 0.0, self.gap_m, np.nan)


def following_gaps(tracks: Tracks, target: int, road: RoadMap, route: Sequence[str]) -> Following:
    """Return the gaps of *target* to the vehicles ahead in its lane and in the lanes that follow along *route*.

    A vehicle is in the lane that its centre and heading best fit, if its box reaches into it by more than
    ``INTRUSION_M``. If the lane does not lead along the route, or no route is known, its first successor follows.
    """
    lane, s, speed = _located(tracks, target, road)
    gap = np.full(tracks.yaw_rad.shape, np.nan)
    length = tracks.size_m[:, 0]
    for own_lane in np.unique(lane[target][lane[target] >= 0]):
        distances = _distances_ahead(road, road.index.lane_ids[own_lane], route)
        steps = np.flatnonzero(lane[target] == own_lane)
        start = np.full(len(road.index.lane_ids) + 1, np.nan)  # the last entry is for -1, no lane
        start[[road.index.row[x] for x in distances]] = list(distances.values())
        ahead = start[lane[:, steps]] + s[:, steps] - s[target, steps]
        gap[:, steps] = np.where(ahead > 0.0, ahead - 0.5 * (length + length[target])[:, None], np.nan)
    gap[target] = np.nan
    gap[gap > LOOK_AHEAD_M] = np.nan
    closing = speed[target] - speed
    return Following(gap, np.where(np.isnan(gap), np.nan, closing))


def _located(tracks: Tracks, target: int, road: RoadMap) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return (A, T) lane numbers, -1 for none, and (A, T) positions and speeds along them, near the target.

    The target is on the lane that fits it best, even if it hardly reaches into it.
    """
    offset = tracks.xy_m - tracks.xy_m[target]
    near = np.hypot(offset[..., 0], offset[..., 1]) <= LOOK_AHEAD_M + tracks.size_m[:, :1]
    ids, along, d, yaw_error = road.locate_many(tracks.xy_m[near], tracks.yaw_rad[near])
    row = np.nonzero(near)[0]
    number = np.array([-1 if x is None else road.index.row[x] for x in ids], dtype=np.int64)
    reach = reach_across_m(tracks.size_m[row], yaw_error)
    inside = np.abs(d) - reach < 0.5 * road.index.width_m[number] - INTRUSION_M
    lane = np.full(near.shape, -1, dtype=np.int64)
    lane[near] = np.where(inside | (row == target), number, -1)
    s, speed = np.full(near.shape, np.nan), np.full(near.shape, np.nan)
    s[near], speed[near] = along, tracks.speed_mps[near] * np.cos(yaw_error)
    return lane, s, speed


def _distances_ahead(road: RoadMap, lane_id: str, route: Sequence[str]) -> dict[str, float]:
    """Return the distance from the start of *lane_id* to its own start and to that of each lane that follows."""
    distances = {lane_id: 0.0}
    lane, end = road.lanes[lane_id], road.lanes[lane_id].length_m
    next_edges = dict(pairwise(route))
    own_length = end
    while lane.successors and end - own_length < LOOK_AHEAD_M:
        next_edge = next_edges.get(lane.edge_id)
        fitting = [x for x in lane.successors if road.lanes[x.to_lane].edge_id == next_edge]
        link = (fitting or list(lane.successors))[0]
        for name in (*link.via, link.to_lane):
            if name in distances:
                return distances
            distances[name] = end
            end += road.lanes[name].length_m
        lane = road.lanes[link.to_lane]
    return distances
