"""Judge whether a collision of the target is a valid failure.

A collision that no driver could have avoided, or that another caused by breaking the rules, says nothing about the
tested planner. :func:`judge` therefore finds the rules that either party broke, and whether a careful and competent
driver in the target's place would have avoided the collision. ``docs/verdict.md`` defines the terms.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.breaches import Breach, breaches_of
from advdiff_sumo.metrics.breaches.junction_rules import signals_are_unknown
from advdiff_sumo.metrics.breaches.striking_rules import pushed_by
from advdiff_sumo.metrics.collision import Collision
from advdiff_sumo.metrics.collision_type import CollisionType, collision_type
from advdiff_sumo.metrics.encounter import Encounter, encounter_of
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
    """The verdict on a collision of the target.

    Attributes:
        kind: kind of collision.
        fault: the party at fault, by rule.
        target_breaches: rules that the target broke and that led to it.
        other_breaches: rules that the other party broke and that led to it.
        lawful: whether the other broke none; None if the target left the road.
        preventable: whether the careful and competent driver (``YARDSTICK``) would not have collided; None if no
            reference driver could be put in the target's place.
        preventable_by: names of the reference drivers that would not have collided.
        spare_m: least gap of the ``YARDSTICK`` driver to the other party; None if it collides.
        spare_s: least time until that driver meets a road user, extrapolated at each instant; None if it collides.
        impact_left_mps: closing speed at which that driver still collides; None if it does not.
        valid_failure: whether the other is lawful and the collision preventable, or the target is at fault by rule;
            False if one of the two appeared too late to react to.
        solvable: whether the clairvoyant search found a drive that avoids it; None if it was not run.
        unavoidable: whether no reference driver and no drive of that search avoids it; None if no driver does and the
            search was not run.
        not_judged: what could not be judged, and why.
        sentence: the verdict as a sentence for the user.
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
    """Return the verdict on a collision of the target. A pure function of its arguments.

    The others move as recorded, whatever the reference driver does. One behind it may therefore run into its rear; such
    a collision does not count.

    >>> hit = target_collision(record, collisions(record))
    >>> verdict = judge(record, road, hit)
    >>> verdict.valid_failure, verdict.preventable_by, verdict.sentence

    Args:
        record: the episode. Without ``signals`` no red light is judged. Without ``route`` the way of the reference
            driver is guessed from the lanes.
        road: its map.
        collision: the target's collision with another (of :func:`~advdiff_sumo.metrics.collision.collisions`, with the
            target in the first of its rows), or its leaving the road.
        solvable: whether the clairvoyant search (``experiments.solution.solve``) found a drive that avoids it;
            None if it was not run.
    """
    if isinstance(collision, OffRoad):
        return _off_road()
    view = TrafficView.of_record(record, road)
    case = encounter_of(view, collision)
    kind = collision_type(case)
    fault = fault_of(view, case, kind)
    breaches = breaches_of(view, case, 0), breaches_of(view, case, 1)
    drives = drive_all(record, road, collision) if collision.step > 0 else {}
    pusher = pushed_by(view, case, 0)
    counted = {name: counted_touches(record, collision, drive, pusher) for name, drive in drives.items()}
    preventable_by = tuple(name for name in MODELS if name in counted and not counted[name])
    yardstick = replace(drives[YARDSTICK], touches=counted[YARDSTICK]) if drives else None
    preventable = None if yardstick is None else YARDSTICK in preventable_by
    lawful = not breaches[1]
    not_judged = _not_judged(view, case, bool(drives))
    clear, colliding = (yardstick, None) if preventable else (None, yardstick)
    return Verdict(
        kind=kind,
        fault=fault,
        target_breaches=breaches[0],
        other_breaches=breaches[1],
        lawful=lawful,
        preventable=preventable,
        preventable_by=preventable_by,
        spare_m=None if clear is None else clear.spare_m,
        spare_s=None if clear is None else clear.spare_s,
        impact_left_mps=None if colliding is None else colliding.impact_mps,
        valid_failure=not case.late_appearance
        and (fault.at_fault is AtFault.TARGET or (lawful and bool(preventable))),
        solvable=solvable,
        unavoidable=_unavoidable(preventable_by, solvable),
        not_judged=not_judged,
        sentence=sentence_of(case, breaches, fault, yardstick, preventable_by, not_judged, solvable),
        drives=drives,
    )


def avoids(
    record: EpisodeRecord, collision: Collision, drive: ReferenceDrive, pusher: int | None = None
) -> bool:
    """Return whether *drive* has no collision that counts; arguments as in :func:`counted_touches`."""
    return not counted_touches(record, collision, drive, pusher)


def counted_touches(
    record: EpisodeRecord, collision: Collision, drive: ReferenceDrive, pusher: int | None = None
) -> tuple[Touch, ...]:
    """Return the collisions of *drive* that count.

    A third road user does not count if it runs into the driver's rear, also after the record's end, or if it overlapped
    the target already when the driver took over. The third in row *pusher*, which pushed the target into *collision*,
    does count: it would have pushed the driver, too.
    """
    counting = {record.tracks.ids[row] for row in (collision.rows[1], pusher) if row is not None}
    return tuple(
        touch
        for touch in drive.touches
        if touch.name in counting or not (touch.from_behind or touch.from_start)
    )


def _unavoidable(preventable_by: tuple[str, ...], solvable: bool | None) -> bool | None:
    if preventable_by or solvable:
        return False
    return None if solvable is None else True


def _not_judged(view: TrafficView, case: Encounter, has_drives: bool) -> tuple[str, ...]:
    links = [party.link for party in case.parties]
    missing = []
    if case.late_appearance:
        missing.append(f"whether it counts ({case.late_appearance}, too late to react to)")
    if not view.signals and any(link is not None and link.tls_id is not None for link in links):
        missing.append("red lights (no signals recorded)")
    if signals_are_unknown(view, case):
        missing.append("right of way (no signals recorded)")
    if case.crossing and None in links:
        missing.append("right of way (no connection over the junction fits)")
    if case.collision.rows[0] not in view.routes:
        missing.append("the target's way beyond what it drove (no route recorded)")
    if not has_drives:
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
