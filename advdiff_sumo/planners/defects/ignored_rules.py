"""Faults of understanding: red lights, the right of way, and who is changing into the target's lane."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from advdiff_sumo.core.scene import AgentClass, Scene
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.core.signal_letters import PLAIN_RED, PROTECTED_GREEN, RED, YELLOW
from advdiff_sumo.maps import Lane, Link, RoadMap
from advdiff_sumo.planners.defects.planted_fault import PlantedFault, chance, others_of, with_states


class IgnoredSignals(PlantedFault):
    """On the target's own way red is taken for green for its first ``value`` seconds, yellow always.

    Those who cross it have red then, as they would have if its own light were green.
    """

    def perceive(self, road: RoadMap, scene: Scene, memory: Any, seed: SeedTree) -> tuple[Scene, Any]:
        """Return the scene with the target's own signals green; a red that is there at first begins then."""
        del seed
        since: dict[tuple[str, int], float] = {}
        shown = scene.signals
        for link in own_links(road, scene):
            if link.tls_id is None or link.tls_index is None:
                continue
            letter, key = link.signal(scene.signals), (link.tls_id, link.tls_index)
            if letter in RED:
                since[key] = (memory or {}).get(key, scene.time_s)
            early = key in since and scene.time_s - since[key] < self.value
            if early or letter in YELLOW:
                shown = _as_if_green(road, link, shown)
        return replace(scene, signals=shown), since


class IgnoredPriority(PlantedFault):
    """A share ``value`` of those who have the right of way at the next junction is not seen until they are past it."""

    def perceive(self, road: RoadMap, scene: Scene, memory: Any, seed: SeedTree) -> tuple[Scene, Any]:
        """Return the scene without them."""
        before: set[tuple[str, int]] = set()
        ahead = own_links(road, scene)
        for link in (x for x in ahead if x.junction_id == ahead[0].junction_id):
            before |= {(link.junction_id, request) for request in road.yields_to(link)}
        if not before:
            return scene, memory
        history = scene.history
        lanes, *_ = road.locate_many(history.xy_m[:, -1], history.yaw_rad[:, -1])
        foes = [lane is not None and bool(before & _requests_from(road, lane)) for lane in lanes]
        drawn = [chance(seed, "priority", name) < self.value for name in history.ids]
        return scene.without(np.array(foes) & np.array(drawn) & others_of(scene)), memory


@dataclass(frozen=True)
class _Change:
    """The lane that somebody is in, and its last change of lanes.

    Attributes:
        lane: the lane now.
        came_from: +1 from the left, −1 from the right, 0 no change yet.
        at_s: when.
    """

    lane: str
    came_from: int
    at_s: float


class IgnoredCutIns(PlantedFault):
    """Others seem to keep their lane; that one has changed into another one is noticed ``value`` seconds late."""

    def perceive(self, road: RoadMap, scene: Scene, memory: Any, seed: SeedTree) -> tuple[Scene, Any]:
        """Return others in the middle of the lane that they are in, or were in until lately.

        People on foot, and who is on a junction or off the lanes, are where they are; what is known of them stays.
        """
        del seed
        history, known = scene.history, dict[str, _Change](memory or {})
        now: dict[str, _Change] = {}
        lanes, s, d, _ = road.locate_many(history.xy_m[:, -1], history.yaw_rad[:, -1])
        xy, yaw = history.xy_m.copy(), history.yaw_rad.copy()
        rows = others_of(scene) & (history.classes != AgentClass.PEDESTRIAN)
        for row, name in enumerate(history.ids):
            lane = lanes[row]
            if lane is None or not rows[row] or _keeps_place(road.lanes[lane], float(d[row])):
                rows[row] = False
                now |= {name: known[name]} if name in known else {}
                continue
            change = _changed(road, known.get(name), lane, scene.time_s)
            now[name] = change
            aside = 0.0
            if change.came_from and scene.time_s - change.at_s < self.value:
                aside = change.came_from * road.lanes[lane].width_m
            place, heading = road.to_world(lane, float(s[row]), aside)
            xy[row] += place - history.xy_m[row, -1]
            yaw[row, -1] = float(heading)
        return with_states(scene, rows, xy, yaw), now


def _keeps_place(lane: Lane, beside_m: float) -> bool:
    """Return whether somebody *beside_m* from the middle of *lane* is on a junction or beside the lane."""
    return lane.is_internal or abs(beside_m) > lane.width_m


def own_links(road: RoadMap, scene: Scene) -> tuple[Link, ...]:
    """Return the links on the target's route, the nearest first; none without a route."""
    return _links_of(road, scene.routes[scene.target])


@lru_cache(maxsize=256)
def _links_of(road: RoadMap, route: tuple[str, ...]) -> tuple[Link, ...]:
    return tuple(
        link
        for before, after in pairwise(route)
        if before in road.edges
        for lane in road.edges[before].lane_ids
        for link in road.lanes[lane].successors
        if road.lanes[link.to_lane].edge_id == after
    )


def _as_if_green(road: RoadMap, link: Link, signals: Mapping[str, str]) -> Mapping[str, str]:
    """Return *signals* with green for *link* and red for whom it crosses or meets."""
    foes = road.foes_of(link)
    letters = list(signals[link.tls_id or ""])
    for other in road.links.values():
        if other.tls_id == link.tls_id and other.tls_index is not None and other.tls_index < len(letters):
            if (other.from_lane, other.to_lane) == (link.from_lane, link.to_lane):
                letters[other.tls_index] = PROTECTED_GREEN
            elif other.junction_id == link.junction_id and other.request_index in foes:
                letters[other.tls_index] = PLAIN_RED
    return {**signals, link.tls_id or "": "".join(letters)}


def _requests_from(road: RoadMap, lane: str) -> set[tuple[str, int]]:
    """Return the rows of right-of-way matrices that somebody in *lane* takes or may take next."""
    on_junction = road.link_over.get(lane)
    links = (on_junction,) if on_junction is not None else road.lanes[lane].successors
    return {(link.junction_id, link.request_index) for link in links}


def _changed(road: RoadMap, before: _Change | None, lane: str, time_s: float) -> _Change:
    if before is None:
        return _Change(lane, 0, time_s)
    if lane == before.lane:
        return before
    if road.lanes[lane].left_id == before.lane:
        return _Change(lane, 1, time_s)
    if road.lanes[lane].right_id == before.lane:
        return _Change(lane, -1, time_s)
    return _Change(lane, before.came_from, before.at_s)  # another edge
