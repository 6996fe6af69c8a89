"""Licences: what attackers may do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

LicenceName: TypeAlias = Literal["lawful", "careless", "reckless"]


@dataclass(frozen=True)
class Licence:
    """Bounds of what attackers may do; ``reckless`` has none but ``RECKLESS_OVER_LIMIT``.

    Attributes:
        gap_share: share of the safe gap (RSS) that a lane change leaves to who follows.
        spare_m: on top of it.
        stops_at_yellow: whether a yellow light binds.
        over_limit: highest share of the speed limit.
    """

    gap_share: float
    spare_m: float
    stops_at_yellow: bool
    over_limit: float


LAWFUL = Licence(gap_share=1.1, spare_m=1.0, stops_at_yellow=True, over_limit=1.02)
"""No breach, with a little room for what the target does until then."""
CARELESS = Licence(gap_share=0.5, spare_m=0.0, stops_at_yellow=False, over_limit=1.15)
"""What inattentive people do: half the safe gap, yellow lights, a little too fast."""


RECKLESS_OVER_LIMIT = 1.5
"""Highest share of the speed limit under the licence "reckless": 75 km/h where 50 are allowed."""
NATURAL_OVER_LIMIT = CARELESS.over_limit
"""Highest share of the speed limit of vehicles that are moved and attack nobody."""


def licence_of(name: LicenceName) -> Licence | None:
    """Return the licence called *name*; None for "reckless", which asks for nothing but a vehicle's motion."""
    return {"lawful": LAWFUL, "careless": CARELESS, "reckless": None}[name]
