"""Entries of one road user into the lane that another keeps: when, with which gap, and whether it was safe."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.boxes import corners
from advdiff_sumo.core.polylines import SAME_POINT_M, Polyline
from advdiff_sumo.core.scene import AgentClass
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
#: A lane is extended straight beyond its end by this.
_BEYOND_M = 30.0
#: Points of a line nearer to the previous one than this are dropped.
_LEAST_SPACING_M = 0.2


@dataclass(frozen=True)
class LaneEntry:
    """The entry of one road user into the lane of another, the follower, that keeps its lane.

    Attributes:
        row: row of the road user that enters.
        gap_m: distance along the lane from the follower's front to the nearest part of the entering box; negative when
            side by side.
        follower_mps: speed of the follower.
        leader_mps: speed along the lane of the road user that enters.
        step: instant of the entry.
        time_s: time of the entry since the episode's start.
        length_m: length of the entering box.
        oncoming: whether two vehicles face each other; False for a pedestrian, who may walk in any direction.
        leaves_lane: whether it leaves a lane of its own; False where two lanes merge or cross.
        recovered: whether the gap was safe again at some later instant before the end.
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
        """Whether the gap is as large as the follower needs."""
        return self.gap_m >= self.needed_m

    @property
    def ahead(self) -> bool:
        """Whether the centre of the entering box was ahead of the follower's front."""
        return self.gap_m > -0.5 * self.length_m


@dataclass(frozen=True)
class _Corridor:
    """The lane that an agent keeps, as one line; N instants.

    Attributes:
        line: its centre line.
        half_width_m: half its width.
        overhang_m: (N,) distance by which the agent reaches out of it.
        change: index of the instant at which the agent changes to a parallel lane; None if it does not.
    """

    line: Polyline
    half_width_m: float
    overhang_m: FloatArray
    change: int | None


def lane_entry(
    view: TrafficView, entering: int, keeping: int, start: int, step: int, window_s: float
) -> LaneEntry | None:
    """Return the entry of agent *entering* into the lane of agent *keeping* that lasts until instant *step*.

    None if *entering* is not in that lane at *step*, has been there for longer than *window_s* or since *start*, or
    comes from behind. *keeping* has to keep its lane until the entry only; it may swerve afterwards.
    """
    for corridor in _corridors(view, keeping, start, step):
        entry = _entry(view, entering, keeping, corridor, start, step, window_s)
        if entry is not None:
            return entry
    return None


def reaches_into(view: TrafficView, row: int, keeping: int, start: int, step: int) -> bool:
    """Return whether the box of *row* reaches into the lane of *keeping* at instant *step*."""
    corridor = _corridors(view, keeping, start, step)[-1]
    return bool(_inside(view, row, corridor, step, step + 1)[0])


def lane_changes(road: RoadMap, lanes: tuple[str | None, ...]) -> list[int]:
    """Return the indices in *lanes* at which a vehicle is on another lane of the same edge than before."""
    known = [(i, x) for i, x in enumerate(lanes) if x is not None]
    return [
        i for (_, a), (i, b) in pairwise(known) if a != b and road.lanes[a].edge_id == road.lanes[b].edge_id
    ]


def _corridors(view: TrafficView, row: int, start: int, step: int) -> list[_Corridor]:
    """Return the lanes that *row* may be said to keep: one that it left recently, if any, then its present one."""
    lanes = view.place(row, start, step + 1)
    recent = len(lanes.lane) - 1 - view.steps(CUT_IN_WINDOW_S)
    change = next((i for i in lane_changes(view.road, lanes.lane) if i > recent), None)
    left = [] if change is None else [_corridor(view, row, start, lanes, change)]
    return [*left, _corridor(view, row, start, lanes, None)]


def _corridor(view: TrafficView, row: int, start: int, lanes: Placement, change: int | None) -> _Corridor:
    """Return the lane of *row*; with *change*, the lane that it left at that index of *lanes*, continued."""
    road, tracks = view.road, view.tracks
    names = list(lanes.lane)
    if change is not None:
        _undo_change(road, names, change)
    xy = tracks.xy_m[row, start : start + len(names)]
    centre, offset = xy.copy(), np.zeros(len(names))
    for name in {x for x in names if x is not None}:
        steps = np.array([x == name for x in names])
        s, offset[steps] = road.lanes[name].line.project(xy[steps])
        centre[steps] = road.lanes[name].line.at(s)[0]
    widths = [road.lanes[x].width_m for x in names if x is not None]
    half_width = 0.5 * float(np.median(widths)) if widths else 0.5 * float(tracks.size_m[row, 1])
    ahead = _points_ahead(road, names[-1], centre[-1], float(tracks.yaw_rad[row, start + len(names) - 1]))
    line = _joined(centre[np.isfinite(centre).all(axis=1)], ahead)
    excess = max(0.0, 0.5 * float(tracks.size_m[row, 1]) - half_width)  # of a box wider than its lane
    overhang = np.abs(offset) + lanes.reach_m - half_width - excess
    return _Corridor(line, half_width, np.where(np.isnan(lanes.reach_m), np.inf, overhang), change)


def _undo_change(road: RoadMap, names: list[str | None], change: int) -> None:
    """Replace, from index *change* on, the parallel lanes in *names* by the lane that was left there."""
    before = next(x for x in names[change - 1 :: -1] if x is not None)
    edge, index = road.lanes[before].edge_id, road.lanes[before].index
    for i in range(change, len(names)):
        name = names[i]
        if name is not None and road.lanes[name].edge_id == edge:
            names[i] = road.edges[edge].lane_ids[index]


def _points_ahead(road: RoadMap, lane_id: str | None, xy_m: FloatArray, yaw_rad: float) -> FloatArray:
    """Return (K, 2) points beyond *xy_m*: the rest of the lane and straight on, or straight on along *yaw_rad*."""
    if lane_id is None:
        return np.asarray(xy_m + _BEYOND_M * np.array((np.cos(yaw_rad), np.sin(yaw_rad))))[None]
    line = road.lanes[lane_id].line
    s, _ = line.project(xy_m)
    xy, yaw = line.at(line.length_m)
    beyond = xy + _BEYOND_M * np.array((np.cos(yaw), np.sin(yaw)))
    return np.vstack((line.xy_m[line.s_m > s + SAME_POINT_M], beyond))


def _joined(driven_m: FloatArray, ahead_m: FloatArray) -> Polyline:
    """Return the line through both, without points that are close together, as those of a standing vehicle."""
    points = np.vstack((driven_m, ahead_m))
    spaced = [points[0]]
    for point in points[1:]:
        if np.hypot(*(point - spaced[-1])) > _LEAST_SPACING_M:
            spaced.append(point)
    return Polyline.of(np.array(spaced))


def _inside(view: TrafficView, row: int, corridor: _Corridor, start: int, stop: int) -> BoolArray:
    """Return (N,) whether the box of *row* reaches over the edge of *corridor* by more than ``INTRUSION_M``."""
    _, d = corridor.line.project(_box_corners(view, row, start, stop), extrapolate=True)
    bound = corridor.half_width_m - INTRUSION_M
    return np.asarray((d.min(-1) < bound) & (d.max(-1) > -bound))  # NaN compares as False


def _box_corners(view: TrafficView, row: int, start: int, stop: int) -> FloatArray:
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
    entered = _entered(view, entering, corridor, start, step, window_s)
    if entered is None or not _keeps(view, keeping, corridor, start, step, entered):
        return None
    tracks, since = view.tracks, slice(entered, step + 1)
    cos = np.cos(tracks.yaw_rad[entering, since] - tracks.yaw_rad[keeping, since])
    follower_s, leader_s = (
        corridor.line.project(_box_corners(view, row, entered, step + 1), extrapolate=True)[0]
        for row in (keeping, entering)
    )
    if leader_s[0].max() < follower_s[0].min():
        return None  # it comes from behind
    gap = leader_s.min(-1) - follower_s.max(-1)
    follower_mps, leader_mps = tracks.speed_mps[keeping, since], cos * tracks.speed_mps[entering, since]
    return LaneEntry(
        row=entering,
        gap_m=float(gap[0]),
        follower_mps=float(follower_mps[0]),
        leader_mps=float(leader_mps[0]),
        step=entered,
        time_s=view.time_s(entered),
        length_m=float(tracks.size_m[entering, 0]),
        oncoming=bool(cos[0] < np.cos(OPPOSITE_RAD)) and tracks.classes[entering] != AgentClass.PEDESTRIAN,
        leaves_lane=_leaves_own_lane(view, entering, start, step, entered),
        recovered=bool((gap >= safe_gap_m(follower_mps, np.maximum(0.0, leader_mps)))[1:].any()),
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
    entered = start + int(outside[-1]) + 1
    was_present = view.tracks.valid[entering, entered - 1]  # else it was inserted there
    return entered if was_present and step - entered <= view.steps(window_s) else None


def _keeps(view: TrafficView, keeping: int, corridor: _Corridor, start: int, step: int, entered: int) -> bool:
    """Return whether *keeping* had not left its lane by the instant *entered*, nor changed to it shortly before.

    Who was in its present lane before it changed to that did not enter its lane.
    """
    if corridor.change is not None and start + corridor.change < entered:
        return False
    since = entered - start - view.steps(CUT_IN_WINDOW_S)
    lanes = view.place(keeping, start, step + 1).lane
    until = step - start if corridor.change is None else entered - start
    changed = any(since < i <= until for i in lane_changes(view.road, lanes))
    return not changed and bool(corridor.overhang_m[entered - start] <= INTRUSION_M)


def _leaves_own_lane(view: TrafficView, row: int, start: int, step: int, entered: int) -> bool:
    """Return whether *row* reaches out of its lane or changes it from 1 s before *entered* until *step*."""
    lanes = view.place(row, start, step + 1)
    since = max(0, entered - start - view.steps(1.0))
    if lane_changes(view.road, lanes.lane[since:]):
        return True
    half_m = 0.5 * float(view.tracks.size_m[row, 1])
    excess = np.maximum(0.0, half_m - lanes.half_width_m[since:])  # of a box wider than its lane
    overhang = np.abs(lanes.d_m[since:]) + lanes.reach_m[since:] - lanes.half_width_m[since:] - excess
    return bool((np.isnan(overhang) | (overhang > INTRUSION_M)).any())
