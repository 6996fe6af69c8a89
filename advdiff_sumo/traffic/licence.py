"""Licences: what attackers may do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

LicenceName: TypeAlias = Literal["lawful", "careless", "reckless"]


@dataclass(frozen=True)
class Licence:
    """Bounds on what attackers may do; ``reckless`` has ``RECKLESS_OVER_LIMIT`` only.

    Attributes:
        gap_share: share of the safe gap (RSS) that a lane change leaves to the follower.
        spare_m: distance added to it.
        stops_at_yellow: whether attackers stop at yellow lights.
        over_limit: highest share of the speed limit.
    """

    gap_share: float
    spare_m: float
    stops_at_yellow: bool
    over_limit: float


LAWFUL = Licence(gap_share=1.1, spare_m=1.0, stops_at_yellow=True, over_limit=1.02)
"""No breach, with a margin for what the target does in the meantime."""
CARELESS = Licence(gap_share=0.5, spare_m=0.0, stops_at_yellow=False, over_limit=1.15)
"""Inattentive driving: half the safe gap, through yellow lights, a little too fast."""


RECKLESS_OVER_LIMIT = 1.5
"""Highest share of the speed limit under the licence "reckless": 75 km/h where 50 are allowed."""
NATURAL_OVER_LIMIT = CARELESS.over_limit
"""Highest share of the speed limit of moved vehicles that are no attackers."""


def licence_of(name: LicenceName) -> Licence | None:
    """Return the licence called *name*; None for "reckless", which requires only the motion of a vehicle."""
    return {"lawful": LAWFUL, "careless": CARELESS, "reckless": None}[name]
