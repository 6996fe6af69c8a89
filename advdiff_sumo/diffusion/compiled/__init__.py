"""Loops of the networks' run-time forms, compiled by numba for one thread of the CPU."""
