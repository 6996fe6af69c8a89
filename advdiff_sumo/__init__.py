"""Closed-loop adversarial traffic on SUMO: finds the situations in which a driving planner fails."""

__version__ = "0.1.0"
