"""Prescribed severities of lawful attacks: those that the search for a margin varies."""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import Field

from advdiff_sumo.config import Options

ONCOMING = "oncoming"
"""Name of the attack."""
HARDEST_MPS2 = 9.0
"""No car brakes harder."""
BRAKING_KINDS = ("hard-stop", "cut-in", "stop-and-go", "blocked-lane", "double")
"""Kinds whose severity is how hard the attacker brakes."""
GAP_KINDS = ("cut-in", "slow-merge", "pull-out")
"""Kinds whose severity is the gap at the entry into the target's lane."""
SEVERITY_KINDS = (*dict.fromkeys((*BRAKING_KINDS, *GAP_KINDS)), "crossing", ONCOMING, "cut-out")
"""All kinds whose severity can be prescribed."""
MOST_SPARE_GAP_M = 25.0
"""Largest gap beyond the lawful one that may be prescribed for a lane change."""
MOST_EARLY_S = 1.5
"""A vehicle that crosses earlier than this before the target does not affect it."""
LEAST_REVEALS_S, MOST_REVEALS_S = 1.5, 2.5
"""A leader that leaves the lane later hardly gets past the vehicle ahead; an earlier one cannot be inserted."""


@dataclass(frozen=True)
class Intensity:
    """Prescribed severities; None: the one with the highest merit.

    Attributes:
        braking_mps2: deceleration of the attacker. The manoeuvre, its time and place are chosen as without it.
        spare_gap_m: bumper gap beyond the lawful one at which a vehicle enters the target's lane; a cut-in then stops.
        early_s: how long before the target a vehicle with priority is where their ways meet.
        reveals_s: how long before it would reach a standing or slow vehicle a leader begins to leave the lane.
    """

    braking_mps2: float | None = None
    spare_gap_m: float | None = None
    early_s: float | None = None
    reveals_s: float | None = None

    def is_prescribed_for(self, kind: str) -> bool:
        """Return whether manoeuvres of *kind* are chosen by a prescribed severity instead of their merit."""
        gaps_m = dict.fromkeys(GAP_KINDS, self.spare_gap_m)
        prescribed = {**gaps_m, "crossing": self.early_s, "cut-out": self.reveals_s}
        return prescribed.get(kind) is not None


ANY_SEVERITY = Intensity()
"""No severity is prescribed."""


class SeverityOptions(Options):
    """Options of a background that prescribe the severity of lawful attacks; None: that with the highest merit.

    Attributes:
        braking_mps2: deceleration of an attacker that brakes, where and when it would brake anyway.
        spare_gap_m: bumper gap beyond the lawful one at which a vehicle enters the target's lane; after a cut-in it
            stops at 6.5 m/s².
        early_s: how long before the target a vehicle with priority is where their ways meet.
        reveals_s: how long before it would reach a standing or slow vehicle a leader begins to leave the lane.
    """

    braking_mps2: float | None = Field(None, ge=0.5, le=HARDEST_MPS2)
    spare_gap_m: float | None = Field(None, ge=0.0, le=MOST_SPARE_GAP_M)
    early_s: float | None = Field(None, ge=0.0, le=MOST_EARLY_S)
    reveals_s: float | None = Field(None, ge=LEAST_REVEALS_S, le=MOST_REVEALS_S)

    @property
    def intensity(self) -> Intensity:
        """The prescribed severities."""
        return Intensity(self.braking_mps2, self.spare_gap_m, self.early_s, self.reveals_s)
