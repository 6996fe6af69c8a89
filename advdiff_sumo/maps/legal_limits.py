"""Speed limits of the law: what SUMO sets for the bends of a junction is none."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from advdiff_sumo.maps.lanes import Lane, Link


def legal_limits_mps(lanes: Mapping[str, Lane], links: Iterable[Link]) -> dict[str, float]:
    """Return lane → its speed limit; on a junction the highest of its own and of the lanes before and behind.

    A net's internal lanes have the speed at which a bend can be driven, which is no limit of the law.

    Args:
        lanes: by name.
        links: connections of the net.
    """
    limits = {name: lane.speed_mps for name, lane in lanes.items()}
    for link in links:
        ends = max(lanes[link.from_lane].speed_mps, lanes[link.to_lane].speed_mps)
        for via in link.via:
            limits[via] = max(limits[via], ends)
    return limits
