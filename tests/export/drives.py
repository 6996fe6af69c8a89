"""Tracks made by hand, and traffic on any net."""

from __future__ import annotations

from collections import defaultdict
from itertools import cycle

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import Polyline
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.export import ExportScene
from advdiff_sumo.export.net_opendrive import SAME_M
from advdiff_sumo.maps import Lane, Link, RoadMap
from advdiff_sumo.maps.convert.sources.arcline import drop_repeats

STEPS, DT_S = 21, 0.1


def tracks_of(*agents: tuple[str, AgentClass, tuple[float, float], FloatArray], dt_s: float = DT_S) -> Tracks:
    """Return tracks of (name, class, size, rows (T, 4) of x, y, yaw, speed; NaN where absent)."""
    rows = np.stack([agent[3] for agent in agents])
    return Tracks(
        ids=tuple(agent[0] for agent in agents),
        classes=np.array([int(agent[1]) for agent in agents]),
        size_m=np.array([agent[2] for agent in agents]),
        xy_m=rows[..., :2].copy(),
        yaw_rad=rows[..., 2].copy(),
        speed_mps=rows[..., 3].copy(),
        valid=np.isfinite(rows[..., 0]),
        t0_s=0.0,
        dt_s=dt_s,
    )


def straight(
    x: float, y: float, yaw: float, speed: float, there: slice = slice(None), steps: int = STEPS
) -> FloatArray:
    """Return rows of somebody who keeps heading and speed and is there at the instants *there*."""
    time = DT_S * np.arange(steps)
    rows = np.column_stack(
        (
            x + speed * time * np.cos(yaw),
            y + speed * time * np.sin(yaw),
            np.full(steps, yaw),
            np.full(steps, speed),
        )
    )
    absent = np.ones(steps, dtype=np.bool_)
    absent[there] = False
    rows[absent] = np.nan
    return rows


#: The pair of ``junction_traffic``: where the target begins, before its lane's end; gap of centres; speeds.
BEFORE_M, AHEAD_M, TARGET_MPS, LEADER_MPS = 45.0, 25.0, 12.0, 4.0
OTHERS, OTHERS_MPS, STRAIGHT_RAD = 10, 8.0, np.deg2rad(0.1)
_CAR = (4.6, 1.8)
_OTHERS = (
    (AgentClass.CAR, _CAR, np.arange(STEPS)),
    (AgentClass.TRUCK, (9.5, 2.5), np.arange(4, STEPS)),
    (AgentClass.BUS, (12.0, 2.55), np.arange(0, 15)),
    (AgentClass.MOTORCYCLE, (2.2, 0.8), np.r_[0:8, 13:STEPS]),
    (AgentClass.BICYCLE, (1.8, 0.6), np.arange(STEPS)),
)


def junction_traffic(road: RoadMap) -> ExportScene:
    """Return a leader and the target behind it on a straight lane, others at the junction ahead, and a walker.

    The junction is the one with the most ways that such a lane leads to. The others take ways from its other lanes,
    as vehicles of every class, some late, some early gone, some away for a while.
    """
    lane = max((x for x in road.lanes.values() if _is_straight(x)), key=lambda x: (len(_ways(road, x)), x.id))
    start = lane.length_m - BEFORE_M
    agents = [
        ("leader", AgentClass.CAR, _CAR, along(lane.line, start + AHEAD_M, LEADER_MPS)),
        ("target", AgentClass.CAR, _CAR, along(lane.line, start, TARGET_MPS)),
    ]
    turns: dict[str, list[Link]] = defaultdict(list)
    for link in _ways(road, lane):
        turns[link.from_lane].append(link)
    for number, links in zip(range(OTHERS), cycle(turns.values()), strict=False):
        back, turn = divmod(number, len(turns))
        kind, size, there = _OTHERS[number % len(_OTHERS)]
        link = links[turn % len(links)]
        lanes = [road.lanes[name] for name in (link.from_lane, *link.via, link.to_lane)]
        begin = lanes[0].length_m - 6.0 - 25.0 * back
        if begin < 0.0 < back:
            continue  # no room for another
        line = Polyline.of(drop_repeats(np.vstack([x.centre_xy_m for x in lanes]), SAME_M))
        rows = np.full((STEPS, 4), np.nan)
        rows[there] = along(line, max(0.0, begin), OTHERS_MPS)[there]
        agents.append((f"{kind.name.lower()} {number}", kind, size, rows))
    (x, y), yaw = lane.line.at(start + AHEAD_M, 5.0)
    agents.append(("on foot", AgentClass.PEDESTRIAN, (0.5, 0.5), straight(x, y, float(yaw), 1.3)))
    return ExportScene(f"{road.name}-0001", tracks_of(*agents), 1, road)


def along(line: Polyline, start_m: float, speed_mps: float) -> FloatArray:
    """Return rows of somebody who drives along *line*."""
    xy, yaw = line.at(start_m + speed_mps * DT_S * np.arange(STEPS))
    return np.column_stack((xy, yaw, np.full(STEPS, speed_mps)))


def _is_straight(lane: Lane) -> bool:
    """Return whether cars may drive on *lane* and its end is straight for as long as the pair needs."""
    if lane.is_internal or "passenger" not in lane.allows or lane.length_m < BEFORE_M + 5.0:
        return False
    _, yaw = lane.line.at(lane.length_m - np.arange(0.0, BEFORE_M + 5.0))
    return bool(np.abs(np.unwrap(yaw) - yaw[0]).max() < STRAIGHT_RAD)


def _ways(road: RoadMap, lane: Lane) -> list[Link]:
    """Return the ways of cars over the junction at the end of *lane*, from other lanes."""
    here = {link.junction_id for link in lane.successors}
    return [
        link
        for link in road.links.values()
        if link.junction_id in here
        and link.from_lane != lane.id
        and not link.from_lane.startswith(":")
        and "passenger" in road.lanes[link.from_lane].allows & road.lanes[link.to_lane].allows
        and link.direction != "t"
    ]
