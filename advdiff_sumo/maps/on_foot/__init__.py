"""Crossings, walking areas and sidewalks for a net whose vehicle lanes stay as they are."""

from advdiff_sumo.maps.on_foot.add_paths import FootPaths, add_foot_paths

__all__ = ["FootPaths", "add_foot_paths"]
