"""The episode as a Gymnasium environment for the tested vehicle."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from advdiff_sumo.config import Options, OwnOptions
from advdiff_sumo.core.boxes import corners
from advdiff_sumo.core.errors import EpisodeFailure
from advdiff_sumo.core.plan import Plan
from advdiff_sumo.core.record import EndReason
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.core.threads import one_thread
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.rl.episode_env import OVER, EpisodeEnv, Observation
from advdiff_sumo.rl.sources import StretchCache
from advdiff_sumo.rl.target_view import LIMIT, OBSERVED, POINTS, observation, plan_of_action
from advdiff_sumo.sim.episode import Episode
from advdiff_sumo.sim.episode_loop import Loop
from advdiff_sumo.sim.run_episodes import Run, RunOptions
from advdiff_sumo.sim.sim_options import SceneOptions

_LEFT_ROAD_SHARE = 0.5
"""The target has left the road if more than this share of its box is off it."""


class TargetRewards(Options):
    """Weights of the reward's terms, per step of 0.5 s.

    Attributes:
        progress: metres driven, at most what the lane's speed limit allows.
        collision: a collision with any road user; it ends the episode.
        off_road: share of the box off the road.
        leaving: more than half the box is off the road; it ends the episode.
        effort: squared action.
    """

    progress: float = 0.1
    collision: float = 10.0
    off_road: float = 1.0
    leaving: float = 10.0
    effort: float = 0.02


class TargetOptions(Options):
    """Options of ``advdiff_sumo/Target-v0``.

    Attributes:
        net: the net, as in ``--net``.
        background: the background policy, lawful or reckless, as in ``--background``.
        background_options: options of that policy.
        action: "controls" (acceleration, steering) or "trajectory" (speed and lateral step for four half seconds).
        scenes: number of seed scenes; they are made when they are first drawn, and kept.
        scene_seed: seed of those scenes.
        horizon_s: longest duration of an episode.
        reward: weights of the reward's terms.
        scene: how seed scenes are found.
    """

    net: str = "downtown"
    background: str = "sumo"
    background_options: OwnOptions = Field(default_factory=dict)
    action: Literal["controls", "trajectory"] = "controls"
    scenes: int = Field(40, ge=1)
    scene_seed: int = Field(0, ge=0)
    horizon_s: float = Field(15.0, ge=0.5, le=600.0, multiple_of=0.5)
    reward: TargetRewards = TargetRewards()
    scene: SceneOptions = SceneOptions()


class TargetSeat:
    """A planner that follows the action given to the environment.

    Attributes:
        action: action for the next half second.
    """

    def __init__(self, size: int) -> None:
        self.action = np.zeros(size)

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> None:
        """Return no memory."""

    def plan(
        self,
        road: RoadMap,  # noqa: ARG002 - the contract
        scene: Scene,
        memory: None,  # noqa: ARG002 - the contract
        rng: np.random.Generator,  # noqa: ARG002 - the contract
    ) -> tuple[Plan, None]:
        """Return the plan of the action."""
        return plan_of_action(self.action, scene), None


class TargetEnv(EpisodeEnv):
    """The tested vehicle against the background; a step is one model step of 0.5 s of the real episode loop.

    An episode terminates at a collision, when the target leaves the road, and at the end of its route. It is truncated
    at the horizon. ``info`` has ``reward_terms`` in every step and ``end`` in the last one.

    Args:
        render_mode: None, as there is nothing to render.
        options: fields of :class:`TargetOptions`.

    Raises:
        InputError: an option, a net or a background cannot be used.
    """

    @one_thread()
    def __init__(self, *, render_mode: str | None = None, **options: Any) -> None:
        self.options = TargetOptions.parse(options, "options of the environment")
        checked = self.options
        size = 2 if checked.action == "controls" else 2 * POINTS
        super().__init__(OBSERVED, LIMIT, size, render_mode)
        self._run = Run.prepare(
            RunOptions(
                net=checked.net,
                background=checked.background,
                background_options=checked.background_options,
                seed=checked.scene_seed,
                horizon_s=checked.horizon_s,
                scene=checked.scene,
            )
        )
        self._seat = TargetSeat(size)
        self._scenes = StretchCache(self._run)

    def _first_observation(self, loop: Loop) -> tuple[Observation, dict[str, Any]]:
        return self._observe(), {"scene": loop.episode.scene.name}

    def _draw(self) -> Episode:
        number = int(self.np_random.integers(self.options.scenes))
        scene = self._scenes.scene(number)
        seed = SeedTree(int(self.np_random.integers(2**31))).child("target")
        episode = self._run.episode(number, scene)
        return replace(episode, target=self._seat, names=("Target-v0", episode.names[1]), seed=seed)

    @one_thread()
    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Simulate half a second.

        A failure of SUMO or of the background truncates the episode with reward 0; ``info`` has its message.

        Raises:
            RuntimeError: the environment has not been reset since the end of the previous episode.
        """
        loop = self.loop
        self._seat.action = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0)
        before = loop.world.xy_m[loop.target].copy()
        try:
            end = self._advance()
        except EpisodeFailure as error:
            self.close()
            return self._zero_observation(), 0.0, False, True, {"failure": str(error), "end": "failed"}
        off_road_share = self._off_road_share(loop)
        left_road = off_road_share > _LEFT_ROAD_SHARE
        terms = self._reward_terms(loop, before, off_road_share, end)
        terminated = end not in OVER or left_road
        truncated = not terminated and loop.steps >= loop.episode.steps
        observed = self._zero_observation() if terminated else self._observe()
        info: dict[str, Any] = {"reward_terms": terms}
        if terminated or truncated:
            info["end"] = "off_road" if left_road and end in OVER else str(end)
            self.close()
        return observed, float(sum(terms.values())), terminated, truncated, info

    def _reward_terms(
        self, loop: Loop, before_m: NDArray[np.float64], off_road_share: float, end: EndReason
    ) -> dict[str, float]:
        """Return the reward's terms for the step just made, which began at *before_m* (2,)."""
        weights, world, row = self.options.reward, loop.world, loop.target
        xy = world.xy_m[row]
        if not np.isfinite(xy).all():  # it has arrived and was removed
            return dict.fromkeys(("progress", "collision", "off_road", "leaving", "effort"), 0.0)
        driven_m = float(np.linalg.norm(xy - before_m)) * float(np.sign(world.speed_mps[row]))
        return {
            "progress": weights.progress * min(driven_m, self._allowed_m(loop)),
            "collision": -weights.collision * float(end is EndReason.COLLISION),
            "off_road": -weights.off_road * off_road_share,
            "leaving": -weights.leaving * float(off_road_share > _LEFT_ROAD_SHARE),
            "effort": -weights.effort * float(np.square(self._seat.action).sum()),
        }

    def _off_road_share(self, loop: Loop) -> float:
        """Return the share of the box off the road, 0 to 1; 0 for a vehicle that has arrived."""
        world, row = loop.world, loop.target
        xy, yaw = world.xy_m[row], world.yaw_rad[row]
        if not np.isfinite(xy).all():
            return 0.0
        return float(loop.road.off_road_share(corners(xy[None], yaw[None], world.size_m[row][None]))[0])

    def _allowed_m(self, loop: Loop) -> float:
        """Return the metres that the present speed limit allows in a step; inf off every lane."""
        world, row = loop.world, loop.target
        pose = loop.road.locate(world.xy_m[row], float(world.yaw_rad[row]))
        speed_mps = loop.road.lanes[pose.lane_id].speed_mps if pose else np.inf
        return float(speed_mps) * loop.sim.substeps * loop.sim.step_s

    def _observe(self) -> Observation:
        return observation(self.loop.road, self.loop.scene_now()).astype(np.float32)
