"""Co-simulation with SUMO; the only package that imports libsumo."""
