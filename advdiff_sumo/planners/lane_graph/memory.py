"""What the lane-graph planner remembers from one plan to the next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from advdiff_sumo.maps import Link
from advdiff_sumo.planners.lane_graph.path import Geometry


@dataclass(frozen=True)
class LaneGraphMemory:
    """State between plans; :attr:`geometry` only saves work, it changes no plan.

    Attributes:
        geometry: reference lines made so far.
        lanes: lanes of the path chosen last; () at first.
        links: its links.
        route: edges ahead when that path was chosen.
        detour: it gave up the given route on this edge.
        serves: whether the path chosen last serves the route.
        curvature_1pm: curvature planned for now.
        accel_mps2: acceleration planned for now.
        committed: stop lines, by (from lane, to lane), that it decided to pass.
        stopped: link at which it has come to a stop, as a stop sign asks.
        waiting_since_s: when each vehicle that stands came to stand.
    """

    geometry: Geometry
    lanes: tuple[str, ...] = ()
    links: tuple[Link, ...] = ()
    route: tuple[str, ...] = ()
    detour: bool = False
    serves: bool = True
    curvature_1pm: float = 0.0
    accel_mps2: float = 0.0
    committed: frozenset[tuple[str, str]] = frozenset()
    stopped: tuple[str, str] | None = None
    waiting_since_s: Mapping[str, float] = field(default_factory=dict)
