"""Procedures that run episodes and evaluate or learn from them, one file each."""
