"""Adds crossings, walking areas and sidewalks to a net without changing its vehicle lanes."""
