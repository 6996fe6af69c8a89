"""The baseline ``adv-rl``: one attacker whose actor starts as the behaviour model and is trained by PPO."""
