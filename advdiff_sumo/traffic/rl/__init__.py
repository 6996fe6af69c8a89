"""The baseline ``adv-rl``: an attacker whose actor starts as the behaviour model and is trained by PPO."""
