"""Traffic rules that a road user broke within the 5 s before a collision, where the breach led to it.

Every rule is a pure function of a :class:`~advdiff_sumo.metrics.traffic_view.TrafficView`, so it applies to recorded
episodes and to plans alike. :func:`breaches_of` returns the breaches of one party that led to a collision.
:func:`conduct_breaches` checks the rules that apply without a collision, also in a plan that is not driven yet.
``docs/verdict.md`` states the rules with their figures.
"""

from __future__ import annotations

from advdiff_sumo.metrics.breaches.breach import Breach, BreachKind
from advdiff_sumo.metrics.breaches.conduct_rules import (
    drove_backwards,
    drove_off_road,
    drove_too_fast,
    off_road,
    reversing_breach,
    speeding_breach,
)
from advdiff_sumo.metrics.breaches.junction_rules import red_light, right_of_way
from advdiff_sumo.metrics.breaches.lane_rules import lane_entry_breach, wrong_side
from advdiff_sumo.metrics.breaches.striking_rules import ran_into
from advdiff_sumo.metrics.encounter import Encounter
from advdiff_sumo.metrics.traffic_view import TrafficView

__all__ = ["Breach", "BreachKind", "breaches_of", "conduct_breaches"]

#: A breach of the struck party of one of these kinds excuses the party that ran into it.
_EXCUSING = frozenset(
    (
        BreachKind.RED_LIGHT,
        BreachKind.RIGHT_OF_WAY,
        BreachKind.WRONG_SIDE,
        BreachKind.UNSAFE_LANE_ENTRY,
        BreachKind.SIDEWAYS,
        BreachKind.REVERSING,
    )
)
#: Rules whose breach puts a party where the contact is.
_PRESENCE_RULES = (
    red_light,
    right_of_way,
    wrong_side,
    lane_entry_breach,
    reversing_breach,
    off_road,
    speeding_breach,
)


def breaches_of(view: TrafficView, case: Encounter, index: int) -> tuple[Breach, ...]:
    """Return the breaches of one party of a collision that led to it.

    Args:
        view: the traffic.
        case: the collision with its circumstances (:func:`~advdiff_sumo.metrics.encounter.encounter_of`).
        index: 0 for the first party (the target, if it takes part), 1 for the other.
    """
    excused = any(x.kind in _EXCUSING for x in _presence_breaches(view, case, 1 - index))
    striking = ran_into(view, case, index, excused)
    own = _presence_breaches(view, case, index)
    return (*own, striking) if striking is not None else own


def conduct_breaches(view: TrafficView, row: int, start: int, stop: int) -> tuple[Breach, ...]:
    """Return the rules of conduct that agent *row* breaks at instants *start* to *stop* (exclusive).

    These are speeding, reversing and leaving the road: they do not depend on other road users.
    """
    breaches = (rule(view, row, start, stop) for rule in (drove_too_fast, drove_backwards, drove_off_road))
    return tuple(x for x in breaches if x is not None)


def _presence_breaches(view: TrafficView, case: Encounter, index: int) -> tuple[Breach, ...]:
    """Return the breaches that put the party where the contact was."""
    breaches = (rule(view, case, index) for rule in _PRESENCE_RULES)
    return tuple(x for x in breaches if x is not None)
