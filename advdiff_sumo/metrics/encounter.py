"""What led to a collision: the lanes, links and manoeuvres of both vehicles in the seconds before it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.boxes import corners
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.maps import Link, RoadMap
from advdiff_sumo.metrics.collision import Collision
from advdiff_sumo.metrics.placement import Placement, place

#: How far back lanes are looked at; long enough to find the approach to a junction.
HISTORY_S = 10.0
#: A lane entered longer ago than this is the vehicle's own.
CUT_IN_WINDOW_S = 3.0
#: Reaching over the lane's edge by more than this is leaving the lane (as UN Regulation 157, 5.2.5.2).
INTRUSION_M = 0.3
#: A heading farther than this from that of the lane is the wrong way.
WRONG_WAY_RAD = 2.0
#: How far from a centre line a vehicle may be to be on a lane at all.
_LEAST_SPEED_MPS = 0.05


@dataclass(frozen=True)
class Party:
    """One of the two vehicles.

    Attributes:
        row: its row.
        name: its id.
        speed_mps: signed speed at the instant before the contact.
        face: what was hit: "front", "rear", "left", "right".
        lanes: its lanes from the start of the history to the instant before the contact.
        wrong_way: whether it drives against its lane's direction.
        overhang_m: how far it reaches out of its lane; inf off any lane.
        changed_lane: whether it changed to another lane of its edge within ``CUT_IN_WINDOW_S``.
        link: how it crosses the junction of the collision; None when it is not crossing.
        entered_step: instant at which it entered that junction; None when not seen.
    """

    row: int
    name: str
    speed_mps: float
    face: str
    lanes: Placement
    wrong_way: bool
    overhang_m: float
    changed_lane: bool
    link: Link | None
    entered_step: int | None

    @property
    def stands(self) -> bool:
        """Whether it stands still (below 0.05 m/s, the limit of nuPlan's metric)."""
        return abs(self.speed_mps) <= _LEAST_SPEED_MPS

    @property
    def leaves_lane(self) -> bool:
        """Whether it reaches out of its lane by more than ``INTRUSION_M``."""
        return self.overhang_m > INTRUSION_M


@dataclass(frozen=True)
class LaneEntry:
    """One vehicle entering the lane of another that keeps its own.

    Attributes:
        by_target: whether the target is the one who enters.
        gap_m: bumper to bumper along the lane at that instant; negative when side by side.
        follower_mps: speed of the vehicle behind.
        leader_mps: speed of the vehicle that entered.
        time_s: when, since the episode's start.
    """

    by_target: bool
    gap_m: float
    follower_mps: float
    leader_mps: float
    time_s: float


@dataclass(frozen=True)
class Encounter:
    """A collision of the target with its circumstances.

    Attributes:
        collision: the collision.
        target: the tested vehicle.
        other: its partner.
        junction: id of the junction on which it happened, or None.
        entry: who entered whose lane shortly before, or None.
    """

    collision: Collision
    target: Party
    other: Party
    junction: str | None
    entry: LaneEntry | None


def encounter(record: EpisodeRecord, road: RoadMap, collision: Collision) -> Encounter:
    """Return the circumstances of *collision*, in which the target must take part."""
    start = max(0, collision.step - round(HISTORY_S / record.tracks.dt_s))
    placed = [place(road, record.tracks, row, start, collision.step + 1) for row in collision.rows]
    junction = next((j for j in (_junction(road, p.lane[-1]) for p in placed) if j is not None), None)
    target, other = (
        _party(record, road, collision, which, placed[which], junction, start) for which in (0, 1)
    )
    entry = None
    for entering, keeping in ((other, target), (target, other)):
        if entry is None and not keeping.changed_lane and not keeping.leaves_lane:
            entry = _lane_entry(record, road, entering, keeping, start)
    return Encounter(collision, target, other, junction, entry)


def _party(
    record: EpisodeRecord,
    road: RoadMap,
    collision: Collision,
    which: int,
    lanes: Placement,
    junction: str | None,
    start: int,
) -> Party:
    row = collision.rows[which]
    route = record.route if row == record.target else ()
    link, entered = _crossing(road, lanes, junction, route)
    recent = round(CUT_IN_WINDOW_S / record.tracks.dt_s)
    return Party(
        row=row,
        name=record.tracks.ids[row],
        speed_mps=float(record.tracks.speed_mps[row, collision.step]),
        face=collision.faces[which],
        lanes=lanes,
        wrong_way=bool(abs(lanes.yaw_error_rad[-1]) > WRONG_WAY_RAD),
        overhang_m=lanes.overhang_m(-1),
        changed_lane=_changes_lane(road, lanes.lane[-recent - 1 :]),
        link=link,
        entered_step=None if entered is None else start + entered,
    )


def _junction(road: RoadMap, lane_id: str | None) -> str | None:
    if lane_id is None or not road.lanes[lane_id].is_internal:
        return None
    return road.edges[road.lanes[lane_id].edge_id].from_junction


def _changes_lane(road: RoadMap, lanes: tuple[str | None, ...]) -> bool:
    known = [x for x in lanes if x is not None]
    return any(a != b and road.lanes[a].edge_id == road.lanes[b].edge_id for a, b in pairwise(known))


def _crossing(
    road: RoadMap, lanes: Placement, junction: str | None, route: tuple[str, ...]
) -> tuple[Link | None, int | None]:
    """Return the link by which a vehicle crosses *junction* and the instant (in *lanes*) of its entry."""
    if junction is None:
        return None, None
    inside = [_junction(road, x) == junction for x in lanes.lane]
    if not inside[-1]:
        return _link_ahead(road, lanes.lane[-1], junction, route), None
    entry = len(inside) - inside[::-1].index(False) if False in inside else None
    approach = lanes.lane[entry - 1] if entry is not None else None
    driven = [x for x in lanes.lane[entry or 0 :] if x is not None]
    options = [x for x in road.links.values() if x.junction_id == junction]
    options = [x for x in options if x.from_lane == approach] or options
    return max(options, key=lambda x: _fit(road, x, driven, route), default=None), entry


def _link_ahead(road: RoadMap, lane_id: str | None, junction: str, route: tuple[str, ...]) -> Link | None:
    """Return the link that a vehicle still before *junction* will take; None when it has left it."""
    if lane_id is None:
        return None
    ahead = [x for x in road.lanes[lane_id].successors if x.junction_id == junction]
    return max(ahead, key=lambda x: _fit(road, x, [], route), default=None)


def _fit(road: RoadMap, link: Link, driven: list[str], route: tuple[str, ...]) -> tuple[int, bool]:
    on_route = (road.lanes[link.from_lane].edge_id, road.lanes[link.to_lane].edge_id) in set(pairwise(route))
    return sum(x in link.via for x in driven), on_route


def _lane_entry(
    record: EpisodeRecord, road: RoadMap, entering: Party, keeping: Party, start: int
) -> LaneEntry | None:
    """Return the moment since which *entering* has been in the lane of *keeping*; None if it always was or is not."""
    inside = _in_lane_of(record, road, entering.row, keeping.lanes, start)
    recent = round(CUT_IN_WINDOW_S / record.tracks.dt_s)
    if not inside[-1] or inside[-recent - 1 :].all():
        return None
    at = start + len(inside) - int(np.argmin(inside[::-1]))
    tracks = record.tracks
    offset = tracks.xy_m[entering.row, at] - tracks.xy_m[keeping.row, at]
    yaw = tracks.yaw_rad[keeping.row, at]
    lengths = tracks.size_m[entering.row, 0] + tracks.size_m[keeping.row, 0]
    return LaneEntry(
        by_target=entering.row == record.target,
        gap_m=float(offset @ (np.cos(yaw), np.sin(yaw)) - 0.5 * lengths),
        follower_mps=float(tracks.speed_mps[keeping.row, at]),
        leader_mps=float(tracks.speed_mps[entering.row, at]),
        time_s=tracks.t0_s + at * tracks.dt_s,
    )


def _in_lane_of(record: EpisodeRecord, road: RoadMap, row: int, kept: Placement, start: int) -> BoolArray:
    """Return (N,) whether agent *row* reaches more than ``INTRUSION_M`` into the other's lane at each instant."""
    stop = start + len(kept.lane)
    tracks = record.tracks
    size = np.broadcast_to(tracks.size_m[row], (stop - start, 2))
    boxes = corners(tracks.xy_m[row, start:stop], tracks.yaw_rad[row, start:stop], size)
    inside = np.zeros(stop - start, dtype=np.bool_)
    for lane_id in sorted({x for x in kept.lane if x is not None}):
        steps = np.array([x == lane_id for x in kept.lane])
        inside[steps] = _reaches_into(road, lane_id, boxes[steps])
    return inside


def _reaches_into(road: RoadMap, lane_id: str, boxes_m: FloatArray) -> BoolArray:
    lane = road.lanes[lane_id]
    _, d = lane.line.project(boxes_m, extrapolate=True)  # (N, 4)
    edge = 0.5 * lane.width_m - INTRUSION_M
    return np.asarray((d.min(-1) < edge) & (d.max(-1) > -edge))
