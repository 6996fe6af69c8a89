"""The rule-based lane-graph planner."""

from advdiff_sumo.planners.lane_graph.lane_graph_options import LaneGraphOptions
from advdiff_sumo.planners.lane_graph.lane_graph_planner import LaneGraphPlanner

__all__ = ["LaneGraphOptions", "LaneGraphPlanner"]
