"""Noise schedule, sampling and guidance."""
