"""The columns of ``episodes.parquet`` and ``collisions.parquet``: types, units, meanings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Column:
    """One column of a table.

    Attributes:
        dtype: "str", "int64", "float64" or "bool".
        unit: unit, "" for none.
        description: what it holds.
        nullable: whether it may be empty.
    """

    dtype: str
    unit: str
    description: str
    nullable: bool = True


def _text(description: str, *, nullable: bool = True) -> Column:
    return Column("str", "", description, nullable)


def _real(unit: str, description: str, *, nullable: bool = True) -> Column:
    return Column("float64", unit, description, nullable)


def _count(description: str) -> Column:
    return Column("int64", "", description, nullable=False)


def _later_count(description: str) -> Column:
    """Return a column for a count that folders of earlier versions lack."""
    return Column("int64", "", description, nullable=True)


def _flag(description: str, *, nullable: bool = False) -> Column:
    return Column("bool", "", description, nullable)


VERDICT_COLUMNS: Mapping[str, Column] = {
    "valid_failure": _flag(
        "the collision counts; false without one, empty without a verdict",
        nullable=True,
    ),
    "preventable": _flag("CC_human_driver would not have collided", nullable=True),
    "preventable_by": _text("the reference drivers that would not have collided"),
    "lawful": _flag("the other broke no rule that led to it", nullable=True),
    "target_breaches": _text("broken rules that led to the collision"),
    "other_breaches": _text("broken rules that led to the collision"),
    "spare_m": _real(
        "m", "by how much CC_human_driver avoids the collision, in m and s (5 at most), or its closing speed"
    ),
    "spare_s": _real(
        "s", "by how much CC_human_driver avoids the collision, in m and s (5 at most), or its closing speed"
    ),
    "impact_left_mps": _real(
        "m/s",
        "by how much CC_human_driver avoids the collision, in m and s (5 at most), or its closing speed",
    ),
    "solvable": _flag("the search avoids it; empty unless verdict --search asked", nullable=True),
    "unavoidable": _flag(
        "neither reference driver nor search avoids it; empty if only the search could tell",
        nullable=True,
    ),
    "verdict": _text("the verdict as a sentence"),
}
"""The verdict on a collision of the target, or on an episode by its first collision (``docs/verdict.md``)."""

CRITICAL_COLUMNS: Mapping[str, Column] = {
    "critical": _flag(
        "near miss in which a reference driver needs over 4 m/s²; empty without a verdict",
        nullable=True,
    ),
    "critical_brake_mps2": _real("m/s²", "that braking, at most 9"),
    "near_miss_partner": _text("who, and when the time to collision was least"),
    "near_miss_time_s": _real("s", "who, and when the time to collision was least"),
    "resolved_by": _text("who avoided the collision: target, other, both; empty if the record ends before"),
}

OFFENCE_COLUMNS: Mapping[str, Column] = {
    "offences": _text(
        "rules that the target broke, collision or not; empty: unknown, as in earlier versions"
    ),
    "offences_text": _text("the same as a sentence, with times"),
}

EPISODE_COLUMNS: Mapping[str, Column] = {
    "episode": _count("number of the episode in its run"),
    "scene": _text("name of the seed scene", nullable=False),
    "seed": _count("SUMO's seed of that scene's simulation"),
    "end": _text("why the episode ended: horizon, collision, arrived, log_end, failed", nullable=False),
    "duration_s": _real("s", "simulated time", nullable=False),
    "route": _text("edges of the target's route, separated by blanks"),
    "agents": _count("road users in the record, with the target"),
    "target_collision": _flag("the target collided or left the road"),
    "collision_time_s": _real("s", "first contact"),
    "collision_partner": _text("id of the other; empty when the target left the road"),
    "collision_type": _text("kind (metrics.md): junction, head_on, cut_in, rear_end_striking, …"),
    "at_fault": _text("who caused it: target, other or unclear; by which rule"),
    "fault_reason": _text("who caused it: target, other or unclear; by which rule"),
    **VERDICT_COLUMNS,
    **CRITICAL_COLUMNS,
    **OFFENCE_COLUMNS,
    "attacker_visible": _flag("a SUMO-driven target perceived the partner (sumo.md)", nullable=True),
    "relative_speed_mps": _real("m/s", "difference of the velocities; its part along the contact normal"),
    "closing_speed_mps": _real("m/s", "difference of the velocities; its part along the contact normal"),
    "target_speed_mps": _real("m/s", "speeds at contact"),
    "partner_speed_mps": _real("m/s", "speeds at contact"),
    "impact_x_m": _real("m", "impact point in the net"),
    "impact_y_m": _real("m", "impact point in the net"),
    "impact_ahead_m": _real("m", "impact point from the target's centre"),
    "impact_left_m": _real("m", "impact point from the target's centre"),
    "initial_overlaps": _count("pairs that overlapped at once; no collisions"),
    "sumo_collisions": _count(
        "pairs at an instant: SUMO's list, those without an overlap, missing ones, sum of both"
    ),
    "sumo_only": _count(
        "pairs at an instant: SUMO's list, those without an overlap, missing ones, sum of both"
    ),
    "ours_only": _count(
        "pairs at an instant: SUMO's list, those without an overlap, missing ones, sum of both"
    ),
    "sumo_disagreements": _count(
        "pairs at an instant: SUMO's list, those without an overlap, missing ones, sum of both"
    ),
    "teleports": _count("vehicles that SUMO teleported"),
    "rough_handovers": _count("vehicles handed back to SUMO askew (sumo.md)"),
    "skipped_agents": _count("road users left to SUMO as their log goes on out of reach"),
    "refused_insertions": _later_count("moved vehicles that SUMO refused to insert"),
    "implausible_plans": _later_count("the target's plans that no vehicle can drive; the first fault"),
    "implausible_plan": _text("the target's plans that no vehicle can drive; the first fault"),
    "safeguarded_plans": _later_count(
        "background plans that the safeguard changed by over 0.1 m in the next 0.5 s; all"
    ),
    "moved_plans": _later_count(
        "background plans that the safeguard changed by over 0.1 m in the next 0.5 s; all"
    ),
    "attack_kind": _text("attack asked for; a vehicle was once in a position for it"),
    "in_position": _flag("attack asked for; a vehicle was once in a position for it", nullable=True),
    "min_ttc_s": _real("s", "least TTC of boxes, up to 10 s; with whom"),
    "min_ttc_partner": _text("least TTC of boxes, up to 10 s; with whom"),
    "min_lane_ttc_s": _real("s", "least TTC with the vehicle ahead in the lane"),
    "min_pet_s": _real("s", "least PET, up to 10 s"),
    "max_drac_mps2": _real("m/s²", "greatest DRAC"),
    "min_clearance_m": _real("m", "least distance of boxes, 0 in a collision; with whom, when"),
    "min_clearance_partner": _text("least distance of boxes, 0 in a collision; with whom, when"),
    "min_clearance_time_s": _real("s", "least distance of boxes, 0 in a collision; with whom, when"),
    "accel_mean_mps2": _real(
        "m/s²", "of the target, absolute values; acceleration and jerk along the heading"
    ),
    "accel_max_mps2": _real(
        "m/s²", "of the target, absolute values; acceleration and jerk along the heading"
    ),
    "brake_max_mps2": _real(
        "m/s²", "of the target, absolute values; acceleration and jerk along the heading"
    ),
    "lateral_mean_mps2": _real(
        "m/s²", "of the target, absolute values; acceleration and jerk along the heading"
    ),
    "lateral_max_mps2": _real(
        "m/s²", "of the target, absolute values; acceleration and jerk along the heading"
    ),
    "jerk_mean_mps3": _real(
        "m/s³", "of the target, absolute values; acceleration and jerk along the heading"
    ),
    "jerk_max_mps3": _real("m/s³", "of the target, absolute values; acceleration and jerk along the heading"),
    "yaw_rate_mean_radps": _real(
        "rad/s", "of the target, absolute values; acceleration and jerk along the heading"
    ),
    "yaw_rate_max_radps": _real(
        "rad/s", "of the target, absolute values; acceleration and jerk along the heading"
    ),
    "bv_collisions": _count("background collisions; of two that follow their log"),
    "replayed_collisions": _later_count("background collisions; of two that follow their log"),
    "bv_offroad_share": _real("", "share of a moved box off the road; vehicles once over half off"),
    "bv_offroad_max_share": _real("", "share of a moved box off the road; vehicles once over half off"),
    "bv_offroad_vehicles": _count("share of a moved box off the road; vehicles once over half off"),
    "route_progress_m": _real("m", "how far the target came along its route; as a share; to the end"),
    "route_share": _real("", "how far the target came along its route; as a share; to the end"),
    "route_completed": _flag("how far the target came along its route; as a share; to the end"),
    "distance_m": _real("m", "the target's driven path and speed", nullable=False),
    "speed_mean_mps": _real("m/s", "the target's driven path and speed"),
    "speed_max_mps": _real("m/s", "the target's driven path and speed"),
    "failure_kind": _text("why the episode failed: a word, a sentence"),
    "failure_message": _text("why the episode failed: a word, a sentence"),
}

COLLISION_COLUMNS: Mapping[str, Column] = {
    "episode": _count("number of the episode in its run"),
    "time_s": _real("s", "first contact", nullable=False),
    "first": _text("id of one; the target where it takes part", nullable=False),
    "second": _text("id of the other; empty when the target left the road"),
    "with_target": _flag("the target takes part"),
    "initial": _flag("the boxes overlapped when first there together"),
    "replayed": _flag("both follow their log", nullable=True),
    "type": _text("as collision_type; empty without the target or when initial"),
    "at_fault": _text("as in the episodes; empty where type is"),
    "fault_reason": _text("who caused it: target, other or unclear; by which rule"),
    **VERDICT_COLUMNS,
    "attacker_visible": _flag("a SUMO-driven target perceived the partner (sumo.md)", nullable=True),
    "relative_speed_mps": _real("m/s", "difference of the velocities; its part along the contact normal"),
    "closing_speed_mps": _real("m/s", "difference of the velocities; its part along the contact normal"),
    "first_speed_mps": _real("m/s", "speeds at contact", nullable=False),
    "second_speed_mps": _real("m/s", "speeds at contact"),
    "impact_x_m": _real("m", "impact point in the net", nullable=False),
    "impact_y_m": _real("m", "impact point in the net", nullable=False),
    "impact_ahead_m": _real("m", "impact point from the first's centre"),
    "impact_left_m": _real("m", "impact point from the first's centre"),
    "first_face": _text("side of each box at contact: front, rear, left or right"),
    "second_face": _text("side of each box at contact: front, rear, left or right"),
    "penetration_m": _real("m", "deepest overlap within the step of the contact"),
}

_LATER_COUNTS = (
    "refused_insertions",
    "implausible_plans",
    "safeguarded_plans",
    "moved_plans",
    "replayed_collisions",
    "replayed",
)
LATER_COLUMNS = frozenset(
    (
        "route",
        "attack_kind",
        "in_position",
        "implausible_plan",
        *_LATER_COUNTS,
        *VERDICT_COLUMNS,
        *CRITICAL_COLUMNS,
        *OFFENCE_COLUMNS,
    )
)
"""Columns that folders of earlier versions lack; ``advdiff-sumo verdict`` adds those of the verdict."""
