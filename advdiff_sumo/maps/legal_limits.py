"""Derives the legal speed limit of each lane; the speeds that SUMO states for bends on junctions are none."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from advdiff_sumo.maps.lanes import Lane, Link


def legal_limits_mps(lanes: Mapping[str, Lane], links: Iterable[Link]) -> dict[str, float]:
    """Return lane id → legal speed limit in m/s.

    The speed that a net states for an internal lane is the one at which its bend can be driven, not a legal limit.
    An internal lane gets the highest of that speed and the limits of the lanes before and after the junction.

    Args:
        lanes: lane id → lane.
        links: connections of the net.
    """
    limits_mps = {name: lane.speed_mps for name, lane in lanes.items()}
    for link in links:
        highest_mps = max(lanes[link.from_lane].speed_mps, lanes[link.to_lane].speed_mps)
        for via in link.via:
            limits_mps[via] = max(limits_mps[via], highest_mps)
    return limits_mps
