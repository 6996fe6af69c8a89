"""Adversarial reinforcement learning: the episode as a Gymnasium environment, and PPO on it.

Importing this package registers ``advdiff_sumo/Adversary-v0``, as Gymnasium's environments do; nothing else happens.
"""

from __future__ import annotations

from advdiff_sumo.core.errors import MissingExtraError

try:
    from gymnasium.envs.registration import register, registry
except ImportError:
    raise MissingExtraError("reinforcement learning", "rl") from None

ENVIRONMENT = "advdiff_sumo/Adversary-v0"
if ENVIRONMENT not in registry:
    register(id=ENVIRONMENT, entry_point="advdiff_sumo.rl.env:AdversaryEnv")
