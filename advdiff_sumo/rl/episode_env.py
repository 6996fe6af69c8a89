"""Base class of both environments: spaces, the running episode, its beginning and its end."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import ExitStack
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from advdiff_sumo.core.errors import EpisodeFailure
from advdiff_sumo.core.record import EndReason
from advdiff_sumo.core.threads import one_thread
from advdiff_sumo.sim.episode import Episode
from advdiff_sumo.sim.episode_loop import Loop

Observation = NDArray[np.float32]
OVER = (EndReason.HORIZON, EndReason.LOG_END)
"""End reasons for which an episode is truncated, as its time is up."""
_TRIES = 5
"""Episodes tried until SUMO can start one."""


class EpisodeEnv(gymnasium.Env[Observation, NDArray[np.float32]], ABC):
    """One episode at a time as a Gymnasium environment; a step is one model step of 0.5 s of the real episode loop.

    libsumo runs one simulation per process. So vectorise over processes (``gymnasium.vector.AsyncVectorEnv``,
    ``SubprocVecEnv``), and close an environment before another one of the same process is reset.

    Args:
        observed: number of features of an observation, each within ± *limit*.
        limit: bound of the features.
        actions: number of values of an action, each within ± 1.
        render_mode: None, as there is nothing to render.

    Raises:
        TypeError: another render mode; stable-baselines3 then makes the environment without one.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - as Gymnasium declares it

    def __init__(self, observed: int, limit: float, actions: int, render_mode: str | None) -> None:
        if render_mode is not None:
            raise TypeError(f"render_mode = '{render_mode}': the environment draws no pictures; leave it out")
        self.observation_space = gymnasium.spaces.Box(-limit, limit, (observed,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (actions,), np.float32)
        self.render_mode = None
        self._open = ExitStack()
        self._loop: Loop | None = None

    @abstractmethod
    def _draw(self) -> Episode:
        """Return the next episode."""

    @abstractmethod
    def _first_observation(self, loop: Loop) -> tuple[Observation, dict[str, Any]]:
        """Return the first observation of an episode, and its ``info``."""

    @one_thread()
    def reset(
        self,
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,  # noqa: ARG002 - Gymnasium's interface
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin another episode; the same seed gives the same episode.

        Raises:
            SceneError: the traffic never has a usable target.
            EpisodeFailure: SUMO could start none of several scenes.
            SimulationError: another simulation is running in this process.
        """
        super().reset(seed=seed)
        return self._first_observation(self._begin())

    def _begin(self) -> Loop:
        """Return the loop of the first episode that SUMO can start, of a few tries."""
        self.close()
        for tries_left in reversed(range(_TRIES)):
            try:
                self._loop = self._open.enter_context(self._draw().opened())
                self._loop.start()
                break
            except EpisodeFailure:
                self.close()
                if not tries_left:
                    raise
        return self.loop

    def _advance(self) -> EndReason:
        """Simulate half a second, and return why the episode ended; the horizon's reason if it has not."""
        loop = self.loop
        return loop.run(min(loop.steps + loop.sim.substeps, loop.episode.steps))

    @property
    def loop(self) -> Loop:
        """The loop of the running episode.

        Raises:
            RuntimeError: no episode is running.
        """
        if self._loop is None:
            raise RuntimeError("reset the environment before its first step and after an episode's end")
        return self._loop

    def close(self) -> None:
        """End the simulation; allowed at any time."""
        self._open.close()
        self._loop = None

    def _zero_observation(self) -> Observation:
        return np.zeros(self.observation_space.shape or (), dtype=np.float32)
