"""Published adversaries beside the paper's method: AdvSim and Strive, in closed loop."""
