"""All metrics of one episode."""

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
from advdiff_sumo.metrics.criticality import TTC_HORIZON_S, Extreme, clearances, least, time_to_collision
from advdiff_sumo.metrics.encroachment import post_encroachment
from advdiff_sumo.metrics.fault import Fault
from advdiff_sumo.metrics.following import following
from advdiff_sumo.metrics.near_miss import NearMiss, near_miss
from advdiff_sumo.metrics.offroad import (
    BackgroundOffRoad,
    OffRoad,
    background_off_road,
    target_leaves_road,
)
from advdiff_sumo.metrics.progress import Progress, progress
from advdiff_sumo.metrics.verdict import Verdict, judge

#: The attacker counts as seen when it was perceived at any instant this long before the contact.
SEEN_WITHIN_S = 1.0


@dataclass(frozen=True)
class Judged:
    """A collision of the target, classified.

    Attributes:
        collision: the collision.
        verdict: what kind, who caused it, who broke which rule, and whether it counts.
        visible: whether a SUMO-driven target perceived the partner; None for Python planners.
    """

    collision: Collision
    verdict: Verdict
    visible: bool | None

    @property
    def kind(self) -> CollisionType:
        """What kind of collision it was."""
        return self.verdict.kind

    @property
    def fault(self) -> Fault:
        """Who caused it."""
        return self.verdict.fault


@dataclass(frozen=True)
class Criticality:
    """The most critical instants before any collision of the target; None where nothing came near.

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
        near_miss: of an episode without a collision of the target, what asks for the hardest braking; None where
            nothing came near.
        offences: rules that the target broke of itself, collision or not.
        sumo: SUMO's list against ours.
        criticality: how near it came.
        comfort: how the ride felt.
        progress: how far it came.
        background: collisions of background vehicles among themselves, replayed pairs left out.
        replayed: collisions of two that both follow their log.
        background_off_road: how they left the road.
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
        solvable: of the target's first collision with another, as in
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
    collided = struck is not None or left_road is not None or record.end is EndReason.FAILED
    hit = None if struck is None else judged(record, road, struck, solvable)
    return EpisodeMetrics(
        contacts=tuple(contacts),
        struck=hit,
        left_road=left_road,
        near_miss=None if collided else near_miss(record, road),
        offences=_with_those_of(hit, offences(record, road)),
        sumo=compare_with_sumo(record, touches),
        criticality=criticality,
        comfort=comfort(before, record.target),
        progress=progress(record, road),
        background=tuple(background_collisions(record, contacts)),
        replayed=tuple(replayed_collisions(record, contacts)),
        background_off_road=background_off_road(record, road),
    )


def _with_those_of(hit: Judged | None, offences: tuple[Breach, ...]) -> tuple[Breach, ...]:
    """Return *offences* and rules of their kinds that the target broke in its collision, in the order of time."""
    known = {one.kind for one in offences}
    led_to_it = () if hit is None else hit.verdict.target_breaches
    more = (one for one in led_to_it if one.kind in OFFENCE_KINDS - known)
    return tuple(sorted((*offences, *more), key=lambda one: one.time_s))


def _before(record: EpisodeRecord, struck: Collision | None, left_road: OffRoad | None) -> Tracks:
    """Return the tracks up to the last instant before the target's collision."""
    if struck is not None:
        return record.tracks.window(0, max(1, struck.step + (struck.fraction > 0.0)))
    return record.tracks if left_road is None else record.tracks.window(0, left_road.step + 1)


def judged(
    record: EpisodeRecord, road: RoadMap, collision: Collision, solvable: bool | None = None
) -> Judged:
    """Return a collision of the target with its verdict and whether the target saw it come."""
    verdict = judge(record, road, collision, solvable)
    return Judged(collision, verdict, attacker_visible(record, collision))


def _criticality(
    record: EpisodeRecord, road: RoadMap, before: Tracks, struck: Collision | None
) -> Criticality:
    target = record.target
    ahead = following(before, target, road, record.route)
    lane_ttc = ahead.time_to_collision()
    drac = ahead.deceleration_to_avoid()
    clearance = least(clearances(before, target), before)
    if struck is not None:
        clearance = Extreme(0.0, struck.rows[1], struck.time_s)
    return Criticality(
        ttc=least(time_to_collision(before, target), before),
        lane_ttc=least(np.where(lane_ttc <= TTC_HORIZON_S, lane_ttc, np.inf), before),
        pet=post_encroachment(before, target),
        drac_mps2=None if np.isnan(drac).all() else float(np.nanmax(drac)),
        clearance=clearance,
    )


def attacker_visible(record: EpisodeRecord, collision: Collision) -> bool | None:
    """Return whether the target's model perceived its partner in the second before the contact.

    SUMO's models see leaders, junction foes and neighbours only; a collision with anything else shows a limit
    of the lane model, not of the planner. None when a Python planner drove, which sees everything, or when
    the target takes no part.
    """
    if record.visible is None or collision.rows[0] != record.target:
        return None
    name = record.tracks.ids[collision.rows[1]]
    count = round(SEEN_WITHIN_S / record.tracks.dt_s)
    first = max(0, collision.step + 1 - count)
    return any(name in names for names in record.visible[first : collision.step + 1])
