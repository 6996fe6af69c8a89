"""Targets: SUMO's driver models, the rule-based lane-graph planner, user plug-ins."""
