"""Where others would be if they went on as they do: present speed, along their lanes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray, quotient
from advdiff_sumo.core.frames import unit, wrap_angle
from advdiff_sumo.core.polylines import Polyline, concatenate
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.maps import Link, RoadMap

#: How far ahead in time a reference driver looks.
PERCEPTION_S = 5.0
#: Spacing of the instants looked at.
LOOK_STEP_S = 0.25
_PLACE_EVERY_S = 0.5
_MAX_YAW_ERROR_RAD, _MAX_OFFSET_M = 0.9, 2.6
_CHAIN_M = 120.0


@dataclass(frozen=True)
class Expected:
    """Futures of N others as seen at each of K instants; H instants ahead, ``LOOK_STEP_S`` apart, now first.

    Attributes:
        xy_m: (K, N, H, 2) centres; NaN where the other is absent.
        yaw_rad: (K, N, H) headings.
        links: N tuples of the connections that each takes.
    """

    xy_m: FloatArray
    yaw_rad: FloatArray
    links: tuple[tuple[Link, ...], ...]


def look_times() -> FloatArray:
    """Return (H,) the instants ahead that are looked at, from 0 to ``PERCEPTION_S``."""
    return np.arange(0.0, PERCEPTION_S + 0.5 * LOOK_STEP_S, LOOK_STEP_S)


def expected(
    road: RoadMap,
    tracks: Tracks,
    rows: IntArray,
    accel_mps2: FloatArray,
    ahead: Sequence[frozenset[str]] | None = None,
) -> Expected:
    """Return what can be expected of agents *rows* (N,) at every instant of *tracks*.

    Speeds are kept; whoever brakes goes on braking to a stop. At junctions everybody takes the connection that
    *tracks* show, as its indicator would say; changes of lanes are not foreseen. Pedestrians, and whoever is
    off the lanes or askew, go straight on.

    Args:
        road: the map.
        tracks: A agents, K instants.
        rows: (N,) whom to look at.
        accel_mps2: (N, K) their accelerations.
        ahead: N sets of lanes that each is known to be on later, where *tracks* do not show it.
    """
    steps, count = tracks.steps, len(rows)
    driven = _driven_m(tracks.speed_mps[rows], accel_mps2)  # (N, K, H)
    xy = np.empty((count, steps, driven.shape[-1], 2))
    yaw = np.empty(driven.shape)
    lanes = _lanes(road, tracks, rows)
    links = []
    for n, row in enumerate(rows.tolist()):
        heading = tracks.yaw_rad[row]
        xy[n] = tracks.xy_m[row, :, None] + driven[n, ..., None] * unit(heading)[:, None]
        yaw[n] = heading[:, None]
        known: dict[tuple[str, str], Link] = {}
        visited = frozenset(x for x in lanes[n] if x is not None)
        known_lanes = visited | (ahead[n] if ahead is not None else frozenset())
        for lane in sorted(visited):
            here = np.array([x == lane for x in lanes[n]]) & tracks.valid[row]
            line, taken = _chain(road, lane, known_lanes)
            known |= {(x.from_lane, x.to_lane): x for x in taken}
            s, d = line.project(tracks.xy_m[row, here], extrapolate=True)
            at, along = line.at(s[:, None] + driven[n, here], d[:, None], extrapolate=True)
            xy[n, here], yaw[n, here] = at, along
        links.append(tuple(known.values()))
    return Expected(np.swapaxes(xy, 0, 1), np.swapaxes(yaw, 0, 1), tuple(links))


def _driven_m(speed_mps: FloatArray, accel_mps2: FloatArray) -> FloatArray:
    """Return (N, K, H) distances at the instants ahead, braking kept up to a stop."""
    times = look_times()
    braking = np.maximum(np.where(accel_mps2 < -0.5, -accel_mps2, 0.0), 0.0)[..., None]
    speed = speed_mps[..., None]
    stop = quotient(np.abs(speed), braking)
    time = np.minimum(times, stop)
    return np.asarray(speed * time - 0.5 * np.sign(speed) * braking * time**2)


def _lanes(road: RoadMap, tracks: Tracks, rows: IntArray) -> list[list[str | None]]:
    """Return N lists of the lanes at the K instants, looked up every half second; None where it goes straight on."""
    every = max(1, round(_PLACE_EVERY_S / tracks.dt_s))
    picked = np.arange(0, tracks.steps, every)
    xy = tracks.xy_m[np.ix_(rows, picked)].reshape(-1, 2)
    yaw = tracks.yaw_rad[np.ix_(rows, picked)].reshape(-1)
    there = np.isfinite(xy).all(-1)
    names: list[str | None] = [None] * len(xy)
    ids, _, d, error = road.locate_many(xy[there], yaw[there])
    for place, name, offset, askew in zip(np.flatnonzero(there), ids, d, wrap_angle(error), strict=True):
        if abs(offset) <= _MAX_OFFSET_M and abs(askew) <= _MAX_YAW_ERROR_RAD:
            names[place] = name
    walks = tracks.classes[rows] == AgentClass.PEDESTRIAN
    table = [names[n * len(picked) : (n + 1) * len(picked)] for n in range(len(rows))]
    return [
        [None if walks[n] else table[n][k // every] for k in range(tracks.steps)] for n in range(len(rows))
    ]


def _chain(road: RoadMap, lane_id: str, visited: frozenset[str]) -> tuple[Polyline, list[Link]]:
    """Return the centre line from *lane_id* on, over connections to *visited* lanes or else the straightest."""
    names, links = [lane_id], list[Link]()
    length = 0.0
    while length < _CHAIN_M and len(names) < 12:
        options = road.lanes[names[-1]].successors
        if not options:
            break
        link = min(options, key=lambda x: _strangeness(x, visited))
        onward = [x for x in (*link.via, link.to_lane) if x not in names]
        if not onward:
            break
        names += onward
        links.append(link)
        length += sum(road.lanes[x].length_m for x in onward)
    return concatenate([road.lanes[name].line for name in names]), links


def _strangeness(link: Link, visited: frozenset[str]) -> tuple[bool, bool, str]:
    return not any(x in visited for x in (*link.via, link.to_lane)), link.direction != "s", link.to_lane
