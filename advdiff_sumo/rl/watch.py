"""Records the progress of PPO: one record per update, from the episodes that ended before it."""

from __future__ import annotations

from collections.abc import Callable
from statistics import fmean
from typing import Any, TypeAlias

from stable_baselines3.common.callbacks import BaseCallback

from advdiff_sumo.training.history import Record
from advdiff_sumo.training.interrupt import StopRequest

ProgressListener: TypeAlias = Callable[[int, list[Record]], None]
"""Function called after every step with the number of steps made and the records so far."""
_LOSSES = {
    "train/policy_gradient_loss": "policy_loss",
    "train/value_loss": "value_loss",
    "train/approx_kl": "kl",
    "train/std": "deviation",
    "train/explained_variance": "explained",
}


class Watch(BaseCallback):
    """Collects records, saves after every update, and stops on request.

    Args:
        history: records so far, to which it appends.
        save: called after every update.
        on_progress: called with the progress after every step.
        stop_request: whether the user wants to stop.
    """

    def __init__(
        self,
        history: list[Record],
        save: Callable[[], None],
        on_progress: ProgressListener,
        stop_request: StopRequest,
    ) -> None:
        super().__init__()
        self.history, self._save, self._on_progress, self._stop_request = (
            history,
            save,
            on_progress,
            stop_request,
        )
        self._episodes: list[dict[str, Any]] = []
        self._terms: list[dict[str, float]] = []
        self._collected = False

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if "episode_summary" in info:
                self._episodes.append(info["episode_summary"])
            if "reward_terms" in info:
                self._terms.append(info["reward_terms"])
        self._on_progress(self.num_timesteps, self.history)
        return not self._stop_request

    def _on_rollout_end(self) -> None:
        self._collected = True

    def _on_rollout_start(self) -> None:
        self._record_update()

    def _on_training_end(self) -> None:
        if not self._stop_request:  # steps collected for an interrupted update are not saved
            self._record_update()

    def _record_update(self) -> None:
        """Record and save the latest update, if there was one since the previous record."""
        if not self._collected:
            return
        logged = self.logger.name_to_value
        figures = {name: float(logged[key]) for key, name in _LOSSES.items() if key in logged}
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
