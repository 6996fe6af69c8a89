"""What is noted while PPO runs: a record for each update, made of the episodes that ended before it."""

from __future__ import annotations

from collections.abc import Callable
from statistics import fmean
from typing import Any, TypeAlias

from stable_baselines3.common.callbacks import BaseCallback

from advdiff_sumo.training.history import Record
from advdiff_sumo.training.interrupt import StopRequest

Tell: TypeAlias = Callable[[int, list[Record]], None]
"""Told of the steps made and the records so far, after every step."""
_LOSSES = {
    "train/policy_gradient_loss": "policy_loss",
    "train/value_loss": "value_loss",
    "train/approx_kl": "kl",
    "train/std": "deviation",
    "train/explained_variance": "explained",
}


class Watch(BaseCallback):
    """Collects records, saves after every update, and stops when asked to.

    Args:
        history: records so far, which it adds to.
        save: called after every update.
        tell: of the progress.
        wish: of the user to stop.
    """

    def __init__(
        self, history: list[Record], save: Callable[[], None], tell: Tell, wish: StopRequest
    ) -> None:
        super().__init__()
        self.history, self._save, self._tell, self._wish = history, save, tell, wish
        self._episodes: list[dict[str, Any]] = []
        self._terms: list[dict[str, float]] = []
        self._collected = False

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if "episode_summary" in info:
                self._episodes.append(info["episode_summary"])
            if "reward_terms" in info:
                self._terms.append(info["reward_terms"])
        self._tell(self.num_timesteps, self.history)
        return not self._wish

    def _on_rollout_end(self) -> None:
        self._collected = True

    def _on_rollout_start(self) -> None:
        self._note()

    def _on_training_end(self) -> None:
        if not self._wish:  # what was collected of an update that never came is not saved
            self._note()

    def _note(self) -> None:
        """Record the update that has just been made, if there was one."""
        if not self._collected:
            return
        known = self.logger.name_to_value
        figures = {own: float(known[theirs]) for theirs, own in _LOSSES.items() if theirs in known}
        for name in ("reward", "steps", "collision", "by_attacker"):
            if self._episodes:
                figures[name] = fmean(float(episode[name]) for episode in self._episodes)
        for name in sorted({name for terms in self._terms for name in terms}):
            figures[f"{name}_per_step"] = sum(terms.get(name, 0.0) for terms in self._terms) / len(
                self._terms
            )
        figures["episodes"] = float(len(self._episodes))
        self.history.append(
            {"epoch": len(self.history) + 1, "step": self.num_timesteps, "train": figures, "held_out": {}}
        )
        self._episodes, self._terms, self._collected = [], [], False
        self._save()
