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
        "the collision counts (verdict.md); false without a collision, empty without a verdict",
        nullable=True,
    ),
    "preventable": _flag("CC_human_driver would not have collided", nullable=True),
    "preventable_by": _text("those of CC_human_driver, Reg157, RSS, FSM that would not have collided"),
    "lawful": _flag("the other broke no rule that led to it", nullable=True),
    "target_breaches": _text("rules that the target broke and that led to it (verdict.md)"),
    "other_breaches": _text("rules that the other broke and that led to it"),
    "spare_m": _real("m", "distance by which CC_human_driver clears the other; empty if it collides"),
    "spare_s": _real("s", "least time in which CC_human_driver would have met anybody, at most 5 s"),
    "impact_left_mps": _real("m/s", "closing speed at which CC_human_driver still collides"),
    "solvable": _flag("the clairvoyant search avoids it; empty unless verdict --search asked", nullable=True),
    "unavoidable": _flag(
        "no reference driver and no search avoids it; empty if only the search could tell",
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
    "critical_brake_mps2": _real("m/s²", "braking that a reference driver needs, at most 9"),
    "near_miss_partner": _text("the other of that near miss"),
    "near_miss_time_s": _real("s", "its least time to collision, since the episode's start"),
    "resolved_by": _text(
        "party that avoided the collision: target, other, both; empty if the record ends before"
    ),
}

OFFENCE_COLUMNS: Mapping[str, Column] = {
    "offences": _text(
        "rules that the target broke, collision or not; empty: unknown, as in earlier versions"
    ),
    "offences_text": _text("the broken rules as a sentence, with times"),
}

EPISODE_COLUMNS: Mapping[str, Column] = {
    "episode": _count("number of the episode in its run"),
    "scene": _text("name of the seed scene", nullable=False),
    "seed": _count("SUMO's seed of the simulation that the seed scene is from"),
    "end": _text("why the episode ended: horizon, collision, arrived, log_end, failed", nullable=False),
    "duration_s": _real("s", "simulated time", nullable=False),
    "route": _text("edges of the target's route, separated by blanks"),
    "agents": _count("number of road users in the record, the target included"),
    "target_collision": _flag("the target collided or left the road; overlaps at the start do not count"),
    "collision_time_s": _real("s", "first contact, since the episode's start"),
    "collision_partner": _text("id of the other; empty when the target left the road"),
    "collision_type": _text(
        "junction, head_on, cut_in, rear_end_striking, rear_end_struck, side or off_road"
    ),
    "at_fault": _text("who caused it: target, other or unclear"),
    "fault_reason": _text("the rule behind at_fault, as a sentence"),
    **VERDICT_COLUMNS,
    **CRITICAL_COLUMNS,
    **OFFENCE_COLUMNS,
    "attacker_visible": _flag("a SUMO-driven target perceived the partner", nullable=True),
    "relative_speed_mps": _real("m/s", "length of the difference of the velocities"),
    "closing_speed_mps": _real("m/s", "relative speed along the contact normal"),
    "target_speed_mps": _real("m/s", "speeds at contact"),
    "partner_speed_mps": _real("m/s", "speeds at contact"),
    "impact_x_m": _real("m", "impact point in the net"),
    "impact_y_m": _real("m", "impact point in the net"),
    "impact_ahead_m": _real("m", "impact point from the target's centre"),
    "impact_left_m": _real("m", "impact point from the target's centre"),
    "initial_overlaps": _count("pairs that overlapped when first there together"),
    "sumo_collisions": _count("SUMO's own collision list: pairs at an instant"),
    "sumo_only": _count("of these, pairs whose boxes do not overlap"),
    "ours_only": _count("pairs at an instant that only we list"),
    "sumo_disagreements": _count("sumo_only plus ours_only"),
    "teleports": _count("vehicles that SUMO teleported"),
    "rough_handovers": _count("vehicles handed back to SUMO unaligned after 8 s"),
    "skipped_agents": _count("road users left to SUMO because their log continues out of reach"),
    "refused_insertions": _later_count("moved vehicles that SUMO refused to insert"),
    "implausible_plans": _later_count("plans of the target that no vehicle can drive"),
    "implausible_plan": _text("what is wrong with the first of these, as in check-planner"),
    "safeguarded_plans": _later_count(
        "of moved_plans, those whose next 0.5 s the safeguard changed by over 0.1 m"
    ),
    "moved_plans": _later_count("plans of a moved vehicle that the safeguard looked at"),
    "attack_kind": _text("kind of attack asked for; empty without attackers"),
    "in_position": _flag("a vehicle was once in a position for this attack", nullable=True),
    "min_ttc_s": _real("s", "least time to collision of boxes, up to 10 s"),
    "min_ttc_partner": _text("the vehicle of min_ttc_s"),
    "min_lane_ttc_s": _real("s", "least time to collision with the vehicle ahead in the lane"),
    "min_pet_s": _real("s", "least post-encroachment time, up to 10 s"),
    "max_drac_mps2": _real("m/s²", "greatest deceleration needed not to run into the vehicle ahead"),
    "min_clearance_m": _real("m", "least distance of boxes; 0 in a collision"),
    "min_clearance_partner": _text("the vehicle of min_clearance_m"),
    "min_clearance_time_s": _real("s", "time of min_clearance_m, since the episode's start"),
    "accel_mean_mps2": _real("m/s²", "absolute longitudinal acceleration, mean and greatest"),
    "accel_max_mps2": _real("m/s²", "absolute longitudinal acceleration, mean and greatest"),
    "brake_max_mps2": _real("m/s²", "strongest braking, positive"),
    "lateral_mean_mps2": _real("m/s²", "absolute lateral acceleration, mean and greatest"),
    "lateral_max_mps2": _real("m/s²", "absolute lateral acceleration, mean and greatest"),
    "jerk_mean_mps3": _real("m/s³", "absolute longitudinal jerk, mean and greatest"),
    "jerk_max_mps3": _real("m/s³", "absolute longitudinal jerk, mean and greatest"),
    "yaw_rate_mean_radps": _real("rad/s", "absolute yaw rate, mean and greatest"),
    "yaw_rate_max_radps": _real("rad/s", "absolute yaw rate, mean and greatest"),
    "bv_collisions": _count("collisions of background vehicles, but for replayed pairs"),
    "replayed_collisions": _later_count("collisions of two that follow their log"),
    "bv_offroad_share": _real("", "share of moved boxes off the road, mean and greatest"),
    "bv_offroad_max_share": _real("", "share of moved boxes off the road, mean and greatest"),
    "bv_offroad_vehicles": _count("moved vehicles that were once over half off the road"),
    "route_progress_m": _real("m", "how far the target came along its route"),
    "route_share": _real("", "the same as a share of its route"),
    "route_completed": _flag("the target reached the end of its route"),
    "distance_m": _real("m", "length of the target's driven path", nullable=False),
    "speed_mean_mps": _real("m/s", "speed of the target, mean and greatest"),
    "speed_max_mps": _real("m/s", "speed of the target, mean and greatest"),
    "failure_kind": _text("why the episode could not be finished, as a word"),
    "failure_message": _text("the same as a sentence"),
}

COLLISION_COLUMNS: Mapping[str, Column] = {
    "episode": _count("number of the episode in its run"),
    "time_s": _real("s", "first contact, since the episode's start", nullable=False),
    "first": _text("id of one; the target where it takes part", nullable=False),
    "second": _text("id of the other; empty when the target left the road"),
    "with_target": _flag("the target takes part"),
    "initial": _flag("the boxes overlapped when first there together"),
    "replayed": _flag("both follow their log", nullable=True),
    "type": _text("as collision_type; empty without the target or when initial"),
    "at_fault": _text("as in the episodes; empty where type is"),
    "fault_reason": _text("the rule behind at_fault, as a sentence"),
    **VERDICT_COLUMNS,
    "attacker_visible": _flag("as in the episodes", nullable=True),
    "relative_speed_mps": _real("m/s", "length of the difference of the velocities"),
    "closing_speed_mps": _real("m/s", "relative speed along the contact normal"),
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
