"""The verdict on a collision as a sentence for the user."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from advdiff_sumo.core.wording import in_series
from advdiff_sumo.metrics.breaches import Breach
from advdiff_sumo.metrics.encounter import LEAST_SPEED_MPS, Encounter
from advdiff_sumo.metrics.fault import AtFault, Fault
from advdiff_sumo.metrics.reference import ReferenceDrive

#: More deceleration than this is braking. With the foot off the pedal the regulation's driver decelerates at 0.4 m/s².
_BRAKING_MPS2 = 0.5
_COUNTS = "it counts, as the target is at fault"
#: Clause on the result of the clairvoyant search, by whether it found a drive.
_SEARCHED = {
    True: "a drive exists that avoids it, for one who knows what the others will do",
    False: "no drive was found that avoids it",
}


def sentence_of(
    case: Encounter,
    breaches: tuple[Sequence[Breach], Sequence[Breach]],
    fault: Fault,
    drive: ReferenceDrive | None,
    preventable_by: Sequence[str],
    not_judged: Sequence[str],
    solvable: bool | None = None,
) -> str:
    """Return what a careful driver would have done, which party broke which rule, and what could not be judged.

    Args:
        case: the collision with its circumstances.
        breaches: breaches of the target and of the other.
        fault: the party at fault.
        drive: drive of the legal yardstick among the reference drivers; None without one.
        preventable_by: names of the reference drivers that avoid it.
        not_judged: what could not be judged.
        solvable: whether the clairvoyant search found a drive that avoids it; None if it was not run.
    """
    searched = "" if preventable_by or solvable is None else _SEARCHED[solvable]
    other_conduct = _conduct(f"'{case.other.name}'", breaches[1])
    clauses = [_driver_clause(case, drive, preventable_by), searched, other_conduct]
    if breaches[0]:
        clauses.append(_conduct("the target", breaches[0]))
    elif fault.at_fault is AtFault.TARGET:
        clauses.append(fault.reason[0].lower() + fault.reason[1:].rstrip("."))
    if fault.at_fault is AtFault.TARGET and drive is not None and drive.model not in preventable_by:
        clauses.append(_COUNTS)
    text = "; ".join(clause for clause in clauses if clause) + "."
    text = text.replace(f"'{case.target.name}'", "the target")
    text = text[0].upper() + text[1:]
    return f"{text} Not judged: {'; '.join(not_judged)}." if not_judged else text


def off_road_sentence() -> str:
    """Return the sentence for a target that left the road."""
    return "The target left the road; a driver who keeps to a lane does not."


def _conduct(name: str, breaches: Sequence[Breach]) -> str:
    if not breaches:
        return f"{name} broke no rule"
    return f"{name} {in_series([breach.text for breach in breaches])}"


def _driver_clause(case: Encounter, drive: ReferenceDrive | None, preventable_by: Sequence[str]) -> str:
    """Return what the careful driver would have done; "" without a drive."""
    if drive is None:
        return ""
    driver = "a careful and competent driver"
    braking = _braking_clause(case, drive)
    if drive.model in preventable_by:
        return f"{driver} {braking}{_clearance_clause(drive)}"
    other_models = f" ({in_series(preventable_by)} would not)" if preventable_by else ""
    hits_partner = drive.contact_with == case.other.name
    from_behind = hits_partner and (case.target.face, case.other.face) == ("rear", "front")
    if from_behind or _stands_at_contact(drive):
        by = "" if hits_partner else f" by '{drive.contact_with}'"
        return f"even {driver} {braking}is run into{by} at {drive.impact_mps:.1f} m/s{other_models}"
    return f"even {driver} {braking}collides with '{drive.contact_with}' at {drive.impact_mps:.1f} m/s{other_models}"


def _stands_at_contact(drive: ReferenceDrive) -> bool:
    if drive.contact_step is None:
        return False
    return _stands(drive, drive.contact_step - drive.takeover_step)


def _stands(drive: ReferenceDrive, instant: int) -> bool:
    return bool(abs(drive.states.speed_mps[instant]) <= LEAST_SPEED_MPS)


def _braking_clause(case: Encounter, drive: ReferenceDrive) -> str:
    """Return when the driver brakes, as part of a sentence."""
    braking = np.flatnonzero(drive.accel_mps2 < -_BRAKING_MPS2)
    if not braking.size:
        return "who stands still " if _stands(drive, 0) else "who keeps the speed "
    steps = case.collision.step + case.collision.fraction - drive.takeover_step - float(braking[0])
    seconds = steps * drive.states.dt_s
    if seconds < 0.05:
        return "without time to brake "
    return f"who brakes {seconds:.1f} s before contact "


def _clearance_clause(drive: ReferenceDrive) -> str:
    stops = _stands(drive, -1) and not _stands(drive, 0)
    if not np.isfinite(drive.spare_m):
        return "stays clear"
    if drive.spare_m <= 0.0:
        return "does not run into anybody"
    return f"stops {drive.spare_m:.1f} m short" if stops else f"stays {drive.spare_m:.1f} m clear"
