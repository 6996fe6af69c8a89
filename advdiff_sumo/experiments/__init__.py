"""Procedures that run episodes and learn from them, one file each."""
