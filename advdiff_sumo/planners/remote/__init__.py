"""Planners in separate processes, over gRPC; the rest of the package uses them like any other planner."""
