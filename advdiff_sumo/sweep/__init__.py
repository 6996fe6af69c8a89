"""Sweeps: many episodes over workers that may die, with results that survive."""
