"""Plan random motorways: two carriageways with entries, exits and their speed-change lanes."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.sim.training_windows.street_plan import PlanEdge, StreetPlan

_RAMP_M = 170.0  # length of a ramp along the motorway
_RAMP_OFFSET_M = 45.0  # of its far end from the carriageway
_CHANGE_LANE_M = 220.0  # length of a speed-change lane


def motorway_plan(rng: np.random.Generator, lefthand: bool) -> StreetPlan:
    """Return two carriageways of 2 to 4 lanes with one to three interchanges each, ramps on the outer side.

    A plan for left-hand traffic is the mirror image; lane 0 is the leftmost there.
    """
    plan = StreetPlan({}, [])
    lanes = int(rng.integers(2, 5))
    limit = float(rng.choice((22.22, 27.78, 33.33, 36.11)))
    for name, direction in (("e", 1.0), ("w", -1.0)):
        _add_carriageway(plan, name, direction, lanes, limit, int(rng.integers(1, 4)), rng)
    if lefthand:
        plan.nodes = {name: xy * np.array([1.0, -1.0]) for name, xy in plan.nodes.items()}
    return plan


def _add_carriageway(
    plan: StreetPlan,
    name: str,
    direction: float,
    lanes: int,
    limit: float,
    interchanges: int,
    rng: np.random.Generator,
) -> None:
    """Add one carriageway: traffic drives along x × *direction*, and its right side is at y × *direction* < 0."""
    y_m = -direction * 14.0
    x_m = 0.0
    last_node = _add_node(plan, f"{name}0", 0.0, y_m, direction)
    for number in range(interchanges):
        for kind in ("off", "on") if rng.random() < 0.6 else ("on", "off"):
            key = f"{name}{number}{kind}"
            start = x_m + rng.uniform(2.3, 3.2) * _RAMP_M  # far enough for the ramps not to cross
            end = start + _CHANGE_LANE_M
            start_node = _add_node(plan, f"{key}a", start, y_m, direction)
            widened_end = _add_node(plan, f"{key}b", end, y_m, direction)
            plan.edges.append(PlanEdge(f"{key}m", last_node, start_node, lanes, limit, 10))
            plan.edges.append(PlanEdge(f"{key}c", start_node, widened_end, lanes + 1, limit, 10))
            _add_ramp(plan, key, kind, (start, end), y_m, direction, rng)
            before_edge, wide_edge = f"{key}m", f"{key}c"
            shifted = [(before_edge, wide_edge, k, k + 1) for k in range(lanes)]
            plan.connections += shifted if kind == "on" else [(before_edge, wide_edge, 0, 0), *shifted]
            last_node, x_m = widened_end, end
            plan.connections += _exit_links(key, kind, lanes)
    end_node = _add_node(plan, f"{name}9", x_m + 400.0, y_m, direction)
    plan.edges.append(PlanEdge(f"{name}9m", last_node, end_node, lanes, limit, 10))
    _resolve_next_edges(plan, name)


def _exit_links(key: str, kind: str, lanes: int) -> list[tuple[str, str, int, int]]:
    """Return the links that leave the widened edge of *key*; "+" stands for the carriageway's next edge."""
    through = [(f"{key}c", "+", k + 1, k) for k in range(lanes)]
    return [(f"{key}c", "+", 0, 0), *through] if kind == "on" else [(f"{key}c", f"{key}r", 0, 0), *through]


def _resolve_next_edges(plan: StreetPlan, name: str) -> None:
    """Replace "+" in the links of carriageway *name* by the next edge; the lane of an entry ends without a link."""
    edge_from = {e.start: e.id for e in plan.edges if e.id.endswith("m")}
    end_node = {e.id: e.end for e in plan.edges}
    plan.connections = [
        (edge, edge_from[end_node[edge]] if to == "+" and edge.startswith(name) else to, lane, to_lane)
        for edge, to, lane, to_lane in plan.connections
        if not (to == "+" and lane == 0 and edge.endswith("onc"))  # the entry's lane ends there
    ]


def _add_ramp(
    plan: StreetPlan,
    key: str,
    kind: str,
    span: tuple[float, float],
    y_m: float,
    direction: float,
    rng: np.random.Generator,
) -> None:
    """Add the on-ramp or off-ramp of *key*; its speed-change lane lies along *span*."""
    ramp_y_m = y_m - direction * _RAMP_OFFSET_M
    speed = float(rng.choice((13.89, 16.67, 22.22)))
    if kind == "on":
        far_node = _add_node(plan, f"{key}r", span[0] - _RAMP_M, ramp_y_m, direction)
        plan.edges.append(PlanEdge(f"{key}r", far_node, f"{key}a", 1, speed, 5))
        plan.connections.append((f"{key}r", f"{key}c", 0, 0))
    else:
        far_node = _add_node(plan, f"{key}r", span[1] + _RAMP_M, ramp_y_m, direction)
        plan.edges.append(PlanEdge(f"{key}r", f"{key}b", far_node, 1, speed, 5))


def _add_node(plan: StreetPlan, name: str, along: float, y_m: float, direction: float) -> str:
    """Add a node *along* metres from the beginning of a carriageway, and return its name."""
    plan.nodes[name] = np.array([along * direction + (0.0 if direction > 0.0 else 1500.0), y_m])
    return name
