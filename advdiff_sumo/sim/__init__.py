"""The co-simulation; the only package that imports libsumo."""
