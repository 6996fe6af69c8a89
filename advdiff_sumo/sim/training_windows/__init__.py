"""Windows to train on, out of natural SUMO traffic and of driving logs."""
