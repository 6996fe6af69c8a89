"""Traffic rules that a road user broke within the 5 s before a collision, where the breach led to it.

Every rule is a pure function of a :class:`~advdiff_sumo.metrics.traffic_view.TrafficView`, so it holds for recorded
episodes and for plans alike. :func:`breaches_of` asks which breaches of one party led to a collision;
:func:`conduct_breaches` which rules that need no collision somebody breaks, as in a plan that is not driven yet. The
rules, with their figures, stand in ``docs/verdict.md``.
"""

from __future__ import annotations

from advdiff_sumo.metrics.breaches.breach import Breach, BreachKind
from advdiff_sumo.metrics.breaches.conduct_rules import (
    drove_backwards,
    drove_off_road,
    drove_too_fast,
    off_road,
    reversing,
    speeding,
)
from advdiff_sumo.metrics.breaches.junction_rules import red_light, right_of_way
from advdiff_sumo.metrics.breaches.lane_rules import lane_entry_breach, wrong_side
from advdiff_sumo.metrics.breaches.striking_rules import ran_into
from advdiff_sumo.metrics.encounter import Encounter
from advdiff_sumo.metrics.traffic_view import TrafficView

__all__ = ["Breach", "BreachKind", "breaches_of", "conduct_breaches"]

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
_PRESENCE_RULES = (red_light, right_of_way, wrong_side, lane_entry_breach, reversing, off_road, speeding)


def breaches_of(view: TrafficView, met: Encounter, which: int) -> tuple[Breach, ...]:
    """Return the breaches of one party of a collision that led to it.

    Args:
        view: who is where.
        met: the collision with its circumstances (:func:`~advdiff_sumo.metrics.encounter.encounter`).
        which: 0 for the first of the two (the target, where it takes part), 1 for the other.
    """
    excused = any(x.kind in _EXCUSING for x in _presence(view, met, 1 - which))
    struck = ran_into(view, met, which, excused)
    own = _presence(view, met, which)
    return (*own, struck) if struck is not None else own


def conduct_breaches(view: TrafficView, row: int, start: int, stop: int) -> tuple[Breach, ...]:
    """Return the rules of conduct that agent *row* breaks at instants *start* to *stop* (exclusive).

    Speeding, reversing and leaving the road: what concerns nobody else and can be said of a plan by itself.
    """
    breaches = (rule(view, row, start, stop) for rule in (drove_too_fast, drove_backwards, drove_off_road))
    return tuple(x for x in breaches if x is not None)


def _presence(view: TrafficView, met: Encounter, which: int) -> tuple[Breach, ...]:
    """Return the breaches that put the party where the contact was."""
    breaches = (rule(view, met, which) for rule in _PRESENCE_RULES)
    return tuple(x for x in breaches if x is not None)
