"""Predict other road users: each keeps its speed or braking and follows its lane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray, quotient
from advdiff_sumo.core.frames import unit, wrap_angle
from advdiff_sumo.core.polylines import Polyline, concatenate
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.maps import Link, RoadMap

#: Look-ahead time of a reference driver.
PERCEPTION_S = 5.0
#: Spacing of the look-ahead instants.
LOOK_STEP_S = 0.25
#: Lanes are looked up at this interval.
_LANE_EVERY_S = 0.5
# A road user farther off its lane than this, in heading or laterally, goes straight on.
_MAX_YAW_ERROR_RAD, _MAX_OFFSET_M = 0.9, 2.6
#: The line along lanes is at least this long beyond the first lane, where the net allows it.
_AHEAD_M = 120.0


@dataclass(frozen=True)
class Prediction:
    """Predicted motion of N others from each of K instants, at H look-ahead instants.

    The look-ahead instants are ``LOOK_STEP_S`` apart; the first one is the present.

    Attributes:
        xy_m: (K, N, H, 2) centres; NaN where the other is absent.
        yaw_rad: (K, N, H) headings.
        links: N tuples of the connections that each takes.
    """

    xy_m: FloatArray
    yaw_rad: FloatArray
    links: tuple[tuple[Link, ...], ...]


def look_times() -> FloatArray:
    """Return (H,) the times of the look-ahead instants, from 0 to ``PERCEPTION_S``."""
    return np.arange(0.0, PERCEPTION_S + 0.5 * LOOK_STEP_S, LOOK_STEP_S)


def predicted_motion(
    road: RoadMap,
    tracks: Tracks,
    rows: IntArray,
    accel_mps2: FloatArray,
    ahead: Sequence[frozenset[str]] | None = None,
) -> Prediction:
    """Return the predicted motion of agents *rows* (N,) from every instant of *tracks*.

    Agents keep their speed; one that brakes continues to brake to a stop. At a junction each takes the connection that
    *tracks* show, as its indicator would tell. Lane changes are not predicted. Pedestrians, and vehicles that are off
    the lanes or at an angle to them, go straight on.

    Args:
        road: the map.
        tracks: A agents, K instants.
        rows: (N,) rows of the agents to predict.
        accel_mps2: (N, K) their accelerations.
        ahead: N sets of lanes that each is known to be on later, where *tracks* do not show it.
    """
    steps, count = tracks.steps, len(rows)
    driven_m = _driven_m(tracks.speed_mps[rows], accel_mps2)  # (N, K, H)
    xy = np.empty((count, steps, driven_m.shape[-1], 2))
    yaw = np.empty(driven_m.shape)
    lanes = _lanes(road, tracks, rows)
    links = []
    for n, row in enumerate(rows.tolist()):
        heading = tracks.yaw_rad[row]
        xy[n] = tracks.xy_m[row, :, None] + driven_m[n, ..., None] * unit(heading)[:, None]
        yaw[n] = heading[:, None]
        own_links: dict[tuple[str, str], Link] = {}
        visited = frozenset(x for x in lanes[n] if x is not None)
        known_lanes = visited | (ahead[n] if ahead is not None else frozenset())
        for lane in sorted(visited):
            on_lane = np.array([x == lane for x in lanes[n]]) & tracks.valid[row]
            line, lane_links = _line_ahead(road, lane, known_lanes)
            own_links |= {(x.from_lane, x.to_lane): x for x in lane_links}
            s, d = line.project(tracks.xy_m[row, on_lane], extrapolate=True)
            xy[n, on_lane], yaw[n, on_lane] = line.at(
                s[:, None] + driven_m[n, on_lane], d[:, None], extrapolate=True
            )
        links.append(tuple(own_links.values()))
    return Prediction(np.swapaxes(xy, 0, 1), np.swapaxes(yaw, 0, 1), tuple(links))


def _driven_m(speed_mps: FloatArray, accel_mps2: FloatArray) -> FloatArray:
    """Return (N, K, H) distances driven until the look-ahead instants, if braking continues to a stop."""
    times = look_times()
    braking = np.maximum(np.where(accel_mps2 < -0.5, -accel_mps2, 0.0), 0.0)[..., None]
    speed = speed_mps[..., None]
    stop_s = quotient(np.abs(speed), braking)
    time = np.minimum(times, stop_s)
    return np.asarray(speed * time - 0.5 * np.sign(speed) * braking * time**2)


def _lanes(road: RoadMap, tracks: Tracks, rows: IntArray) -> list[list[str | None]]:
    """Return N lists of the lanes at the K instants; None for pedestrians and for vehicles too far off a lane."""
    every = max(1, round(_LANE_EVERY_S / tracks.dt_s))
    sampled = np.arange(0, tracks.steps, every)
    xy = tracks.xy_m[np.ix_(rows, sampled)].reshape(-1, 2)
    yaw = tracks.yaw_rad[np.ix_(rows, sampled)].reshape(-1)
    present = np.isfinite(xy).all(-1)
    names: list[str | None] = [None] * len(xy)
    ids, _, d, yaw_error = road.locate_many(xy[present], yaw[present])
    for i, name, offset, error in zip(np.flatnonzero(present), ids, d, wrap_angle(yaw_error), strict=True):
        if abs(offset) <= _MAX_OFFSET_M and abs(error) <= _MAX_YAW_ERROR_RAD:
            names[i] = name
    walks = tracks.classes[rows] == AgentClass.PEDESTRIAN
    table = [names[n * len(sampled) : (n + 1) * len(sampled)] for n in range(len(rows))]
    return [
        [None if walks[n] else table[n][k // every] for k in range(tracks.steps)] for n in range(len(rows))
    ]


def _line_ahead(road: RoadMap, lane_id: str, known_lanes: frozenset[str]) -> tuple[Polyline, list[Link]]:
    """Return the centre line from *lane_id* on and its connections: those to *known_lanes*, else the straightest."""
    names, links = [lane_id], list[Link]()
    length = 0.0
    while length < _AHEAD_M and len(names) < 12:
        options = road.lanes[names[-1]].successors
        if not options:
            break
        link = min(options, key=lambda x: _unlikeliness(x, known_lanes))
        onward = [x for x in (*link.via, link.to_lane) if x not in names]
        if not onward:
            break
        names += onward
        links.append(link)
        length += sum(road.lanes[x].length_m for x in onward)
    return concatenate([road.lanes[name].line for name in names]), links


def _unlikeliness(link: Link, known_lanes: frozenset[str]) -> tuple[bool, bool, str]:
    return not any(x in known_lanes for x in (*link.via, link.to_lane)), link.direction != "s", link.to_lane
