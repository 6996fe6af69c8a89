"""What led to a collision: the lanes, links and manoeuvres of both road users in the seconds before it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.maps import Link, RoadMap
from advdiff_sumo.metrics.collision import Collision
from advdiff_sumo.metrics.lane_entry import (
    CUT_IN_WINDOW_S,
    INTRUSION_M,
    LaneEntry,
    lane_changes,
    lane_entry,
    reaches_into,
)
from advdiff_sumo.metrics.placement import Placement
from advdiff_sumo.metrics.traffic_view import TrafficView

#: How far back lanes are looked at; long enough to find the approach to a junction.
HISTORY_S = 10.0
#: What happened longer ago than this did not lead to the contact.
BREACH_WINDOW_S = 5.0
#: A heading farther than this from that of the lane is the wrong way.
WRONG_WAY_RAD = 2.0
#: A vehicle that has stood this long in the way could be seen.
STOOD_S = 1.0
#: Standing: slower than this (the limit of nuPlan's metric), or nearer than ``_LEAST_MOVE_M`` to where it was.
LEAST_SPEED_MPS = 0.05
_LEAST_MOVE_M = 0.1
_LEAST_MOVE_S = 0.5


@dataclass(frozen=True)
class Party:
    """One of the two road users.

    Attributes:
        row: its row.
        name: its id.
        agent_class: what it is.
        speed_mps: signed speed at the instant before the contact.
        face: its side at the contact: "front", "rear", "left", "right".
        lanes: its lanes from the start of the history to the instant before the contact.
        first_lane: of these, the lane at the first instant at which it is there; None where no lane is near then.
        wrong_way: whether it drives, not walks, against its lane's direction.
        overhang_m: how far it reaches out of its lane; inf off any lane.
        changed_lane: whether it changed to another lane of its edge within ``CUT_IN_WINDOW_S``.
        intrudes: whether it reaches into the lane of the other.
        stands: whether it stands still.
        stood: whether it has stood for ``STOOD_S``, so that the other could react.
        link: how it crosses the junction on which the two meet; None when it does not.
        entered_step: instant at which its centre entered that junction, or the last, where only its front has and it
            does not stand; None when not seen.
        line_step: instant since which its front was over the stop line then; None when not seen.
    """

    row: int
    name: str
    agent_class: AgentClass
    speed_mps: float
    face: str
    lanes: Placement
    first_lane: str | None
    wrong_way: bool
    overhang_m: float
    changed_lane: bool
    intrudes: bool
    stands: bool
    stood: bool
    link: Link | None
    entered_step: int | None
    line_step: int | None

    @property
    def leaves_lane(self) -> bool:
        """Whether it reaches out of its lane by more than ``INTRUSION_M``; who walks has none."""
        return not self.is_pedestrian and self.overhang_m > INTRUSION_M

    @property
    def is_pedestrian(self) -> bool:
        """Whether it walks; rules about lanes do not bind it."""
        return self.agent_class == AgentClass.PEDESTRIAN


@dataclass(frozen=True)
class JunctionEntry:
    """How a vehicle entered a junction.

    Attributes:
        link: by which it crosses the junction.
        line_step: instant since which its front was over the stop line.
        entered_step: instant at which its centre entered the junction.
    """

    link: Link
    line_step: int
    entered_step: int


@dataclass(frozen=True)
class Encounter:
    """A collision of two road users with its circumstances.

    Attributes:
        collision: the collision itself.
        target: the first of the two: the tested vehicle, where it takes part.
        other: its partner.
        junction: id of the junction on which it happened, or None.
        merged: id of the junction, left before, on which their ways joined within ``BREACH_WINDOW_S``, or None.
        entry: who entered whose lane within ``BREACH_WINDOW_S``, or None.
        start: first instant looked at.
    """

    collision: Collision
    target: Party
    other: Party
    junction: str | None
    merged: str | None
    entry: LaneEntry | None
    start: int

    @property
    def parties(self) -> tuple[Party, Party]:
        """Both, in the order of the collision's rows."""
        return self.target, self.other

    def is_run_into(self, which: int) -> bool:
        """Return whether the other ran with its front into the rear of party *which*."""
        return self.parties[which].face == "rear" and self.parties[1 - which].face == "front"

    @property
    def cut_in(self) -> LaneEntry | None:
        """The entry, if it was within ``CUT_IN_WINDOW_S`` of the contact."""
        recent = self.entry is not None and self.collision.time_s - self.entry.time_s <= CUT_IN_WINDOW_S + 0.1
        return self.entry if recent else None

    @property
    def crossing(self) -> bool:
        """Whether the two came to a common junction from different approaches; by headings where not known.

        Who walks comes by no approach.
        """
        if self.merged is not None:
            return True
        if self.junction is None or any(x.is_pedestrian for x in self.parties):
            return False
        a, b = self.target.link, self.other.link
        if a is None or b is None:
            return self.collision.heading_difference_rad > 0.25 * np.pi
        return a.from_lane.rsplit("_", 1)[0] != b.from_lane.rsplit("_", 1)[0]


def encounter(view: TrafficView, collision: Collision) -> Encounter:
    """Return the circumstances of *collision*, of any two agents of *view*."""
    step = collision.step
    start = max(0, step - view.steps(HISTORY_S))
    placed = [view.place(row, start, step + 1) for row in collision.rows]
    junction = next((j for j in (junction_of(view.road, p.lane[-1]) for p in placed) if j is not None), None)
    merged = None if junction is not None else _merging(view, collision, placed)
    target, other = (_party(view, collision, which, placed, junction or merged, start) for which in (0, 1))
    return Encounter(
        collision, target, other, junction, merged, _entry_of(view, target, other, start, step), start
    )


def _entry_of(view: TrafficView, target: Party, other: Party, start: int, step: int) -> LaneEntry | None:
    """Return the first entry of one into the lane of the other."""
    entries = [
        lane_entry(view, entering.row, keeping.row, start, step, BREACH_WINDOW_S)
        for entering, keeping in ((other, target), (target, other))
        if not keeping.is_pedestrian
    ]
    return min((x for x in entries if x is not None), key=lambda x: x.step, default=None)


def _merging(view: TrafficView, collision: Collision, placed: list[Placement]) -> str | None:
    """Return the junction by which both came lately, from different edges, and on which their ways joined."""
    recent, rows = view.steps(BREACH_WINDOW_S), collision.rows
    one, two = ([junction_of(view.road, x) for x in p.lane[: -recent - 2 : -1]] for p in placed)
    for junction in dict.fromkeys(x for both in zip(one, two, strict=True) for x in both if x is not None):
        first, second = (_came_by(view, rows[k], placed[k], junction) for k in (0, 1))
        if first is None or second is None:
            continue
        if _join(view.road, first, second):
            return junction
    return None


def _join(road: RoadMap, first: Link, second: Link) -> bool:
    """Return whether two links of a junction come from different edges and join, as those of an added lane do not."""
    (a, to_a), (b, to_b) = (
        (road.lanes[x.from_lane].edge_id, road.lanes[x.to_lane].edge_id) for x in (first, second)
    )
    onto_one = first.to_lane == second.to_lane or ways_meet(road, first, second)
    return a != b and to_a == to_b and onto_one


def ways_meet(road: RoadMap, first: Link, second: Link) -> bool:
    """Return whether the ways by two links over the same junction cross or join in the net."""
    return first.junction_id == second.junction_id and second.request_index in road.foes_of(first)


def _came_by(view: TrafficView, row: int, lanes: Placement, junction: str) -> Link | None:
    """Return the link by which *row* crossed *junction* lately, or begins to with its front; None: it did not."""
    recent = view.steps(BREACH_WINDOW_S)
    link, _ = _crossing(view.road, lanes, junction, view.routes.get(row, ()), recent)
    been = any(junction_of(view.road, x) == junction for x in lanes.lane[-recent - 1 :])
    return link if been or (link is not None and _noses_in(view, row, lanes, link)) else None


def _party(
    view: TrafficView,
    collision: Collision,
    which: int,
    placed: list[Placement],
    junction: str | None,
    start: int,
) -> Party:
    row, lanes, step = collision.rows[which], placed[which], collision.step
    walks = view.tracks.classes[row] == AgentClass.PEDESTRIAN
    recent, route = view.steps(BREACH_WINDOW_S), view.routes.get(row, ())
    link, entered = (None, None) if walks else _crossing(view.road, lanes, junction, route, recent)
    stood = _stood(view, row, step)
    if entered is None and link is not None and not stood and _noses_in(view, row, lanes, link):
        entered = len(lanes.lane) - 1
    over = None if entered is None else _over_line(view, row, lanes, entered)
    speed = float(view.tracks.speed_mps[row, step])
    return Party(
        row=row,
        name=view.tracks.ids[row],
        agent_class=AgentClass(int(view.tracks.classes[row])),
        speed_mps=speed,
        face=collision.faces[which],
        lanes=lanes,
        first_lane=lanes.lane[int(view.tracks.valid[row, start : step + 1].argmax())],
        wrong_way=not walks and bool(abs(lanes.yaw_error_rad[-1]) > WRONG_WAY_RAD),
        overhang_m=lanes.overhang_m(-1),
        changed_lane=bool(lane_changes(view.road, lanes.lane[-view.steps(CUT_IN_WINDOW_S) - 1 :])),
        intrudes=reaches_into(view, row, collision.rows[1 - which], start, step),
        stands=abs(speed) <= LEAST_SPEED_MPS or _rests(view, row, step, _LEAST_MOVE_S),
        stood=stood,
        link=link,
        entered_step=None if entered is None else start + entered,
        line_step=None if over is None else start + over,
    )


def junction_entries(view: TrafficView, row: int) -> Iterator[JunctionEntry]:
    """Yield every junction that vehicle *row* is seen to enter from a lane that leads onto it, in the order of time."""
    lanes, route = view.place(row, 0, view.tracks.steps), view.routes.get(row, ())
    inside = [junction_of(view.road, name) for name in lanes.lane]
    for step, (approach, junction) in enumerate(zip(lanes.lane[:-1], inside[1:], strict=True), start=1):
        if approach is None or junction is None or junction == inside[step - 1]:
            continue
        driven = [name for name in lanes.lane[step:] if name is not None]
        link = _link_onto(view.road, approach, junction, route, driven)
        if link is not None:
            yield JunctionEntry(link, _over_line(view, row, lanes, step), step)


def _noses_in(view: TrafficView, row: int, lanes: Placement, link: Link) -> bool:
    """Return whether the front of *row* is beyond the lane that *link* begins with, and its centre on it, at last."""
    front_m = float(lanes.s_m[-1]) + 0.5 * float(view.tracks.size_m[row, 0])
    return lanes.lane[-1] == link.from_lane and front_m > view.road.lanes[link.from_lane].length_m


def _over_line(view: TrafficView, row: int, lanes: Placement, entered: int) -> int:
    """Return the instant (in *lanes*) since which the front of *row* was beyond its lane before that of *entered*."""
    name, half_m = lanes.lane[entered - 1], 0.5 * float(view.tracks.size_m[row, 0])
    if name is None:
        return entered
    end_m, over = view.road.lanes[name].length_m, entered
    while over > 0 and lanes.lane[over - 1] == name and lanes.s_m[over - 1] + half_m > end_m:
        over -= 1
    return over


def _stood(view: TrafficView, row: int, step: int) -> bool:
    speed = view.tracks.speed_mps[row, max(0, step - view.steps(STOOD_S)) : step + 1]
    return bool((np.abs(speed) <= LEAST_SPEED_MPS).all()) or _rests(view, row, step, STOOD_S)


def _rests(view: TrafficView, row: int, step: int, seconds: float) -> bool:
    """Return whether agent *row* was seen *seconds* ago and has since stayed within ``_LEAST_MOVE_M``."""
    since = step - view.steps(seconds)
    if since < 0:
        return False
    xy = view.tracks.xy_m[row, since : step + 1]
    return bool((np.hypot(*(xy - xy[-1]).T) <= _LEAST_MOVE_M).all())


def junction_of(road: RoadMap, lane_id: str | None) -> str | None:
    """Return the id of the junction that lane *lane_id* is part of; None for a lane between junctions."""
    if lane_id is None or not road.lanes[lane_id].is_internal:
        return None
    return road.edges[road.lanes[lane_id].edge_id].from_junction


def _crossing(
    road: RoadMap, lanes: Placement, junction: str | None, route: tuple[str, ...], recent: int
) -> tuple[Link | None, int | None]:
    """Return the link by which a vehicle crosses *junction* and the instant (in *lanes*) of its entry.

    It is on it, left it within the last *recent* instants, or is about to reach it.
    """
    if junction is None:
        return None, None
    inside = [junction_of(road, x) == junction for x in lanes.lane]
    if True not in inside[-recent - 1 :]:
        return _link_onto(road, lanes.lane[-1], junction, route), None
    upto = len(inside) - inside[::-1].index(True)
    entry = upto - inside[:upto][::-1].index(False) if False in inside[:upto] else None
    approach = lanes.lane[entry - 1] if entry is not None else None
    driven = [x for x in lanes.lane[entry or 0 :] if x is not None]
    link = _link_onto(road, approach, junction, route, driven)
    if link is None:
        options = [x for x in road.links.values() if x.junction_id == junction]
        link = max(options, key=lambda x: _fit(road, x, driven, route), default=None)
    return link, entry


def _link_onto(
    road: RoadMap, lane_id: str | None, junction: str, route: tuple[str, ...], driven: Sequence[str] = ()
) -> Link | None:
    """Return the link by which a vehicle goes onto *junction* from a lane; None where that does not lead there.

    Who is seen on none of the ways that begin on that lane, but on one that begins beside it, takes that one.

    Args:
        road: the map.
        lane_id: the lane.
        junction: its id.
        route: edges of the vehicle's route.
        driven: lanes that it is seen on from there on.
    """
    ahead = links_onto(road, lane_id, junction)
    if lane_id is None or not ahead:
        return None
    link = max(ahead, key=lambda x: _fit(road, x, driven, route))
    if _fit(road, link, driven, route)[0]:
        return link
    lanes = road.edges[road.lanes[lane_id].edge_id].lane_ids
    beside = (x for lane in lanes for x in links_onto(road, lane, junction))
    taken = [x for x in beside if _fit(road, x, driven, route)[0]]
    return max(taken, key=lambda x: _fit(road, x, driven, route), default=link)


def links_onto(road: RoadMap, lane_id: str | None, junction: str) -> tuple[Link, ...]:
    """Return the connections by which a vehicle may go onto *junction* from a lane."""
    if lane_id is None:
        return ()
    return tuple(x for x in road.lanes[lane_id].successors if x.junction_id == junction)


def _fit(road: RoadMap, link: Link, driven: Sequence[str], route: tuple[str, ...]) -> tuple[int, bool]:
    on_route = (road.lanes[link.from_lane].edge_id, road.lanes[link.to_lane].edge_id) in set(pairwise(route))
    return sum(x in link.via or x == link.to_lane for x in driven), on_route
