"""Make training windows from natural SUMO traffic and from driving logs."""
