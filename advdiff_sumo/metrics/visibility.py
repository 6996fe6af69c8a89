"""Whether a SUMO-driven target could see who hit it."""

from __future__ import annotations

from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.metrics.collision import Collision

#: The attacker counts as seen when it was perceived at any instant this long before the contact.
SEEN_WITHIN_S = 1.0


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
