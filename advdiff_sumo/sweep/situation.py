"""Where and how an episode became critical: what findings are clustered and coverage is counted by."""

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

#: A place so near to a junction's outline belongs to it.
AT_JUNCTION_M = 15.0
#: The approach is looked at so long before contact.
APPROACH_S = 1.0
_FARTHEST_M = 100.0

_ALIKE_RAD, _OPPOSITE_RAD = np.pi / 4.0, 3.0 * np.pi / 4.0
_BESIDE_M = 1.5
_ATTACK_S = 8.0
_MANOEUVRE_S, _TURNS_RAD, _STANDS_MPS = 3.0, np.radians(20.0), 0.5

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
        (float(row[n]) for n in ("collision_time_s", "min_clearance_time_s") if row[n] is not None), 0.0
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
    """Return the last instant up to *time_s* at which the target was there."""
    there = np.flatnonzero(record.tracks.valid[record.target])
    upto = there[record.tracks.times_s[there] <= time_s + 1e-6]
    return int(upto[-1]) if len(upto) else int(there[0]) if len(there) else 0


def _approach(record: EpisodeRecord, row: Mapping[str, Any], critical_s: float) -> dict[str, Any]:
    names = ("approach_ahead_m", "approach_left_m", "approach_yaw_rad")
    pose = _pose(record, row["collision_partner"], critical_s - APPROACH_S)
    return dict(zip(names, pose or (None, None, None), strict=True))


def _pose(record: EpisodeRecord, other: str | None, time_s: float) -> tuple[float, float, float] | None:
    """Return how far *other* was ahead and to the left of the target, and its heading less the target's."""
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
    """Return who was in the contact, or else who came nearest; None where the target left the road or met nobody."""
    nearest = None if row["target_collision"] else row["min_clearance_partner"]
    return row["collision_partner"] or nearest


def _attack(record: EpisodeRecord, other: str | None, critical_s: float) -> str | None:
    """Return what *other* did against the target, "natural" for nothing; None where the background does not tell."""
    if record.manoeuvres is None or other is None:
        return None
    kind, last_s = record.manoeuvres.get(other, (NATURAL, np.inf))
    return kind if last_s >= critical_s - _ATTACK_S else NATURAL


def _approach_word(record: EpisodeRecord, other: str | None, critical_s: float) -> str | None:
    """Return one of ``APPROACHES``; None where nobody was near."""
    pose = _pose(record, other, critical_s - APPROACH_S)
    if pose is None:
        return None
    ahead, left, turned = pose
    if abs(turned) > _OPPOSITE_RAD:
        return "oncoming"
    if abs(turned) > _ALIKE_RAD:
        return "from_left" if turned < 0.0 else "from_right"
    if abs(left) > _BESIDE_M:
        return "beside_left" if left > 0.0 else "beside_right"
    return "ahead" if ahead > 0.0 else "behind"


def _manoeuvre(record: EpisodeRecord, critical_s: float) -> str:
    """Return one of ``MANOEUVRES``."""
    tracks, target = record.tracks, record.target
    last, first = _step(record, critical_s), _step(record, critical_s - _MANOEUVRE_S)
    if tracks.valid[target, first] and tracks.valid[target, last]:
        turned = float(wrap_angle(tracks.yaw_rad[target, last] - tracks.yaw_rad[target, first]))
        if abs(turned) > _TURNS_RAD:
            return "turn_left" if turned > 0.0 else "turn_right"
    speed = float(tracks.speed_mps[target, last])
    return "standing" if np.isfinite(speed) and speed < _STANDS_MPS else "straight"


def _junction_at(road: RoadMap, xy_m: FloatArray) -> Junction | None:
    """Return the junction at *xy_m*, the nearest where several are; None on the open road."""
    if not np.isfinite(xy_m).all():
        return None
    best, least = None, AT_JUNCTION_M
    for junction in road.junctions.values():
        if junction.type in {"dead_end", "internal"} or np.hypot(*(junction.xy_m - xy_m)) > _FARTHEST_M:
            continue
        away = _distance_m(junction, xy_m)
        if away < least:
            best, least = junction, away
    return best


def _distance_m(junction: Junction, xy_m: FloatArray) -> float:
    if len(junction.shape_xy_m) < 3:
        return float(np.hypot(*(junction.xy_m - xy_m)))
    return float(shapely.distance(shapely.Polygon(junction.shape_xy_m), shapely.Point(xy_m)))
