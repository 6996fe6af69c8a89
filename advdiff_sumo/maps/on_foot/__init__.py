"""Crossings, walking areas and sidewalks for a net whose vehicle lanes stay as they are."""
