"""The episode as a Gymnasium environment for the attacker."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import EpisodeFailure
from advdiff_sumo.core.plan import JointPlan
from advdiff_sumo.core.record import EndReason
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.core.threads import one_thread
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.rl.adversary_reward import DecisionInterval, accel_before, hit_by_attacker, reward_terms
from advdiff_sumo.rl.episode_env import OVER, EpisodeEnv, Observation
from advdiff_sumo.rl.rl_options import adversary_options
from advdiff_sumo.rl.sources import Sources
from advdiff_sumo.sim.episode import Episode
from advdiff_sumo.sim.episode_loop import Loop
from advdiff_sumo.sim.world import Frame
from advdiff_sumo.traffic.rl.actor import ACTIONS
from advdiff_sumo.traffic.rl.features import FEATURES, LIMIT
from advdiff_sumo.traffic.rl.prior import Prior, load_prior
from advdiff_sumo.traffic.rl.rl_situation import AttackSituation, joint_plan, situation


class Seat:
    """A background policy whose attacker takes the action given to the environment.

    Attributes:
        now: the situation observed last.
        residual: (2,) the attacker's action in it.
    """

    def __init__(self, prior: Prior) -> None:
        self.prior = prior
        self.now: AttackSituation | None = None
        self.residual: FloatArray = np.zeros(ACTIONS)
        self._previous_plan: Tracks | None = None

    def observe(self, road: RoadMap, scene: Scene) -> AttackSituation:
        """Observe *scene*, and return the situation."""
        before = self.now.attackers if self.now is not None else ()
        self.now = situation(road, scene, self.prior, 1, before, "reckless")
        return self.now

    def start(self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator) -> None:  # noqa: ARG002 - the contract
        """Forget the previous episode."""
        self.now = self._previous_plan = None

    def plan(
        self,
        road: RoadMap,
        scene: Scene,
        memory: None,  # noqa: ARG002 - the contract
        rng: np.random.Generator,  # noqa: ARG002 - the contract
    ) -> tuple[JointPlan, None]:
        """Return the plan for the situation observed last."""
        now = self.now
        if now is None or now.view.scene.time_s != scene.time_s:
            raise RuntimeError("the loop asks for a plan of an instant that was not observed")
        residuals = np.repeat(self.residual[None], len(now.rows), axis=0)
        plan = joint_plan(road, now, self.prior, residuals, self._previous_plan, "reckless")
        self._previous_plan = plan.tracks
        return plan, None


class AdversaryEnv(EpisodeEnv):
    """One background vehicle against the target; a step is one model step of 0.5 s of the real episode loop.

    The attacker is chosen as in background ``diffusion`` and may change from step to step. If no vehicle can reach the
    target, the observation is zero and the action has no effect. An action is the deviation from the behaviour
    model's acceleration and curvature (left positive); zero is the behaviour model. Every plan passes the safeguard.
    An episode terminates at the target's collision and at its arrival, and is truncated at the horizon. ``info`` of
    the last step has an ``episode_summary``.

    Args:
        render_mode: None, as there is nothing to render.
        options: fields of :class:`~advdiff_sumo.rl.rl_options.AdversaryOptions`.

    Raises:
        InputError: an option, a net or a target cannot be used.
    """

    @one_thread()
    def __init__(self, *, render_mode: str | None = None, **options: Any) -> None:
        super().__init__(FEATURES, LIMIT, ACTIONS, render_mode)
        self.options = adversary_options(options)
        self._sources = Sources(self.options)
        self._seat = Seat(load_prior(self.options.prior, self.options.prior_weights))
        self._total_reward, self._steps_done, self._by_attacker = 0.0, 0, False

    def _first_observation(self, loop: Loop) -> tuple[Observation, dict[str, Any]]:
        self._total_reward, self._steps_done, self._by_attacker = 0.0, 0, False
        return self._observe(loop), {"scene": loop.episode.scene.name, "target": loop.episode.names[0]}

    def _draw(self) -> Episode:
        return self._sources.draw(self._seat, self.np_random)

    @one_thread()
    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Simulate half a second.

        A failure of SUMO or of the target's planner truncates the episode with reward 0; ``info`` has its message.

        Raises:
            RuntimeError: the environment has not been reset since the end of the previous episode.
        """
        loop = self.loop
        self._seat.residual = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0)
        first_frame, past = len(loop.recorder.frames) - 1, loop.recorder.model_frames[-2:]
        try:
            end = self._advance()
        except EpisodeFailure as error:
            return self._failed(error)
        terms = self._reward_terms(loop, end, first_frame, past)
        reward = sum(terms.values())
        self._total_reward, self._steps_done = self._total_reward + reward, self._steps_done + 1
        truncated = end in OVER and loop.steps >= loop.episode.steps
        terminated = end not in OVER
        info: dict[str, Any] = {"reward_terms": terms}
        if terminated or truncated:
            info["episode_summary"] = self._summary(end)
        observation = self._zero_observation() if terminated else self._observe(loop)
        if terminated or truncated:
            self.close()
        return observation, reward, terminated, truncated, info

    def _observe(self, loop: Loop) -> Observation:
        now = self._seat.observe(loop.road, loop.scene_now())
        return now.observations[0].astype(np.float32) if len(now.rows) else self._zero_observation()

    def _reward_terms(
        self, loop: Loop, end: EndReason, first_frame: int, past: Sequence[Frame]
    ) -> dict[str, float]:
        """Return the reward's terms for the step just made, which began at frame *first_frame*.

        *past* are the instants of the previous decision and of this one.
        """
        now = self._seat.now
        names = now.attackers if now is not None else ()
        attacker = loop.world.row_of(names[0]) if names else None
        interval = DecisionInterval(
            frames=loop.recorder.frames[first_frame:],
            size_m=loop.world.size_m[: len(loop.world)],
            attacker=attacker,
            target=loop.target,
            collided=end is EndReason.COLLISION,
            accel_mps2=None if attacker is None else accel_before(past, attacker, loop.sim.model_step_s),
            residual=self._seat.residual,
            dt_s=loop.sim.step_s,
        )
        terms = reward_terms(interval, self.options.reward, loop.road)
        self._by_attacker = hit_by_attacker(interval)
        return terms

    def _summary(self, end: str) -> dict[str, Any]:
        collided = end == EndReason.COLLISION
        return {
            "reward": self._total_reward,
            "steps": self._steps_done,
            "end": str(end),
            "collision": float(collided),
            "by_attacker": float(collided and self._by_attacker),
        }

    def _failed(self, error: EpisodeFailure) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        self.close()
        info = {"failure": str(error), "episode_summary": self._summary("failed")}
        return self._zero_observation(), 0.0, False, True, info
