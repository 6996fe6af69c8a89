"""Hold what the lane-graph planner remembers from one plan to the next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from advdiff_sumo.maps import Link
from advdiff_sumo.planners.lane_graph.path import Geometry


@dataclass(frozen=True)
class LaneGraphMemory:
    """State between plans; :attr:`geometry` is a cache only and changes no plan.

    Attributes:
        geometry: reference lines computed so far.
        lanes: lanes of the previous path; () at first.
        links: links of the previous path.
        route: edges ahead at the previous plan.
        detour: whether it left the given route on the first of these edges.
        follows_route: whether the previous path follows the route.
        curvature_1pm: curvature planned for the present instant.
        accel_mps2: acceleration planned for the present instant.
        committed: links, by (from lane, to lane), that the target is on or has decided to enter.
        stopped: link at whose stop line it has come to a stop.
        waiting_since_s: time at which each standing vehicle, the target too, came to a stop.
    """

    geometry: Geometry
    lanes: tuple[str, ...] = ()
    links: tuple[Link, ...] = ()
    route: tuple[str, ...] = ()
    detour: bool = False
    follows_route: bool = True
    curvature_1pm: float = 0.0
    accel_mps2: float = 0.0
    committed: frozenset[tuple[str, str]] = frozenset()
    stopped: tuple[str, str] | None = None
    waiting_since_s: Mapping[str, float] = field(default_factory=dict)
