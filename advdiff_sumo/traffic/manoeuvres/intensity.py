"""How severe the encounters of scripted attackers are made: the severities that a margin is searched in."""

from __future__ import annotations

from dataclasses import dataclass

HARDEST_MPS2 = 9.0
"""No car brakes harder."""
BRAKING_KINDS = ("hard-stop", "cut-in", "stop-and-go", "blocked-lane")
"""Kinds that are as severe as somebody brakes."""
MOST_SPARE_GAP_M = 25.0
"""Largest gap beyond the lawful one that a lane change may be asked for."""
MOST_EARLY_S = 1.5
"""Who crosses so long before the target is there does not bother it."""
LEAST_REVEALS_S, MOST_REVEALS_S = 1.5, 2.5
"""A leader that leaves later can hardly get past who stands; for an earlier one that comes in there is no room."""


@dataclass(frozen=True)
class Intensity:
    """Severities that are asked for; None: whatever serves best.

    Attributes:
        braking_mps2: with which a manoeuvre is driven; it is chosen, with its time and place, as if nothing were asked.
        spare_gap_m: bumper gap beyond the lawful one at which somebody cuts in, who then stops.
        early_s: how long before the target somebody with priority is where their ways meet.
        reveals_s: how long before it would reach somebody who stands a leader begins to leave the lane.
    """

    braking_mps2: float | None = None
    spare_gap_m: float | None = None
    early_s: float | None = None
    reveals_s: float | None = None

    def is_prescribed_for(self, kind: str) -> bool:
        """Return whether manoeuvres of *kind* are chosen for a severity, not for what serves best."""
        asked = {"cut-in": self.spare_gap_m, "crossing": self.early_s, "cut-out": self.reveals_s}
        return asked.get(kind) is not None


ANY_SEVERITY = Intensity()
"""Whatever serves best."""
