"""The rule-based lane-graph planner."""

from advdiff_sumo.planners.lane_graph.options import LaneGraphOptions
from advdiff_sumo.planners.lane_graph.planner import LaneGraphPlanner

__all__ = ["LaneGraphOptions", "LaneGraphPlanner"]
