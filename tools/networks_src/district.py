"""Make the plan of a district with a roundabout from tables of junctions and streets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from networks_src.plain import Node, Plan
from networks_src.roundabout import Roundabout, lay_roundabout
from networks_src.streets import Street, lay
from networks_src.turns import connect


def lay_district(
    plan: Plan,
    places: Mapping[str, tuple[float, float]],
    kinds: Mapping[str, Sequence[str]],
    streets: Sequence[Street],
    ring: Roundabout,
    arms: Sequence[str],
) -> Plan:
    """Fill the plan and return it.

    Args:
        plan: empty plan.
        places: junction → position in m.
        kinds: kind → its junctions; all others are "priority".
        streets: the streets.
        ring: the roundabout.
        arms: junctions at which the arms of the roundabout begin.
    """
    kind_of = {name: kind for kind, names in kinds.items() for name in names}
    for name, xy in places.items():
        plan.add_node(Node(name, xy, kind_of.get(name, "priority")))
    for street in streets:
        lay(plan, street)
    lay_roundabout(plan, ring, arms)
    connect(plan)
    return plan
