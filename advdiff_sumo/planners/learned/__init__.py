"""Targets that drive by a trained traffic model: ``simnet``, ``trafficsim`` and ``diffusion``."""

from advdiff_sumo.planners.learned.learned_planner import DiffusionPlanner, SimNetPlanner, TrafficSimPlanner

__all__ = ["DiffusionPlanner", "SimNetPlanner", "TrafficSimPlanner"]
