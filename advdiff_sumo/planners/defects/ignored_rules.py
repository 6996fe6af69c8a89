"""Faults of understanding: red lights, the right of way, and cut-ins."""

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
from advdiff_sumo.planners.defects.planted_defect import PlantedDefect, chance, others_mask, with_states


class IgnoredSignals(PlantedDefect):
    """Signals on the target's route: red counts as green for its first ``value`` seconds, yellow always.

    Crossing traffic then seems to have red, as it would if the target's light were green.
    """

    def perceive(self, road: RoadMap, scene: Scene, memory: Any, seed: SeedTree) -> tuple[Scene, Any]:
        """Return the scene with these signals green; a light that is red at first counts from then."""
        del seed
        red_since_s: dict[tuple[str, int], float] = {}
        signals = scene.signals
        for link in own_links(road, scene):
            if link.tls_id is None or link.tls_index is None:
                continue
            letter, key = link.signal(scene.signals), (link.tls_id, link.tls_index)
            if letter in RED:
                red_since_s[key] = (memory or {}).get(key, scene.time_s)
            is_ignored = key in red_since_s and scene.time_s - red_since_s[key] < self.value
            if is_ignored or letter in YELLOW:
                signals = _as_if_green(road, link, signals)
        return replace(scene, signals=signals), red_since_s


class IgnoredPriority(PlantedDefect):
    """A share ``value`` of the vehicles with the right of way at the next junction is not seen before they leave it."""

    def perceive(self, road: RoadMap, scene: Scene, memory: Any, seed: SeedTree) -> tuple[Scene, Any]:
        """Return the scene without these vehicles."""
        foe_requests: set[tuple[str, int]] = set()
        ahead = own_links(road, scene)
        for link in (x for x in ahead if x.junction_id == ahead[0].junction_id):
            foe_requests |= {(link.junction_id, request) for request in road.yields_to(link)}
        if not foe_requests:
            return scene, memory
        history = scene.history
        lanes, *_ = road.locate_many(history.xy_m[:, -1], history.yaw_rad[:, -1])
        foes = [lane is not None and bool(foe_requests & _requests_from(road, lane)) for lane in lanes]
        is_drawn = [chance(seed, "priority", agent_id) < self.value for agent_id in history.ids]
        return scene.without(np.array(foes) & np.array(is_drawn) & others_mask(scene)), memory


@dataclass(frozen=True)
class _Change:
    """The lane of a road user, and its last lane change.

    Attributes:
        lane: its present lane.
        came_from: side of the previous lane: +1 left, −1 right, 0 for no change yet.
        at_s: time of the change.
    """

    lane: str
    came_from: int
    at_s: float


class IgnoredCutIns(PlantedDefect):
    """Others seem to keep their lane; a lane change is noticed only ``value`` seconds after it is complete."""

    def perceive(self, road: RoadMap, scene: Scene, memory: Any, seed: SeedTree) -> tuple[Scene, Any]:
        """Return *scene* with the others in the middle of their present lane, or of their previous one until lately.

        Pedestrians, and road users on a junction or off the lanes, stay where they are; their memory is kept.
        """
        del seed
        history, previous = scene.history, dict[str, _Change](memory or {})
        changes: dict[str, _Change] = {}
        lanes, s, d, _ = road.locate_many(history.xy_m[:, -1], history.yaw_rad[:, -1])
        xy, yaw = history.xy_m.copy(), history.yaw_rad.copy()
        rows = others_mask(scene) & (history.classes != AgentClass.PEDESTRIAN)
        for row, agent_id in enumerate(history.ids):
            lane = lanes[row]
            if lane is None or not rows[row] or _off_lane(road.lanes[lane], float(d[row])):
                rows[row] = False
                changes |= {agent_id: previous[agent_id]} if agent_id in previous else {}
                continue
            change = _after_step(road, previous.get(agent_id), lane, scene.time_s)
            changes[agent_id] = change
            offset_m = 0.0
            if change.came_from and scene.time_s - change.at_s < self.value:
                offset_m = change.came_from * road.lanes[lane].width_m
            centre, heading = road.to_world(lane, float(s[row]), offset_m)
            xy[row] += centre - history.xy_m[row, -1]
            yaw[row, -1] = float(heading)
        return with_states(scene, rows, xy, yaw), changes


def _off_lane(lane: Lane, beside_m: float) -> bool:
    """Return whether a road user *beside_m* from the middle of *lane* is on a junction or beside the lane."""
    return lane.is_internal or abs(beside_m) > lane.width_m


def own_links(road: RoadMap, scene: Scene) -> tuple[Link, ...]:
    """Return the links on the target's route, the nearest first; () without a route."""
    return _links_of(road, scene.routes[scene.target])


@lru_cache(maxsize=256)
def _links_of(road: RoadMap, route: tuple[str, ...]) -> tuple[Link, ...]:
    """Return the links between the edges of *route*."""
    return tuple(
        link
        for before, after in pairwise(route)
        if before in road.edges
        for lane in road.edges[before].lane_ids
        for link in road.lanes[lane].successors
        if road.lanes[link.to_lane].edge_id == after
    )


def _as_if_green(road: RoadMap, link: Link, signals: Mapping[str, str]) -> Mapping[str, str]:
    """Return *signals* with green for *link* and red for all links that conflict with it."""
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
    """Return (junction, request index) of the links that a road user in *lane* takes or may take next."""
    on_junction = road.link_of_internal_lane.get(lane)
    links = (on_junction,) if on_junction is not None else road.lanes[lane].successors
    return {(link.junction_id, link.request_index) for link in links}


def _after_step(road: RoadMap, before: _Change | None, lane: str, time_s: float) -> _Change:
    """Return the record of a road user that is now in *lane*."""
    if before is None:
        return _Change(lane, 0, time_s)
    if lane == before.lane:
        return before
    if road.lanes[lane].left_id == before.lane:
        return _Change(lane, 1, time_s)
    if road.lanes[lane].right_id == before.lane:
        return _Change(lane, -1, time_s)
    return _Change(lane, before.came_from, before.at_s)  # another edge
