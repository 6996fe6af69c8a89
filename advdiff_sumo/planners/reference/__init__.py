"""The reference drivers of UN Regulation No. 157 as targets."""

from advdiff_sumo.planners.reference.reference_planner import (
    CarefulPlanner,
    FsmPlanner,
    Reg157Planner,
    RssPlanner,
)

__all__ = ["CarefulPlanner", "FsmPlanner", "Reg157Planner", "RssPlanner"]
