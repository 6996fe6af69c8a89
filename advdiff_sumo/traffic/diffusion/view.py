"""The networks' view of a scene, which policies and learned targets share."""

from advdiff_sumo.models.view import MOST_AGENTS, View, look

__all__ = ["MOST_AGENTS", "View", "look"]
