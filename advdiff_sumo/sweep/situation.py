"""Describe where and how an episode became critical, for clustering findings and counting coverage."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import shapely

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import local_from_world, wrap_angle
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Junction
from advdiff_sumo.metrics.archive import APPROACHES, MANOEUVRES, NATURAL
from advdiff_sumo.metrics.columns import Column

#: A position within this distance of a junction's outline belongs to it.
AT_JUNCTION_M = 15.0
#: The approach is that of so long before contact.
APPROACH_S = 1.0
_MAX_CENTRE_M = 100.0  # distance of a junction's centre beyond which its outline is not checked
_SAME_HEADING_RAD, _OPPOSITE_RAD = np.pi / 4.0, 3.0 * np.pi / 4.0  # differences of heading
_BESIDE_M = 1.5  # lateral distance from which a vehicle is beside, not ahead or behind
_ATTACK_S = 8.0  # an earlier attack does not count
_MANOEUVRE_S, _TURN_RAD, _STANDING_MPS = 3.0, np.radians(20.0), 0.5  # of the target

SITUATION_COLUMNS: Mapping[str, Column] = {
    "critical_time_s": Column(
        "float64", "s", "contact, else least clearance, else the start; since the episode's start", False
    ),
    "critical_speed_mps": Column("float64", "m/s", "target's speed then"),
    "junction": Column("str", "", "id of the junction within 15 m then; empty on the open road"),
    "junction_type": Column("str", "", "SUMO's type of that junction, or road", False),
    "approach_ahead_m": Column(
        "float64", "m", "where the partner was 1 s before contact, ahead of the target's centre"
    ),
    "approach_left_m": Column("float64", "m", "the same, to the left"),
    "approach_yaw_rad": Column("float64", "rad", "its heading then, less the target's"),
    "approach": Column(
        "str",
        "",
        f"from where the partner, or else who came nearest, came 1 s before: {', '.join(APPROACHES)}",
    ),
    "attacker_manoeuvre": Column(
        "str",
        "",
        "what that vehicle did against the target in the 8 s before: a kind of attack, guided, or natural",
    ),
    "target_manoeuvre": Column(
        "str", "", f"what the target did in the 3 s before the critical moment: {', '.join(MANOEUVRES)}"
    ),
}


def situation(record: EpisodeRecord, row: Mapping[str, Any], road: RoadMap) -> dict[str, Any]:
    """Return the values of ``SITUATION_COLUMNS`` of one episode.

    Args:
        record: the episode.
        row: its row of ``episodes.parquet``.
        road: its map.
    """
    critical_s = next(
        (float(row[name]) for name in ("collision_time_s", "min_clearance_time_s") if row[name] is not None),
        0.0,
    )
    tracks, target = record.tracks, record.target
    step = _step(record, critical_s)
    xy = tracks.xy_m[target, step]
    junction = _junction_at(road, xy)
    speed = float(tracks.speed_mps[target, step])
    return {
        "critical_time_s": critical_s,
        "critical_speed_mps": speed if np.isfinite(speed) else None,
        "junction": None if junction is None else junction.id,
        "junction_type": "road" if junction is None else junction.type,
        **_approach(record, row, critical_s),
        "approach": _approach_word(record, _other(row), critical_s),
        "attacker_manoeuvre": _attack(record, _other(row), critical_s),
        "target_manoeuvre": _manoeuvre(record, critical_s),
    }


def _step(record: EpisodeRecord, time_s: float) -> int:
    """Return the last instant up to *time_s* at which the target was present."""
    present = np.flatnonzero(record.tracks.valid[record.target])
    before = present[record.tracks.times_s[present] <= time_s + 1e-6]
    return int(before[-1]) if len(before) else int(present[0]) if len(present) else 0


def _approach(record: EpisodeRecord, row: Mapping[str, Any], critical_s: float) -> dict[str, Any]:
    """Return the relative pose of the collision partner before the critical moment, by column."""
    names = ("approach_ahead_m", "approach_left_m", "approach_yaw_rad")
    pose = _pose(record, row["collision_partner"], critical_s - APPROACH_S)
    return dict(zip(names, pose or (None, None, None), strict=True))


def _pose(record: EpisodeRecord, other: str | None, time_s: float) -> tuple[float, float, float] | None:
    """Return distance ahead and to the left of the target, and heading relative to it, of *other*; None if absent."""
    partner = record.tracks.index.get(other) if other else None
    if partner is None:
        return None
    tracks, target = record.tracks, record.target
    step = _step(record, time_s)
    if not tracks.valid[[target, partner], step].all():
        return None
    yaw = float(tracks.yaw_rad[target, step])
    ahead, left = local_from_world(tracks.xy_m[partner, step], tracks.xy_m[target, step], yaw)
    return float(ahead), float(left), float(wrap_angle(tracks.yaw_rad[partner, step] - yaw))


def _other(row: Mapping[str, Any]) -> str | None:
    """Return the collision partner, else the nearest road user; None if the target left the road or met nobody."""
    nearest = None if row["target_collision"] else row["min_clearance_partner"]
    return row["collision_partner"] or nearest


def _attack(record: EpisodeRecord, other: str | None, critical_s: float) -> str | None:
    """Return the attack of *other* on the target, "natural" for none; None if the background does not record it."""
    if record.manoeuvres is None or other is None:
        return None
    kind, last_s = record.manoeuvres.get(other, (NATURAL, np.inf))
    return kind if last_s >= critical_s - _ATTACK_S else NATURAL


def _approach_word(record: EpisodeRecord, other: str | None, critical_s: float) -> str | None:
    """Return one of ``APPROACHES``; None if nobody was near."""
    pose = _pose(record, other, critical_s - APPROACH_S)
    if pose is None:
        return None
    ahead, left, relative_yaw = pose
    if abs(relative_yaw) > _OPPOSITE_RAD:
        return "oncoming"
    if abs(relative_yaw) > _SAME_HEADING_RAD:
        return "from_left" if relative_yaw < 0.0 else "from_right"
    if abs(left) > _BESIDE_M:
        return "beside_left" if left > 0.0 else "beside_right"
    return "ahead" if ahead > 0.0 else "behind"


def _manoeuvre(record: EpisodeRecord, critical_s: float) -> str:
    """Return the target's manoeuvre, one of ``MANOEUVRES``."""
    tracks, target = record.tracks, record.target
    last, first = _step(record, critical_s), _step(record, critical_s - _MANOEUVRE_S)
    if tracks.valid[target, first] and tracks.valid[target, last]:
        turned = float(wrap_angle(tracks.yaw_rad[target, last] - tracks.yaw_rad[target, first]))
        if abs(turned) > _TURN_RAD:
            return "turn_left" if turned > 0.0 else "turn_right"
    speed = float(tracks.speed_mps[target, last])
    return "standing" if np.isfinite(speed) and speed < _STANDING_MPS else "straight"


def _junction_at(road: RoadMap, xy_m: FloatArray) -> Junction | None:
    """Return the nearest junction within reach of *xy_m*; None on the open road."""
    if not np.isfinite(xy_m).all():
        return None
    nearest, least_m = None, AT_JUNCTION_M
    for junction in road.junctions.values():
        if junction.type in {"dead_end", "internal"} or np.hypot(*(junction.xy_m - xy_m)) > _MAX_CENTRE_M:
            continue
        distance_m = _distance_m(junction, xy_m)
        if distance_m < least_m:
            nearest, least_m = junction, distance_m
    return nearest


def _distance_m(junction: Junction, xy_m: FloatArray) -> float:
    """Return the distance of *xy_m* from the outline of *junction*, or from its centre if it has no outline."""
    if len(junction.shape_xy_m) < 3:
        return float(np.hypot(*(junction.xy_m - xy_m)))
    return float(shapely.distance(shapely.Polygon(junction.shape_xy_m), shapely.Point(xy_m)))
