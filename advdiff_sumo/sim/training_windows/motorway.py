"""Plans of random motorways: two carriageways with entries, exits and their speed-change lanes."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.sim.training_windows.street_plan import PlanEdge, StreetPlan

_RAMP_M, _RAMP_ASIDE_M = 170.0, 45.0
_CHANGE_M = 220.0


def motorway_plan(rng: np.random.Generator, lefthand: bool) -> StreetPlan:
    """Return two carriageways of 2 to 4 lanes with one to three interchanges each, ramps on the outer side.

    A plan for left-hand traffic is the mirror image, lane 0 being the leftmost there.
    """
    plan = StreetPlan({}, [])
    lanes = int(rng.integers(2, 5))
    limit = float(rng.choice((22.22, 27.78, 33.33, 36.11)))
    for name, ahead in (("e", 1.0), ("w", -1.0)):
        _carriageway(plan, name, ahead, lanes, limit, int(rng.integers(1, 4)), rng)
    if lefthand:
        plan.nodes = {name: xy * np.array([1.0, -1.0]) for name, xy in plan.nodes.items()}
    return plan


def _carriageway(
    plan: StreetPlan,
    name: str,
    ahead: float,
    lanes: int,
    limit: float,
    interchanges: int,
    rng: np.random.Generator,
) -> None:
    """Add one direction: driving along x × *ahead*, its right side at y × *ahead* < 0."""
    side = -ahead * 14.0
    at = 0.0
    before = _node(plan, f"{name}0", 0.0, side, ahead)
    for number in range(interchanges):
        for what in ("off", "on") if rng.random() < 0.6 else ("on", "off"):
            key = f"{name}{number}{what}"
            start = at + rng.uniform(2.3, 3.2) * _RAMP_M  # far enough for the ramps not to cross
            end = start + _CHANGE_M
            here = _node(plan, f"{key}a", start, side, ahead)
            there = _node(plan, f"{key}b", end, side, ahead)
            plan.edges.append(PlanEdge(f"{key}m", before, here, lanes, limit, 10))
            plan.edges.append(PlanEdge(f"{key}c", here, there, lanes + 1, limit, 10))
            _ramp(plan, key, what, (start, end), side, ahead, rng)
            into, out = f"{key}m", f"{key}c"
            shift = [(into, out, k, k + 1) for k in range(lanes)]
            plan.connections += shift if what == "on" else [(into, out, 0, 0), *shift]
            before, at = there, end
            plan.connections += _onward(key, what, lanes)
    last = _node(plan, f"{name}9", at + 400.0, side, ahead)
    plan.edges.append(PlanEdge(f"{name}9m", before, last, lanes, limit, 10))
    _name_followers(plan, name)


def _onward(key: str, what: str, lanes: int) -> list[tuple[str, str, int, int]]:
    """Return the links that leave the wide part; "+" stands for the carriageway's next edge."""
    through = [(f"{key}c", "+", k + 1, k) for k in range(lanes)]
    return [(f"{key}c", "+", 0, 0), *through] if what == "on" else [(f"{key}c", f"{key}r", 0, 0), *through]


def _name_followers(plan: StreetPlan, name: str) -> None:
    start_of = {e.start: e.id for e in plan.edges if e.id.endswith("m")}
    end_of = {e.id: e.end for e in plan.edges}
    plan.connections = [
        (a, start_of[end_of[a]] if b == "+" and a.startswith(name) else b, k, j)
        for a, b, k, j in plan.connections
        if not (b == "+" and k == 0 and a.endswith("onc"))  # the entry's lane ends there
    ]


def _ramp(
    plan: StreetPlan,
    key: str,
    what: str,
    span: tuple[float, float],
    side: float,
    ahead: float,
    rng: np.random.Generator,
) -> None:
    aside = side - ahead * _RAMP_ASIDE_M
    speed = float(rng.choice((13.89, 16.67, 22.22)))
    if what == "on":
        far = _node(plan, f"{key}r", span[0] - _RAMP_M, aside, ahead)
        plan.edges.append(PlanEdge(f"{key}r", far, f"{key}a", 1, speed, 5))
        plan.connections.append((f"{key}r", f"{key}c", 0, 0))
    else:
        far = _node(plan, f"{key}r", span[1] + _RAMP_M, aside, ahead)
        plan.edges.append(PlanEdge(f"{key}r", f"{key}b", far, 1, speed, 5))


def _node(plan: StreetPlan, name: str, along: float, side: float, ahead: float) -> str:
    plan.nodes[name] = np.array([along * ahead + (0.0 if ahead > 0.0 else 1500.0), side])
    return name
