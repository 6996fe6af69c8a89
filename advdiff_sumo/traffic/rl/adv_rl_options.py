"""Options of ``adv-rl``, in the words of a user."""

from __future__ import annotations

from pydantic import Field

from advdiff_sumo.config import Options
from advdiff_sumo.traffic.licence import LicenceName


class AdvRlOptions(Options):
    """Options of ``adv-rl``.

    Attributes:
        weights: an actor of ``advdiff-sumo train-rl``; empty: the shipped one.
        prior_weights: networks of the behaviour model, of the kind that the actor names; empty: the shipped ones.
        strength: share of the actor's deviation from the behaviour model that is driven; 0 is the behaviour model.
        attackers: most vehicles that the actor drives at a time; it was trained as one.
        licence: what attackers may do, as of ``diffusion``: "lawful", "careless", or "reckless", as published.
    """

    weights: str = ""
    prior_weights: str = ""
    strength: float = Field(1.0, ge=0.0, le=1.0)
    attackers: int = Field(2, ge=1, le=8)
    licence: LicenceName = "lawful"

    @property
    def most(self) -> int:
        """Most attackers at a time; none where they do not deviate, but a licence would refuse plans of theirs."""
        return self.attackers if self.strength > 0.0 or self.licence == "reckless" else 0
