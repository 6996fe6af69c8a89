"""Circumstances of a collision: lanes, links and manoeuvres of both road users in the seconds before it."""

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
from advdiff_sumo.metrics.safe_gap import RESPONSE_S
from advdiff_sumo.metrics.traffic_view import TrafficView

#: Lanes are looked up this far back; long enough to find the approach to a junction.
HISTORY_S = 10.0
#: Events longer ago than this did not lead to the contact.
BREACH_WINDOW_S = 5.0
#: A heading that differs from the lane's by more than this is the wrong way.
WRONG_WAY_RAD = 2.0
#: A vehicle that has stood for this long could be seen.
STOOD_S = 1.0
#: Standing: at most this fast (the limit of nuPlan's metric), or moved by at most ``_LEAST_MOVE_M`` in a given time.
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
        first_lane: its lane at the first instant of these at which it is present; None if no lane is near then.
        wrong_way: whether it is a vehicle that drives against its lane's direction.
        overhang_m: distance by which it reaches out of its lane; inf off any lane.
        changed_lane: whether it changed to another lane of its edge within ``CUT_IN_WINDOW_S``.
        intrudes: whether it reaches into the lane of the other.
        stands: whether it stands still.
        stood: whether it has stood for ``STOOD_S``, so that the other could react.
        link: by which it crosses the junction at which the two meet; None if it does not.
        entered_step: instant at which its centre entered that junction. If only its front has entered and it does not
            stand, the instant before the contact. None if neither is recorded.
        line_step: instant since which its front was over the stop line then; None if ``entered_step`` is.
        present_s: time for which it has been there; inf if since the record's start.
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
    present_s: float

    @property
    def leaves_lane(self) -> bool:
        """Whether it reaches out of its lane by more than ``INTRUSION_M``; False for a pedestrian."""
        return not self.is_pedestrian and self.overhang_m > INTRUSION_M

    @property
    def drove_link(self) -> bool:
        """Whether its centre has been on its link over the junction; else that link is only the likely one."""
        return self.link is not None and not set(self.link.via).isdisjoint(self.lanes.lane)

    @property
    def is_pedestrian(self) -> bool:
        """Whether it is a pedestrian, to whom the rules about lanes do not apply."""
        return self.agent_class == AgentClass.PEDESTRIAN


@dataclass(frozen=True)
class JunctionEntry:
    """One entry of a vehicle into a junction.

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
        merged: id of the junction on which their ways joined, or met beside the centres of both, within
            ``BREACH_WINDOW_S`` before; else None.
        ways_meet: whether the links by which they cross that junction conflict in the net: they cross or join.
        entry: the entry of one into the other's lane within ``BREACH_WINDOW_S``, or None.
        start: first instant of the history.
    """

    collision: Collision
    target: Party
    other: Party
    junction: str | None
    merged: str | None
    ways_meet: bool
    entry: LaneEntry | None
    start: int

    @property
    def parties(self) -> tuple[Party, Party]:
        """Both, in the order of the collision's rows."""
        return self.target, self.other

    def is_run_into(self, index: int) -> bool:
        """Return whether the other ran with its front into the rear of party *index*, 0 or 1."""
        return self.parties[index].face == "rear" and self.parties[1 - index].face == "front"

    @property
    def cut_in(self) -> LaneEntry | None:
        """The entry, if it was within ``CUT_IN_WINDOW_S`` of the contact."""
        recent = self.entry is not None and self.collision.time_s - self.entry.time_s <= CUT_IN_WINDOW_S + 0.1
        return self.entry if recent else None

    @property
    def late_appearance(self) -> str:
        """Which party appeared so late that no driver could have reacted, and when; "" if neither did."""
        late = (party for party in self.parties if party.present_s < RESPONSE_S)
        return next((f"'{x.name}' appeared {x.present_s:.1f} s before" for x in late), "")

    @property
    def crossing(self) -> bool:
        """Whether the two came to a common junction from different approaches.

        Lanes of one edge whose ways over the junction conflict, as where one turns across the other, are different
        approaches once both are on these ways. If an approach is unknown, the headings decide. A pedestrian has no
        approach: False.
        """
        if self.merged is not None:
            return True
        if self.junction is None or any(x.is_pedestrian for x in self.parties):
            return False
        first, second = self.target.link, self.other.link
        if first is None or second is None:
            return self.collision.heading_difference_rad > 0.25 * np.pi
        if first.from_lane.rsplit("_", 1)[0] != second.from_lane.rsplit("_", 1)[0]:
            return True
        return self.ways_meet and all(x.drove_link for x in self.parties)


def encounter_of(view: TrafficView, collision: Collision) -> Encounter:
    """Return the circumstances of *collision*, of any two agents of *view*."""
    step = collision.step
    start = max(0, step - view.steps(HISTORY_S))
    placements = [view.place(row, start, step + 1) for row in collision.rows]
    junctions = (junction_of(view.road, x.lane[-1]) for x in placements)
    junction = next((x for x in junctions if x is not None), None)
    merged = None if junction is not None else _merge_junction(view, collision, placements)
    target, other = (_party(view, collision, i, placements, junction or merged, start) for i in (0, 1))
    first, second = target.link, other.link
    meet = first is not None and second is not None and ways_meet(view.road, first, second)
    entry = _first_lane_entry(view, target, other, start, step)
    return Encounter(collision, target, other, junction, merged, meet, entry, start)


def _first_lane_entry(
    view: TrafficView, target: Party, other: Party, start: int, step: int
) -> LaneEntry | None:
    """Return the earlier of the entries of one into the lane of the other; None without one."""
    entries = [
        lane_entry(view, entering.row, keeping.row, start, step, BREACH_WINDOW_S)
        for entering, keeping in ((other, target), (target, other))
        if not keeping.is_pedestrian
    ]
    return min((x for x in entries if x is not None), key=lambda x: x.step, default=None)


def _merge_junction(view: TrafficView, collision: Collision, placements: list[Placement]) -> str | None:
    """Return the junction that both crossed recently, from different lanes, and on which their ways joined.

    If only the front of one has reached the junction, where the rear of the other still is, ways that cross count, too.
    """
    recent, rows = view.steps(BREACH_WINDOW_S), collision.rows
    backwards = ([junction_of(view.road, x) for x in p.lane[: -recent - 2 : -1]] for p in placements)
    recent_junctions: dict[str, None] = dict.fromkeys(
        x for pair in zip(*backwards, strict=True) for x in pair if x is not None
    )
    for junction in recent_junctions:
        first, second = (_recent_link(view, rows[i], placements[i], junction) for i in (0, 1))
        if first is None or second is None:
            continue
        enters = any(p.lane[-1] == x.from_lane for p, x in zip(placements, (first, second), strict=True))
        if _join(view.road, first, second) or (enters and _cross(view.road, first, second)):
            return junction
    return None


def _cross(road: RoadMap, first: Link, second: Link) -> bool:
    """Return whether two links of a junction come from different edges and conflict in the net."""
    from_first, from_second = (road.lanes[x.from_lane].edge_id for x in (first, second))
    return from_first != from_second and ways_meet(road, first, second)


def _join(road: RoadMap, first: Link, second: Link) -> bool:
    """Return whether two links of a junction come from different lanes and join.

    Links that lead to separate lanes of one edge, as where a ramp adds a lane, do not join.
    """
    to_first, to_second = (road.lanes[x.to_lane].edge_id for x in (first, second))
    joins = first.to_lane == second.to_lane or ways_meet(road, first, second)
    return first.from_lane != second.from_lane and to_first == to_second and joins


def ways_meet(road: RoadMap, first: Link, second: Link) -> bool:
    """Return whether two links over the same junction conflict in the net: their ways cross or join."""
    return first.junction_id == second.junction_id and second.request_index in road.foes_of(first)


def _recent_link(view: TrafficView, row: int, lanes: Placement, junction: str) -> Link | None:
    """Return the link by which *row* crossed *junction* recently, or has begun to with its front; else None."""
    recent = view.steps(BREACH_WINDOW_S)
    link, _ = _crossing(view.road, lanes, junction, view.routes.get(row, ()), recent)
    was_on_it = any(junction_of(view.road, x) == junction for x in lanes.lane[-recent - 1 :])
    return link if was_on_it or (link is not None and _front_entered(view, row, lanes, link)) else None


def _party(
    view: TrafficView,
    collision: Collision,
    index: int,
    placements: list[Placement],
    junction: str | None,
    start: int,
) -> Party:
    row, lanes, step = collision.rows[index], placements[index], collision.step
    walks = view.tracks.classes[row] == AgentClass.PEDESTRIAN
    recent, route = view.steps(BREACH_WINDOW_S), view.routes.get(row, ())
    link, entered = (None, None) if walks else _crossing(view.road, lanes, junction, route, recent)
    stood = _stood(view, row, step)
    if entered is None and link is not None and not stood and _front_entered(view, row, lanes, link):
        entered = len(lanes.lane) - 1
    over_line = None if entered is None else _over_line_since(view, row, lanes, entered)
    speed = float(view.tracks.speed_mps[row, step])
    return Party(
        row=row,
        name=view.tracks.ids[row],
        agent_class=AgentClass(int(view.tracks.classes[row])),
        speed_mps=speed,
        face=collision.faces[index],
        lanes=lanes,
        first_lane=lanes.lane[int(view.tracks.valid[row, start : step + 1].argmax())],
        wrong_way=not walks and bool(abs(lanes.yaw_error_rad[-1]) > WRONG_WAY_RAD),
        overhang_m=lanes.overhang_m(-1),
        changed_lane=bool(lane_changes(view.road, lanes.lane[-view.steps(CUT_IN_WINDOW_S) - 1 :])),
        intrudes=reaches_into(view, row, collision.rows[1 - index], start, step),
        stands=abs(speed) <= LEAST_SPEED_MPS or _hardly_moved(view, row, step, _LEAST_MOVE_S),
        stood=stood,
        link=link,
        entered_step=None if entered is None else start + entered,
        line_step=None if over_line is None else start + over_line,
        present_s=_present_s(view, row, collision),
    )


def _present_s(view: TrafficView, row: int, collision: Collision) -> float:
    """Return the time since agent *row* appeared; inf if it was there at the record's start."""
    absent = np.flatnonzero(~view.tracks.valid[row, : collision.step + 1])
    return float(collision.time_s - view.time_s(int(absent[-1]) + 1)) if len(absent) else np.inf


def junction_entries(view: TrafficView, row: int) -> Iterator[JunctionEntry]:
    """Yield every recorded entry of vehicle *row* into a junction, from a lane that leads onto it, in time order."""
    lanes, route = view.place(row, 0, view.tracks.steps), view.routes.get(row, ())
    inside = [junction_of(view.road, name) for name in lanes.lane]
    for step, (approach, junction) in enumerate(zip(lanes.lane[:-1], inside[1:], strict=True), start=1):
        if approach is None or junction is None or junction == inside[step - 1]:
            continue
        driven = [name for name in lanes.lane[step:] if name is not None]
        link = _link_onto(view.road, approach, junction, route, driven)
        if link is not None:
            yield JunctionEntry(link, _over_line_since(view, row, lanes, step), step)


def _front_entered(view: TrafficView, row: int, lanes: Placement, link: Link) -> bool:
    """Return whether the vehicle, last seen on the lane before *link*, has its front beyond that lane."""
    front_m = float(lanes.s_m[-1]) + 0.5 * float(view.tracks.size_m[row, 0])
    return lanes.lane[-1] == link.from_lane and front_m > view.road.lanes[link.from_lane].length_m


def _over_line_since(view: TrafficView, row: int, lanes: Placement, entered: int) -> int:
    """Return the instant since which the front of *row* was beyond the lane that it left at *entered*.

    Both are instants of *lanes*.
    """
    name, half_m = lanes.lane[entered - 1], 0.5 * float(view.tracks.size_m[row, 0])
    if name is None:
        return entered
    end_m, since = view.road.lanes[name].length_m, entered
    while since > 0 and lanes.lane[since - 1] == name and lanes.s_m[since - 1] + half_m > end_m:
        since -= 1
    return since


def _stood(view: TrafficView, row: int, step: int) -> bool:
    speed = view.tracks.speed_mps[row, max(0, step - view.steps(STOOD_S)) : step + 1]
    return bool((np.abs(speed) <= LEAST_SPEED_MPS).all()) or _hardly_moved(view, row, step, STOOD_S)


def _hardly_moved(view: TrafficView, row: int, step: int, seconds: float) -> bool:
    """Return whether agent *row* moved by at most ``_LEAST_MOVE_M`` in the *seconds* before *step*; False if absent."""
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

    The vehicle is on the junction, left it within the last *recent* instants, or is about to reach it. The instant is
    None in the last case, and if the vehicle was on the junction from the first instant on.
    """
    if junction is None:
        return None, None
    inside = [junction_of(road, x) == junction for x in lanes.lane]
    if True not in inside[-recent - 1 :]:
        return _link_onto(road, lanes.lane[-1], junction, route), None
    left = len(inside) - inside[::-1].index(True)
    entered = left - inside[:left][::-1].index(False) if False in inside[:left] else None
    approach = lanes.lane[entered - 1] if entered is not None else None
    driven = [x for x in lanes.lane[entered or 0 :] if x is not None]
    link = _link_onto(road, approach, junction, route, driven)
    if link is None:
        options = [x for x in road.links.values() if x.junction_id == junction]
        link = max(options, key=lambda x: _fit(road, x, driven, route), default=None)
    return link, entered


def _link_onto(
    road: RoadMap, lane_id: str | None, junction: str, route: tuple[str, ...], driven: Sequence[str] = ()
) -> Link | None:
    """Return the link by which a vehicle enters *junction* from a lane; None if the lane does not lead onto it.

    If the vehicle drives on none of the lane's own links, but on one of a parallel lane, that link is returned.

    Args:
        road: the map.
        lane_id: the lane.
        junction: id of the junction.
        route: edges of the vehicle's route.
        driven: lanes on which it is recorded afterwards.
    """
    options = links_onto(road, lane_id, junction)
    if lane_id is None or not options:
        return None
    link = max(options, key=lambda x: _fit(road, x, driven, route))
    if _fit(road, link, driven, route)[0]:
        return link
    lanes = road.edges[road.lanes[lane_id].edge_id].lane_ids
    parallel = (x for lane in lanes for x in links_onto(road, lane, junction))
    fitting = [x for x in parallel if _fit(road, x, driven, route)[0]]
    return max(fitting, key=lambda x: _fit(road, x, driven, route), default=link)


def links_onto(road: RoadMap, lane_id: str | None, junction: str) -> tuple[Link, ...]:
    """Return the links by which a vehicle may enter *junction* from a lane."""
    if lane_id is None:
        return ()
    return tuple(x for x in road.lanes[lane_id].successors if x.junction_id == junction)


def _fit(road: RoadMap, link: Link, driven: Sequence[str], route: tuple[str, ...]) -> tuple[int, bool, bool]:
    """Return the number of *driven* lanes on *link*, whether it is on the *route*, and whether it goes straight on."""
    on_route = (road.lanes[link.from_lane].edge_id, road.lanes[link.to_lane].edge_id) in set(pairwise(route))
    driven_count = sum(x in link.via or x == link.to_lane for x in driven)
    return driven_count, on_route, link.direction == "s"
