"""Road maps: any SUMO net as lanes, links, junctions, areas and routes."""

from advdiff_sumo.maps.junction_priority import links_over, priority_links
from advdiff_sumo.maps.lanes import Edge, Junction, Lane, LanePose, Link
from advdiff_sumo.maps.paths import LanePath, LaneReach, PathFinder, PathLink
from advdiff_sumo.maps.roadmap import RoadMap

__all__ = [
    "Edge",
    "Junction",
    "Lane",
    "LanePath",
    "LanePose",
    "LaneReach",
    "Link",
    "PathFinder",
    "PathLink",
    "RoadMap",
    "links_over",
    "priority_links",
]
