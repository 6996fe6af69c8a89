"""A verdict as a sentence that a person understands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from advdiff_sumo.core.wording import in_series
from advdiff_sumo.metrics.breaches import Breach
from advdiff_sumo.metrics.encounter import LEAST_SPEED_MPS, Encounter
from advdiff_sumo.metrics.fault import AtFault, Fault
from advdiff_sumo.metrics.reference import ReferenceDrive

#: Decelerating by more than this is braking; the regulation's driver takes its foot off the pedal with 0.4 m/s².
_BRAKING_MPS2 = 0.5
_COUNTS = "it counts, as the target is at fault"
_SEARCHED = {
    True: "a drive exists that avoids it, for one who knows what the others will do",
    False: "no drive was found that avoids it",
}


def sentence_of(
    met: Encounter,
    breaches: tuple[Sequence[Breach], Sequence[Breach]],
    fault: Fault,
    drive: ReferenceDrive | None,
    preventable_by: Sequence[str],
    not_judged: Sequence[str],
    solvable: bool | None = None,
) -> str:
    """Return what happened, what a careful driver would have done, and who broke which rule.

    Args:
        met: the collision with its circumstances.
        breaches: of the target and of the other.
        fault: who caused it.
        drive: of the legal yardstick among the reference drivers; None where there is none.
        preventable_by: reference drivers that avoid it.
        not_judged: what could not be judged.
        solvable: whether the clairvoyant search found a drive that avoids it; None where it was not asked.
    """
    target = "the target" if breaches[0] else ""
    searched = "" if preventable_by or solvable is None else _SEARCHED[solvable]
    clauses = [_driver(met, drive, preventable_by), searched, _conduct(f"'{met.other.name}'", breaches[1])]
    if target:
        clauses.append(_conduct(target, breaches[0]))
    elif fault.at_fault is AtFault.TARGET:
        clauses.append(fault.reason[0].lower() + fault.reason[1:].rstrip("."))
    if fault.at_fault is AtFault.TARGET and drive is not None and drive.model not in preventable_by:
        clauses.append(_COUNTS)
    text = "; ".join(clause for clause in clauses if clause) + "."
    text = text.replace(f"'{met.target.name}'", "the target")
    text = text[0].upper() + text[1:]
    return f"{text} Not judged: {'; '.join(not_judged)}." if not_judged else text


def off_road_sentence() -> str:
    """Return the sentence for a target that left the road."""
    return "The target left the road; a driver who keeps to a lane does not."


def _conduct(who: str, breaches: Sequence[Breach]) -> str:
    if not breaches:
        return f"{who} broke no rule"
    return f"{who} {in_series([breach.text for breach in breaches])}"


def _driver(met: Encounter, drive: ReferenceDrive | None, preventable_by: Sequence[str]) -> str:
    if drive is None:
        return ""
    who = "a careful and competent driver"
    braking = _braking(met, drive)
    if drive.model in preventable_by:
        return f"{who} {braking}{_outcome(drive)}"
    others = f" ({in_series(preventable_by)} would not)" if preventable_by else ""
    partner = drive.contact_with == met.other.name
    from_behind = partner and (met.target.face, met.other.face) == ("rear", "front")
    if from_behind or _stands_at_contact(drive):
        by = "" if partner else f" by '{drive.contact_with}'"
        return f"even {who} {braking}is run into{by} at {drive.impact_mps:.1f} m/s{others}"
    hit = "it" if partner else f"'{drive.contact_with}'"
    return f"even {who} {braking}collides with {hit} at {drive.impact_mps:.1f} m/s{others}"


def _stands_at_contact(drive: ReferenceDrive) -> bool:
    if drive.contact_step is None:
        return False
    return _stands(drive, drive.contact_step - drive.takeover_step)


def _stands(drive: ReferenceDrive, at: int) -> bool:
    return bool(abs(drive.states.speed_mps[at]) <= LEAST_SPEED_MPS)


def _braking(met: Encounter, drive: ReferenceDrive) -> str:
    """Return when the driver brakes, as part of a sentence."""
    at = np.flatnonzero(drive.accel_mps2 < -_BRAKING_MPS2)
    if not at.size:
        return "who stands still " if _stands(drive, 0) else "who keeps the speed "
    before = met.collision.step + met.collision.fraction - drive.takeover_step - float(at[0])
    seconds = before * drive.states.dt_s
    if seconds < 0.05:
        return "without time to brake "
    return f"who brakes {seconds:.1f} s before contact "


def _outcome(drive: ReferenceDrive) -> str:
    stops = _stands(drive, -1) and not _stands(drive, 0)
    if not np.isfinite(drive.spare_m):
        return "stays clear"
    if drive.spare_m <= 0.0:
        return "does not run into anybody"
    return f"stops {drive.spare_m:.1f} m short" if stops else f"stays {drive.spare_m:.1f} m clear"
