"""Whether a collision of the target is a failure that counts.

A collision that no driver could have avoided, or that another broke the rules to cause, says nothing about the
tested planner. :func:`judge` says of a collision which rules either side broke, whether a careful and competent
driver in the target's place would have avoided it, and what follows. The terms stand in ``docs/verdict.md``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.breaches import Breach, breaches_of
from advdiff_sumo.metrics.breaches.junction_rules import way_is_unknown
from advdiff_sumo.metrics.breaches.striking_rules import pushed_by
from advdiff_sumo.metrics.collision import Collision
from advdiff_sumo.metrics.collision_type import CollisionType, collision_type
from advdiff_sumo.metrics.encounter import Encounter, encounter
from advdiff_sumo.metrics.fault import OFF_ROAD, AtFault, Fault, fault_of
from advdiff_sumo.metrics.offroad import OffRoad
from advdiff_sumo.metrics.reference import MODELS, ReferenceDrive, drive_all
from advdiff_sumo.metrics.reference.drive_contact import Touch
from advdiff_sumo.metrics.traffic_view import TrafficView
from advdiff_sumo.metrics.verdict_sentence import off_road_sentence, sentence_of

#: The legal yardstick among the reference drivers: "preventable" alone means by this one.
YARDSTICK = "CC_human_driver"


@dataclass(frozen=True)
class Verdict:
    """What a collision of the target comes to.

    Attributes:
        kind: kind of collision.
        fault: who caused it, by rule.
        target_breaches: rules that the target broke and that led to it.
        other_breaches: the same of the other party.
        lawful: the other broke none; None where the target left the road.
        preventable: a careful and competent driver (``YARDSTICK``) would not have collided; None where no reference
            driver could be put in the target's place.
        preventable_by: the reference drivers that would not have.
        spare_m: by how much that driver clears the other party; None where it does not.
        spare_s: the least time in which it would have met anybody had all gone on as they did; None as before.
        impact_left_mps: closing speed at which that driver still collides; None where it does not.
        valid_failure: the other is lawful and it was preventable, or the target is at fault by rule.
        solvable: whether the clairvoyant search found a drive that avoids it; None where it was not asked.
        unavoidable: no reference driver and no drive of that search avoids it; None where none of the drivers does
            and the search was not asked.
        not_judged: what could not be judged, and why.
        sentence: all of it, for people.
        drives: the drive of each reference driver, by model.
    """

    kind: CollisionType
    fault: Fault
    target_breaches: tuple[Breach, ...]
    other_breaches: tuple[Breach, ...]
    lawful: bool | None
    preventable: bool | None
    preventable_by: tuple[str, ...]
    spare_m: float | None
    spare_s: float | None
    impact_left_mps: float | None
    valid_failure: bool
    solvable: bool | None
    unavoidable: bool | None
    not_judged: tuple[str, ...]
    sentence: str
    drives: Mapping[str, ReferenceDrive] = field(default_factory=dict)


def judge(
    record: EpisodeRecord, road: RoadMap, collision: Collision | OffRoad, solvable: bool | None = None
) -> Verdict:
    """Return the verdict of a collision of the target. A pure function of its arguments.

    The others are taken to move as recorded, whatever the reference driver does. Whoever the driver leaves behind
    runs into its rear at times for that reason; such a collision is not held against it.

    >>> hit = target_collision(record, collisions(record))
    >>> verdict = judge(record, road, hit)
    >>> verdict.valid_failure, verdict.preventable_by, verdict.sentence

    Args:
        record: the episode. What it does not hold cannot be judged: without ``signals`` no red light, without
            ``route`` the way of the reference driver is guessed from the lanes.
        road: its map.
        collision: the target's collision with another (of :func:`~advdiff_sumo.metrics.collision.collisions`, the
            target being the first of its rows), or its leaving the road.
        solvable: whether the clairvoyant search (``experiments.solution.solve``) found a drive that avoids it;
            None where it was not asked.
    """
    if isinstance(collision, OffRoad):
        return _off_road()
    view = TrafficView.of_record(record, road)
    met = encounter(view, collision)
    kind = collision_type(met)
    fault = fault_of(view, met, kind)
    target, other = (breaches_of(view, met, which) for which in (0, 1))
    drives = drive_all(record, road, collision) if collision.step > 0 else {}
    pusher = pushed_by(view, met, 0)
    held = {name: held_against(record, collision, drive, pusher) for name, drive in drives.items()}
    preventable_by = tuple(name for name in MODELS if name in held and not held[name])
    yardstick = replace(drives[YARDSTICK], touches=held[YARDSTICK]) if drives else None
    preventable = None if yardstick is None else YARDSTICK in preventable_by
    valid = fault.at_fault is AtFault.TARGET or (not other and bool(preventable))
    not_judged = _not_judged(view, met, bool(drives))
    clear, hits = (yardstick, None) if preventable else (None, yardstick)
    return Verdict(
        kind=kind,
        fault=fault,
        target_breaches=target,
        other_breaches=other,
        lawful=not other,
        preventable=preventable,
        preventable_by=preventable_by,
        spare_m=None if clear is None else clear.spare_m,
        spare_s=None if clear is None else clear.spare_s,
        impact_left_mps=None if hits is None else hits.impact_mps,
        valid_failure=valid,
        solvable=solvable,
        unavoidable=_unavoidable(preventable_by, solvable),
        not_judged=not_judged,
        sentence=sentence_of(met, (target, other), fault, yardstick, preventable_by, not_judged, solvable),
        drives=drives,
    )


def avoids(
    record: EpisodeRecord, collision: Collision, drive: ReferenceDrive, pusher: int | None = None
) -> bool:
    """Return whether *drive* does not collide with anybody who counts; arguments as of :func:`held_against`."""
    return not held_against(record, collision, drive, pusher)


def held_against(
    record: EpisodeRecord, collision: Collision, drive: ReferenceDrive, pusher: int | None = None
) -> tuple[Touch, ...]:
    """Return the collisions of *drive* that count; being run into from behind by a third does not.

    It does where that third, *pusher*, pushed the target into the collision: the driver would have been pushed, too.
    Neither does it count when the third comes into its rear after the record's end, or overlapped the target already
    as the driver took over.
    """
    counted = {record.tracks.ids[row] for row in (collision.rows[1], pusher) if row is not None}
    return tuple(
        touch
        for touch in drive.touches
        if touch.name in counted or not (touch.from_behind or touch.from_start)
    )


def _unavoidable(preventable_by: tuple[str, ...], solvable: bool | None) -> bool | None:
    if preventable_by or solvable:
        return False
    return None if solvable is None else True


def _not_judged(view: TrafficView, met: Encounter, driven: bool) -> tuple[str, ...]:
    links = [party.link for party in met.parties]
    missing = []
    if not view.signals and any(link is not None and link.tls_id is not None for link in links):
        missing.append("red lights (no signals recorded)")
    if way_is_unknown(view, met):
        missing.append("right of way (no signals recorded)")
    if met.crossing and None in links:
        missing.append("right of way (no connection over the junction fits)")
    if met.collision.rows[0] not in view.routes:
        missing.append("the target's way beyond what it drove (no route recorded)")
    if not driven:
        missing.append("whether it was preventable (contact at the first instant)")
    return tuple(missing)


def _off_road() -> Verdict:
    return Verdict(
        kind=CollisionType.OFF_ROAD,
        fault=OFF_ROAD,
        target_breaches=(),
        other_breaches=(),
        lawful=None,
        preventable=None,
        preventable_by=(),
        spare_m=None,
        spare_s=None,
        impact_left_mps=None,
        valid_failure=True,
        solvable=None,
        unavoidable=None,
        not_judged=(),
        sentence=off_road_sentence(),
    )
