"""The metrics of an episode as rows of tables, with the columns of ``columns``."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from advdiff_sumo.core.frames import local_from_world
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.background_metrics import both_replayed
from advdiff_sumo.metrics.breaches.offences import offences_sentence
from advdiff_sumo.metrics.collision import Collision
from advdiff_sumo.metrics.collision_type import CollisionType
from advdiff_sumo.metrics.columns import COLLISION_COLUMNS, CRITICAL_COLUMNS, EPISODE_COLUMNS, VERDICT_COLUMNS
from advdiff_sumo.metrics.fault import OFF_ROAD
from advdiff_sumo.metrics.offroad import OffRoad
from advdiff_sumo.metrics.summary import Criticality, EpisodeMetrics, Judged, judged_collision, summarise
from advdiff_sumo.metrics.verdict import Verdict, judge

Value: TypeAlias = str | int | float | bool | None


def episode_row(
    record: EpisodeRecord, road: RoadMap, metrics: EpisodeMetrics | None = None
) -> dict[str, Value]:
    """Return the row of ``episodes.parquet``: the keys of ``EPISODE_COLUMNS``, None where undefined.

    Args:
        record: the episode.
        road: its map.
        metrics: the result of :func:`summarise`, if it has been computed already.
    """
    m = metrics if metrics is not None else summarise(record, road)
    tracks, failure = record.tracks, record.failure
    values: dict[str, Value] = {
        "episode": record.episode,
        "scene": record.scene,
        "seed": record.seed,
        "end": str(record.end),
        "duration_s": max(0, tracks.steps - 1) * tracks.dt_s,
        "route": " ".join(record.route) or None,
        "agents": int(tracks.valid.any(axis=1).sum()),
        **_collision_values(record, road, m),
        **critical_values(record, m),
        "offences": ", ".join(dict.fromkeys(x.kind for x in m.offences)),
        "offences_text": offences_sentence(m.offences) or None,
        "initial_overlaps": sum(c.initial for c in m.contacts),
        "sumo_collisions": m.sumo.listed,
        "sumo_only": m.sumo.sumo_only,
        "ours_only": m.sumo.ours_only,
        "sumo_disagreements": m.sumo.sumo_only + m.sumo.ours_only,
        "teleports": record.teleports,
        "rough_handovers": record.rough_handovers,
        "skipped_agents": record.skipped_agents,
        "refused_insertions": record.refused_insertions,
        "implausible_plans": record.implausible[0],
        "implausible_plan": record.implausible[1] or None,
        "safeguarded_plans": record.safeguarded[0],
        "moved_plans": record.safeguarded[1],
        "attack_kind": record.attack,
        "in_position": record.in_position,
        **_criticality_values(record, m.criticality),
        **vars(m.comfort),
        "bv_collisions": len(m.background),
        "replayed_collisions": len(m.replayed),
        "bv_offroad_share": m.background_off_road.mean_share,
        "bv_offroad_max_share": m.background_off_road.max_share,
        "bv_offroad_vehicles": m.background_off_road.vehicles,
        "route_progress_m": m.progress.route_m,
        "route_share": m.progress.route_share,
        "route_completed": m.progress.completed,
        "distance_m": m.progress.distance_m,
        "speed_mean_mps": m.progress.speed_mean_mps,
        "speed_max_mps": m.progress.speed_max_mps,
        "failure_kind": None if failure is None else failure.kind,
        "failure_message": None if failure is None else failure.message,
    }
    return {name: values[name] for name in EPISODE_COLUMNS}


def collision_rows(
    record: EpisodeRecord, road: RoadMap, metrics: EpisodeMetrics | None = None
) -> list[dict[str, Value]]:
    """Return the rows of ``collisions.parquet``: the keys of ``COLLISION_COLUMNS``, in time order.

    Arguments as in :func:`episode_row`. If the target leaves the road, this is a row without a second vehicle.
    """
    m = metrics if metrics is not None else summarise(record, road)
    rows = [_pair_row(record, road, m, c) for c in m.contacts]
    if m.left_road is not None:
        rows.append(_off_road_row(record, road, m.left_road))
    rows.sort(key=lambda row: float(row["time_s"] or 0.0))
    return [{name: row[name] for name in COLLISION_COLUMNS} for row in rows]


def _collision_values(record: EpisodeRecord, road: RoadMap, m: EpisodeMetrics) -> dict[str, Value]:
    """Return the values of an episode's row that describe the target's collision, made from the collision's row."""
    row: dict[str, Value] = {}
    if m.struck is not None:
        row = _struck_values(record, m.struck)
    elif m.left_road is not None:
        row = _off_road_row(record, road, m.left_road)
    no_verdict = {**dict.fromkeys(VERDICT_COLUMNS), "valid_failure": False}
    names = {"time_s": "collision_time_s", "second": "collision_partner", "type": "collision_type"}
    names |= {"first_speed_mps": "target_speed_mps", "second_speed_mps": "partner_speed_mps"}
    same = ("at_fault", "fault_reason", "attacker_visible", "relative_speed_mps", "closing_speed_mps")
    names |= {name: name for name in (*same, "impact_x_m", "impact_y_m", "impact_ahead_m", "impact_left_m")}
    verdict = {name: row.get(name, no_verdict[name]) for name in VERDICT_COLUMNS}
    return {"target_collision": m.target_collision, **{names[k]: row.get(k) for k in names}, **verdict}


def critical_values(record: EpisodeRecord, m: EpisodeMetrics) -> dict[str, Value]:
    """Return the values of ``CRITICAL_COLUMNS``."""
    missed = m.near_miss
    if missed is None or not missed.critical:
        return {**dict.fromkeys(CRITICAL_COLUMNS), "critical": False}
    return {
        "critical": True,
        "critical_brake_mps2": missed.brake_mps2,
        "near_miss_partner": record.tracks.ids[missed.row],
        "near_miss_time_s": missed.time_s,
        "resolved_by": None if missed.resolved_by is None else str(missed.resolved_by),
    }


def verdict_values(verdict: Verdict) -> dict[str, Value]:
    """Return the values of ``VERDICT_COLUMNS``."""
    return {
        "valid_failure": verdict.valid_failure,
        "preventable": verdict.preventable,
        "preventable_by": ", ".join(verdict.preventable_by),
        "lawful": verdict.lawful,
        "target_breaches": ", ".join(x.kind for x in verdict.target_breaches),
        "other_breaches": ", ".join(x.kind for x in verdict.other_breaches),
        "spare_m": _finite(verdict.spare_m),
        "spare_s": _finite(verdict.spare_s),
        "impact_left_mps": verdict.impact_left_mps,
        "solvable": verdict.solvable,
        "unavoidable": verdict.unavoidable,
        "verdict": verdict.sentence,
    }


def _finite(value: float | None) -> float | None:
    return value if value is not None and np.isfinite(value) else None


def _pair_row(record: EpisodeRecord, road: RoadMap, m: EpisodeMetrics, c: Collision) -> dict[str, Value]:
    if m.struck is not None and c is m.struck.collision:
        return _struck_values(record, m.struck)
    if c.rows[0] == record.target and not c.initial:
        return _struck_values(record, judged_collision(record, road, c))
    return _plain_values(record, c)


def _struck_values(record: EpisodeRecord, struck: Judged) -> dict[str, Value]:
    return _plain_values(record, struck.collision) | {
        "type": str(struck.kind),
        "at_fault": str(struck.fault.at_fault),
        "fault_reason": struck.fault.reason,
        "attacker_visible": struck.visible,
        **verdict_values(struck.verdict),
    }


def _plain_values(record: EpisodeRecord, c: Collision) -> dict[str, Value]:
    ahead, left = local_from_world(c.point_m, c.xy_m[0], float(c.yaw_rad[0]))
    speeds = np.hypot(*c.velocity_mps.T)
    return {
        "episode": record.episode,
        "time_s": c.time_s,
        "first": record.tracks.ids[c.rows[0]],
        "second": record.tracks.ids[c.rows[1]],
        "with_target": c.rows[0] == record.target,
        "initial": c.initial,
        "replayed": both_replayed(record, c),
        "type": None,
        "at_fault": None,
        "fault_reason": None,
        "attacker_visible": None,
        **dict.fromkeys(VERDICT_COLUMNS),
        "relative_speed_mps": c.relative_speed_mps,
        "closing_speed_mps": c.closing_speed_mps,
        "first_speed_mps": float(speeds[0]),
        "second_speed_mps": float(speeds[1]),
        "impact_x_m": float(c.point_m[0]),
        "impact_y_m": float(c.point_m[1]),
        "impact_ahead_m": float(ahead),
        "impact_left_m": float(left),
        "first_face": c.faces[0],
        "second_face": c.faces[1],
        "penetration_m": c.penetration_m,
    }


def _off_road_row(record: EpisodeRecord, road: RoadMap, left: OffRoad) -> dict[str, Value]:
    undefined = ("second", "attacker_visible", "relative_speed_mps", "closing_speed_mps", "second_speed_mps")
    nowhere = ("impact_ahead_m", "impact_left_m", "first_face", "second_face", "penetration_m")
    return dict.fromkeys((*undefined, *nowhere)) | {
        "episode": record.episode,
        "time_s": left.time_s,
        "first": record.tracks.ids[record.target],
        "with_target": True,
        "initial": False,
        "replayed": False,
        "type": str(CollisionType.OFF_ROAD),
        "at_fault": str(OFF_ROAD.at_fault),
        "fault_reason": OFF_ROAD.reason,
        **verdict_values(judge(record, road, left)),
        "first_speed_mps": left.speed_mps,
        "impact_x_m": float(left.xy_m[0]),
        "impact_y_m": float(left.xy_m[1]),
    }


def _criticality_values(record: EpisodeRecord, c: Criticality) -> dict[str, Value]:
    ids = record.tracks.ids
    return {
        "min_ttc_s": None if c.ttc is None else c.ttc.value,
        "min_ttc_partner": None if c.ttc is None else ids[c.ttc.row],
        "min_lane_ttc_s": None if c.lane_ttc is None else c.lane_ttc.value,
        "min_pet_s": None if c.pet is None else c.pet.value,
        "max_drac_mps2": c.drac_mps2,
        "min_clearance_m": None if c.clearance is None else c.clearance.value,
        "min_clearance_partner": None if c.clearance is None else ids[c.clearance.row],
        "min_clearance_time_s": None if c.clearance is None else c.clearance.time_s,
    }
