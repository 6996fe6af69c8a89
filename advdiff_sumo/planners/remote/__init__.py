"""Planners in processes of their own, over gRPC; the rest of the package sees a planner like any other."""
