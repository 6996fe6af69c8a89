"""Entering the lane of another road user that keeps its own: when, with which gap, and whether that was enough."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.boxes import corners
from advdiff_sumo.core.polylines import SAME_POINT_M, Polyline
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.placement import Placement
from advdiff_sumo.metrics.safe_gap import safe_gap_m
from advdiff_sumo.metrics.traffic_view import TrafficView

#: A lane entered longer ago than this is the vehicle's own.
CUT_IN_WINDOW_S = 3.0
#: Reaching over the lane's edge by more than this is leaving the lane (as UN Regulation 157, 5.2.5.2).
INTRUSION_M = 0.3
#: Headings that differ by more than this oppose each other (135°).
OPPOSITE_RAD = 2.356194490192345
_AHEAD_M = 30.0


@dataclass(frozen=True)
class LaneEntry:
    """One road user entering the lane of another that keeps its own.

    Attributes:
        row: who enters.
        gap_m: from the keeper's front to the nearest part of the one who enters, along the lane; negative when
            side by side.
        follower_mps: speed of the one who keeps its lane.
        leader_mps: speed of the one who enters, along that lane.
        step: instant.
        time_s: the same, since the episode's start.
        length_m: length of the box of the one who enters.
        oncoming: the two face each other.
        leaves_lane: the one who enters leaves a lane of its own for it; False where two lanes merge or cross.
        recovered: the gap was a safe one at some later instant before the end.
    """

    row: int
    gap_m: float
    follower_mps: float
    leader_mps: float
    step: int
    time_s: float
    length_m: float
    oncoming: bool
    leaves_lane: bool
    recovered: bool

    @property
    def needed_m(self) -> float:
        """The gap that the follower needs, after RSS."""
        return safe_gap_m(self.follower_mps, max(0.0, self.leader_mps))

    @property
    def safe(self) -> bool:
        """Whether the follower was left the gap that it needs."""
        return self.gap_m >= self.needed_m

    @property
    def ahead(self) -> bool:
        """Whether its centre was ahead of the keeper's front."""
        return self.gap_m > -0.5 * self.length_m


@dataclass(frozen=True)
class _Corridor:
    """The lane that an agent keeps, as one line; N instants.

    Attributes:
        line: its centre.
        half_width_m: half its width.
        overhang_m: (N,) how far the agent reaches out of it.
        change: index of the instant at which the agent leaves it for the lane beside; None: it does not.
    """

    line: Polyline
    half_width_m: float
    overhang_m: FloatArray
    change: int | None


def lane_entry(
    view: TrafficView, entering: int, keeping: int, start: int, step: int, window_s: float
) -> LaneEntry | None:
    """Return since when agent *entering* has been in the lane of agent *keeping*, which keeps it.

    None when it is not in that lane at instant *step*, has been there for longer than *window_s* or ever since
    *start*, or comes from behind. A keeper who swerves after that has kept its lane.
    """
    for corridor in _corridors(view, keeping, start, step):
        entry = _entry(view, entering, keeping, corridor, start, step, window_s)
        if entry is not None:
            return entry
    return None


def reaches_into(view: TrafficView, row: int, keeping: int, start: int, step: int) -> bool:
    """Return whether the box of *row* reaches into the lane that *keeping* is on at instant *step*."""
    corridor = _corridors(view, keeping, start, step)[-1]
    return bool(_inside(view, row, corridor, step, step + 1)[0])


def lane_changes(road: RoadMap, lanes: tuple[str | None, ...]) -> list[int]:
    """Return the indices at which a vehicle is on another lane of its edge than when last seen on one."""
    known = [(i, x) for i, x in enumerate(lanes) if x is not None]
    return [
        i for (_, a), (i, b) in pairwise(known) if a != b and road.lanes[a].edge_id == road.lanes[b].edge_id
    ]


def _corridors(view: TrafficView, row: int, start: int, step: int) -> list[_Corridor]:
    """Return the lane of *row*: first the one it left lately, if it did, then the one it is on."""
    lanes = view.place(row, start, step + 1)
    recent = len(lanes.lane) - 1 - view.steps(CUT_IN_WINDOW_S)
    change = next((i for i in lane_changes(view.road, lanes.lane) if i > recent), None)
    held = [] if change is None else [_corridor(view, row, start, lanes, change)]
    return [*held, _corridor(view, row, start, lanes, None)]


def _corridor(view: TrafficView, row: int, start: int, lanes: Placement, change: int | None) -> _Corridor:
    road, tracks = view.road, view.tracks
    names = list(lanes.lane)
    if change is not None:
        _hold(road, names, change)
    xy = tracks.xy_m[row, start : start + len(names)]
    centre, offset = xy.copy(), np.zeros(len(names))
    for name in {x for x in names if x is not None}:
        steps = np.array([x == name for x in names])
        s, offset[steps] = road.lanes[name].line.project(xy[steps])
        centre[steps] = road.lanes[name].line.at(s)[0]
    widths = [road.lanes[x].width_m for x in names if x is not None]
    half = 0.5 * float(np.median(widths)) if widths else 0.5 * float(tracks.size_m[row, 1])
    ahead = _way_ahead(road, names[-1], centre[-1], float(tracks.yaw_rad[row, start + len(names) - 1]))
    line = _joined(centre[np.isfinite(centre).all(axis=1)], ahead)
    excess = max(0.0, 0.5 * float(tracks.size_m[row, 1]) - half)
    overhang = np.abs(offset) + lanes.reach_m - half - excess
    return _Corridor(line, half, np.where(np.isnan(lanes.reach_m), np.inf, overhang), change)


def _hold(road: RoadMap, names: list[str | None], change: int) -> None:
    """Put the lane that was left at *change* in place of those beside it from there on."""
    before = next(x for x in names[change - 1 :: -1] if x is not None)
    edge, index = road.lanes[before].edge_id, road.lanes[before].index
    for i in range(change, len(names)):
        name = names[i]
        if name is not None and road.lanes[name].edge_id == edge:
            names[i] = road.edges[edge].lane_ids[index]


def _way_ahead(road: RoadMap, lane_id: str | None, xy_m: FloatArray, yaw_rad: float) -> FloatArray:
    """Return (K, 2) points of the way beyond *xy_m*: the rest of the lane, or straight on."""
    if lane_id is None:
        return np.asarray(xy_m + _AHEAD_M * np.array((np.cos(yaw_rad), np.sin(yaw_rad))))[None]
    line = road.lanes[lane_id].line
    s, _ = line.project(xy_m)
    xy, yaw = line.at(line.length_m)
    beyond = xy + _AHEAD_M * np.array((np.cos(yaw), np.sin(yaw)))
    return np.vstack((line.xy_m[line.s_m > s + SAME_POINT_M], beyond))


def _joined(driven_m: FloatArray, ahead_m: FloatArray) -> Polyline:
    """Return the line through both, without points nearer than 0.2 m to the one before: noise of standing."""
    points = np.vstack((driven_m, ahead_m))
    kept = [points[0]]
    for point in points[1:]:
        if np.hypot(*(point - kept[-1])) > 0.2:
            kept.append(point)
    return Polyline.of(np.array(kept))


def _inside(view: TrafficView, row: int, corridor: _Corridor, start: int, stop: int) -> BoolArray:
    """Return (N,) whether the box of *row* reaches over the edge of *corridor* by more than ``INTRUSION_M``."""
    _, d = corridor.line.project(_boxes(view, row, start, stop), extrapolate=True)
    edge = corridor.half_width_m - INTRUSION_M
    return np.asarray((d.min(-1) < edge) & (d.max(-1) > -edge))  # NaN compares as False


def _boxes(view: TrafficView, row: int, start: int, stop: int) -> FloatArray:
    tracks = view.tracks
    size = np.broadcast_to(tracks.size_m[row], (stop - start, 2))
    return corners(tracks.xy_m[row, start:stop], tracks.yaw_rad[row, start:stop], size)


def _entry(
    view: TrafficView,
    entering: int,
    keeping: int,
    corridor: _Corridor,
    start: int,
    step: int,
    window_s: float,
) -> LaneEntry | None:
    at = _entered(view, entering, corridor, start, step, window_s)
    if at is None or not _keeps(view, keeping, corridor, start, step, at):
        return None
    tracks = view.tracks
    cos = np.cos(tracks.yaw_rad[entering, at : step + 1] - tracks.yaw_rad[keeping, at : step + 1])
    own, other = (
        corridor.line.project(_boxes(view, r, at, step + 1), extrapolate=True)[0] for r in (keeping, entering)
    )
    if other[0].max() < own[0].min():
        return None  # it comes from behind
    gap = other.min(-1) - own.max(-1)
    follower, leader = (
        tracks.speed_mps[keeping, at : step + 1],
        cos * tracks.speed_mps[entering, at : step + 1],
    )
    return LaneEntry(
        row=entering,
        gap_m=float(gap[0]),
        follower_mps=float(follower[0]),
        leader_mps=float(leader[0]),
        step=at,
        time_s=view.time_s(at),
        length_m=float(tracks.size_m[entering, 0]),
        oncoming=bool(cos[0] < np.cos(OPPOSITE_RAD)),
        leaves_lane=_leaves_own_lane(view, entering, start, step, at),
        recovered=bool((gap >= safe_gap_m(follower, np.maximum(0.0, leader)))[1:].any()),
    )


def _entered(
    view: TrafficView, entering: int, corridor: _Corridor, start: int, step: int, window_s: float
) -> int | None:
    """Return the instant since which *entering* has been in *corridor*, if that is within *window_s* of *step*."""
    inside = _inside(view, entering, corridor, start, step + 1)
    last = int(np.flatnonzero(inside)[-1]) if inside.any() else -1
    if last < (len(inside) - 1 if corridor.change is None else corridor.change):
        return None
    outside = np.flatnonzero(~inside[:last])
    if not outside.size:
        return None
    at = start + int(outside[-1]) + 1
    there = view.tracks.valid[entering, at - 1]  # else it was put there, as SUMO inserts vehicles
    return at if there and step - at <= view.steps(window_s) else None


def _keeps(view: TrafficView, keeping: int, corridor: _Corridor, start: int, step: int, at: int) -> bool:
    """Return whether *keeping* had not left its lane by the instant *at*, nor changed to it just before."""
    if corridor.change is not None and start + corridor.change < at:
        return False
    since = at - start - view.steps(CUT_IN_WINDOW_S)
    lanes = view.place(keeping, start, step + 1).lane
    changed = any(since < i <= at - start for i in lane_changes(view.road, lanes))
    return not changed and bool(corridor.overhang_m[at - start] <= INTRUSION_M)


def _leaves_own_lane(view: TrafficView, row: int, start: int, step: int, at: int) -> bool:
    """Return whether *row* reaches out of its lane or changes it around the instant *at*."""
    lanes = view.place(row, start, step + 1)
    since = max(0, at - start - view.steps(1.0))
    if lane_changes(view.road, lanes.lane[since:]):
        return True
    half_m = 0.5 * float(view.tracks.size_m[row, 1])
    excess = np.maximum(0.0, half_m - lanes.half_width_m[since:])
    over = np.abs(lanes.d_m[since:]) + lanes.reach_m[since:] - lanes.half_width_m[since:] - excess
    return bool((np.isnan(over) | (over > INTRUSION_M)).any())
