"""Compute all metrics of one episode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.record import EndReason, EpisodeRecord
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.background_metrics import (
    SumoComparison,
    background_collisions,
    compare_with_sumo,
    replayed_collisions,
)
from advdiff_sumo.metrics.breaches.breach import Breach
from advdiff_sumo.metrics.breaches.offences import OFFENCE_KINDS, offences
from advdiff_sumo.metrics.collision import Collision, collisions, find_touches, target_collision
from advdiff_sumo.metrics.collision_type import CollisionType
from advdiff_sumo.metrics.comfort import Comfort, comfort
from advdiff_sumo.metrics.criticality import (
    TTC_HORIZON_S,
    Extreme,
    clearances,
    smallest_value,
    time_to_collision,
)
from advdiff_sumo.metrics.encroachment import post_encroachment
from advdiff_sumo.metrics.fault import Fault
from advdiff_sumo.metrics.following import following_gaps
from advdiff_sumo.metrics.near_miss import NearMiss, near_miss
from advdiff_sumo.metrics.offroad import (
    BackgroundOffRoad,
    OffRoad,
    background_off_road,
    target_leaves_road,
)
from advdiff_sumo.metrics.progress import Progress, progress
from advdiff_sumo.metrics.verdict import Verdict, judge

#: The attacker counts as seen if it was perceived at any instant within this time before the contact.
SEEN_WITHIN_S = 1.0


@dataclass(frozen=True)
class Judged:
    """A collision of the target, classified.

    Attributes:
        collision: the collision.
        verdict: its kind, the party at fault, the breaches, and whether it is a valid failure.
        visible: whether a SUMO-driven target perceived the partner; None for Python planners.
    """

    collision: Collision
    verdict: Verdict
    visible: bool | None

    @property
    def kind(self) -> CollisionType:
        """The kind of collision."""
        return self.verdict.kind

    @property
    def fault(self) -> Fault:
        """The party at fault."""
        return self.verdict.fault


@dataclass(frozen=True)
class Criticality:
    """The most critical instants before any collision of the target; None if nothing came near.

    Attributes:
        ttc: least time to collision of boxes, in s.
        lane_ttc: least time to collision with the vehicle ahead in the lane, in s.
        pet: least post-encroachment time, in s.
        drac_mps2: greatest deceleration to avoid a rear-end collision.
        clearance: least distance of boxes, in m.
    """

    ttc: Extreme | None
    lane_ttc: Extreme | None
    pet: Extreme | None
    drac_mps2: float | None
    clearance: Extreme | None


@dataclass(frozen=True)
class EpisodeMetrics:
    """Everything measured in one episode.

    Attributes:
        contacts: every collision of two agents, initial overlaps included.
        struck: the target's first collision with another agent, unless it left the road before.
        left_road: when the target left the road, unless it had collided before.
        near_miss: the near miss that needed the hardest braking, if the target had no collision; None without one.
        offences: rules that the target broke, with or without a collision.
        sumo: comparison with SUMO's collision list.
        criticality: the most critical instants.
        comfort: accelerations, jerk and yaw rate of the target.
        progress: progress of the target.
        background: collisions of background vehicles among themselves, without replayed pairs.
        replayed: collisions of two road users that both follow their log.
        background_off_road: how far background vehicles left the road.
    """

    contacts: tuple[Collision, ...]
    struck: Judged | None
    left_road: OffRoad | None
    near_miss: NearMiss | None
    offences: tuple[Breach, ...]
    sumo: SumoComparison
    criticality: Criticality
    comfort: Comfort
    progress: Progress
    background: tuple[Collision, ...]
    replayed: tuple[Collision, ...]
    background_off_road: BackgroundOffRoad

    @property
    def target_collision(self) -> bool:
        """Whether the target collided or left the road."""
        return self.struck is not None or self.left_road is not None


def summarise(record: EpisodeRecord, road: RoadMap, solvable: bool | None = None) -> EpisodeMetrics:
    """Return all metrics of *record*, driven on *road*.

    Args:
        record: the episode.
        road: its map.
        solvable: whether the target's first collision with another is solvable, as in
            :func:`~advdiff_sumo.metrics.verdict.judge`.
    """
    touches = find_touches(record.tracks)
    contacts = collisions(record, touches)
    struck, left_road = target_collision(record, contacts), target_leaves_road(record, road)
    if struck is not None and left_road is not None:
        if struck.time_s <= left_road.time_s:
            left_road = None
        else:
            struck = None
    before = _before(record, struck, left_road)
    criticality = _criticality(record, road, before, struck)
    is_near_miss_possible = struck is None and left_road is None and record.end is not EndReason.FAILED
    judged = None if struck is None else judged_collision(record, road, struck, solvable)
    return EpisodeMetrics(
        contacts=tuple(contacts),
        struck=judged,
        left_road=left_road,
        near_miss=near_miss(record, road) if is_near_miss_possible else None,
        offences=_with_breaches_of(judged, offences(record, road)),
        sumo=compare_with_sumo(record, touches),
        criticality=criticality,
        comfort=comfort(before, record.target),
        progress=progress(record, road),
        background=tuple(background_collisions(record, contacts)),
        replayed=tuple(replayed_collisions(record, contacts)),
        background_off_road=background_off_road(record, road),
    )


def _with_breaches_of(collision: Judged | None, offences: tuple[Breach, ...]) -> tuple[Breach, ...]:
    """Return *offences* in time order, with the target's breaches in *collision* of kinds not yet among them."""
    known = {x.kind for x in offences}
    breaches = () if collision is None else collision.verdict.target_breaches
    added = (x for x in breaches if x.kind in OFFENCE_KINDS - known)
    return tuple(sorted((*offences, *added), key=lambda x: x.time_s))


def _before(record: EpisodeRecord, struck: Collision | None, left_road: OffRoad | None) -> Tracks:
    """Return the tracks up to the last instant before the target's collision."""
    if struck is not None:
        return record.tracks.window(0, max(1, struck.step + (struck.fraction > 0.0)))
    return record.tracks if left_road is None else record.tracks.window(0, left_road.step + 1)


def judged_collision(
    record: EpisodeRecord, road: RoadMap, collision: Collision, solvable: bool | None = None
) -> Judged:
    """Return a collision of the target with its verdict and whether the target perceived its partner."""
    verdict = judge(record, road, collision, solvable)
    return Judged(collision, verdict, attacker_visible(record, collision))


def _criticality(
    record: EpisodeRecord, road: RoadMap, before: Tracks, struck: Collision | None
) -> Criticality:
    target = record.target
    ahead = following_gaps(before, target, road, record.route)
    lane_ttc = ahead.time_to_collision()
    drac = ahead.deceleration_to_avoid()
    clearance = smallest_value(clearances(before, target), before)
    if struck is not None:
        clearance = Extreme(0.0, struck.rows[1], struck.time_s)
    return Criticality(
        ttc=smallest_value(time_to_collision(before, target), before),
        lane_ttc=smallest_value(np.where(lane_ttc <= TTC_HORIZON_S, lane_ttc, np.inf), before),
        pet=post_encroachment(before, target),
        drac_mps2=None if np.isnan(drac).all() else float(np.nanmax(drac)),
        clearance=clearance,
    )


def attacker_visible(record: EpisodeRecord, collision: Collision) -> bool | None:
    """Return whether the target's model perceived its partner in the second before the contact.

    SUMO's models perceive leaders, junction foes and neighbours only. A collision with another road user shows a limit
    of the lane model, not of the planner. None if a Python planner drove, which perceives everything, or if the target
    takes no part.
    """
    if record.visible is None or collision.rows[0] != record.target:
        return None
    name = record.tracks.ids[collision.rows[1]]
    count = round(SEEN_WITHIN_S / record.tracks.dt_s)
    first = max(0, collision.step + 1 - count)
    return any(name in names for names in record.visible[first : collision.step + 1])
