"""Gymnasium environments of the episode: one for the attacker, with training by PPO, and one for the target.

Importing this package only registers ``advdiff_sumo/Adversary-v0`` and ``advdiff_sumo/Target-v0`` with Gymnasium.
"""

from __future__ import annotations

from advdiff_sumo.core.errors import MissingExtraError

try:
    from gymnasium.envs.registration import register, registry
except ImportError:
    raise MissingExtraError("reinforcement learning", "rl") from None

ENVIRONMENT = "advdiff_sumo/Adversary-v0"
if ENVIRONMENT not in registry:
    register(id=ENVIRONMENT, entry_point="advdiff_sumo.rl.adversary_env:AdversaryEnv")
TARGET_ENVIRONMENT = "advdiff_sumo/Target-v0"
if TARGET_ENVIRONMENT not in registry:
    register(id=TARGET_ENVIRONMENT, entry_point="advdiff_sumo.rl.target_env:TargetEnv")
