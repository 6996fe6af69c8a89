"""Warm-up: refits only the reward model while the attackers meet a new planner (Sec. III-C)."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.errors import ConfigError, EpisodeFailure
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.wording import counted
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.model_options import MODEL_STEP_S
from advdiff_sumo.models.reward import RewardModel
from advdiff_sumo.models.view import View
from advdiff_sumo.sim.run_episodes import Run, RunOptions
from advdiff_sumo.traffic.diffusion.diffusion_policy import DiffusionTraffic
from advdiff_sumo.traffic.planning.drawn import Drawn
from advdiff_sumo.training.experience import Experience, observed
from advdiff_sumo.training.guide_adaptation import WarmUp
from advdiff_sumo.training.presets import RewardOptions

UPDATES_PER_STEP = 2
_MAX_IDLE_EPISODES = 5
"""A warm-up fails after this many episodes in a row without anything to learn from."""


@dataclass(frozen=True)
class DrawnLatents:
    """A plan of the policy.

    Attributes:
        view: the scene for which it was made.
        latents: (A, Z) of the plan, scaled.
    """

    view: View
    latents: torch.Tensor


@dataclass(frozen=True)
class WarmedUp:
    """The result of a warm-up.

    Attributes:
        reward: the refitted reward model.
        steps: number of plans it learned from.
        episodes: number of episodes.
        contacts: number of episodes that ended in a collision of the target.
        losses: of the updates.
    """

    reward: RewardModel
    steps: int
    episodes: int
    contacts: int
    losses: tuple[float, ...]


def warm_up(
    options: RunOptions,
    steps: int,
    on_progress: Callable[[int], None],
    marks: Sequence[int] = (),
    on_mark: Callable[[int, RewardModel], None] | None = None,
) -> WarmedUp:
    """Run episodes of *options* until there are *steps* plans to learn from, and refit the reward model Q.

    After every episode its experiences are added to the earlier ones, and Q takes ``UPDATES_PER_STEP`` steps for each
    new experience. The next episode is guided by the new Q. Nothing else of the networks changes.

    Args:
        options: of a run with background "diffusion"; its number of episodes is ignored.
        steps: number of plans, the paper's interactive steps.
        on_progress: called with the number of plans after each episode.
        marks: numbers of plans at which *on_mark* gets a copy of the reward model.
        on_mark: called with the number of plans and the copy.

    Raises:
        ConfigError: the background is another one, or is not guided.
        EpisodeFailure: planner or background fail before anything can be learned, in several episodes in a row.
    """
    run = Run.prepare(options)
    policy = run.policy
    if not isinstance(policy, DiffusionTraffic) or not policy.options.guided:
        raise ConfigError("warm-up is for background 'diffusion' with its guide and a strength above 0")
    policy.networks = policy.networks.guided_by(copy.deepcopy(policy.networks.bundle.reward))
    bundle = policy.networks.bundle
    learner, reward_options = WarmUp(bundle, RewardOptions(), seed=options.seed), RewardOptions()
    collected: list[Experience] = []
    losses: list[float] = []
    episodes, contacts, idle_episodes = 0, 0, 0
    for record, plans in _episodes(run, policy):
        episodes += 1
        contacts += int(record.end == "collision")
        new_experiences = list(experiences(record, plans, reward_options))[: steps - len(collected)]
        idle_episodes = 0 if new_experiences else idle_episodes + 1
        if idle_episodes >= _MAX_IDLE_EPISODES:
            idle = f"{counted(idle_episodes, 'episode')} that nothing can be learned from"
            raise EpisodeFailure(f"{idle}; the last one: {_why_nothing(record)}")
        for chunk in _split(new_experiences, len(collected), marks):
            collected += chunk
            losses += learner.fit(collected, UPDATES_PER_STEP * len(chunk))
            if on_mark is not None and len(collected) in marks:
                on_mark(len(collected), copy.deepcopy(bundle.reward))
        policy.networks = policy.networks.guided_by(bundle.reward)
        on_progress(len(collected))
        if len(collected) >= steps:
            break
    bundle.reward.eval().requires_grad_(False)
    return WarmedUp(bundle.reward, len(collected), episodes, contacts, tuple(losses))


def _why_nothing(record: EpisodeRecord) -> str:
    """Return why there is nothing to learn from *record*."""
    if record.failure is not None:
        return record.failure.message
    return f"it ended after {record.tracks.times_s[-1]:.1f} s ({record.end}); give a longer --horizon"


def _split(added: list[Experience], earlier: int, marks: Sequence[int]) -> Iterator[list[Experience]]:
    """Yield new experiences in chunks that end at each of *marks*.

    Args:
        added: the new ones.
        earlier: number of earlier experiences.
        marks: numbers of experiences, counted from the first of all.
    """
    ends = sorted({mark - earlier for mark in marks if 0 < mark - earlier < len(added)} | {len(added)})
    for start, end in zip([0, *ends], ends, strict=False):
        if start < end:
            yield added[start:end]


def _episodes(run: Run, policy: DiffusionTraffic) -> Iterator[tuple[EpisodeRecord, list[DrawnLatents]]]:
    """Yield the record and the plans of each episode."""
    for number, scene in enumerate(run.seed_scenes()):
        plans: list[DrawnLatents] = []

        def keep_plan(view: View, drawn: Drawn, destination: list[DrawnLatents] = plans) -> None:
            destination.append(DrawnLatents(view, drawn.latents.cpu()))

        policy.listener = keep_plan
        try:
            record, _ = run.episode(number, scene).run()
        finally:
            policy.listener = None
        yield record, plans


def experiences(
    record: EpisodeRecord, plans: list[DrawnLatents], options: RewardOptions
) -> Iterator[Experience]:
    """Yield each plan with its recorded consequences within ``options.execute`` model steps.

    A plan counts if the record lasts that long or ends in a collision. Vehicles that have left continue at constant
    velocity. The scene contains the target's motion of the next ``options.look`` steps, if the record lasts that long.
    """
    for plan in plans:
        path = _recorded_rollout(record, plan.view, options.execute)
        if path is not None:
            target = torch.zeros(1, dtype=torch.long)
            state = _with_target_future(plan.view.batch, _recorded_rollout(record, plan.view, options.look))
            yield observed(state, path, target, plan.latents[None], options)


def _with_target_future(batch: SceneBatch, path: Rollout | None) -> SceneBatch:
    """Return *batch* with row 0 of *path* as the target's future; unchanged without a path."""
    if path is None:
        return batch
    future, is_known = batch.future.clone(), batch.future_valid.clone()
    steps = path.yaw.shape[2]
    future[0, 0, :steps] = torch.cat((path.xy, path.yaw[..., None], path.speed[..., None]), dim=-1)[0, 0]
    is_known[0, 0, :steps] = True
    return replace(batch, future=future, future_valid=is_known)


def _recorded_rollout(record: EpisodeRecord, view: View, steps: int) -> Rollout | None:
    """Return the recorded motion of the agents of *view* in the next model steps; None if the record ends before."""
    tracks = record.tracks
    now_step = round((view.scene.time_s - tracks.t0_s) / tracks.dt_s)
    stride = round(MODEL_STEP_S / tracks.dt_s)
    instants = now_step + stride * np.arange(1, steps + 1)
    if record.end == "collision":
        instants = np.minimum(instants, tracks.steps - 1)  # the contact is what the plan led to
    if instants[-1] >= tracks.steps or instants[0] <= now_step:
        return None
    states = np.stack([_states(record, view, row, instants) for row in range(len(view.ids))])
    futures = torch.from_numpy(states[None].astype(np.float32))
    zeros = torch.zeros_like(futures[..., 0])
    return Rollout(futures[..., :2], futures[..., 2], futures[..., 3], zeros, zeros)


def _states(record: EpisodeRecord, view: View, row: int, instants: IntArray) -> FloatArray:
    """Return the states (T, 4) of one agent at the record's *instants*: x, y, yaw, speed.

    x and y are relative to the target's position in *view*. Without a record, the agent continues straight on at
    constant speed.
    """
    tracks, past = record.tracks, view.now
    origin, name = past.xy_m[0, -1], view.ids[row]
    xy, yaw, speed = past.xy_m[row, -1], past.yaw_rad[row, -1], max(float(past.speed_mps[row, -1]), 0.0)
    own_row = tracks.index.get(name)
    states = np.empty((len(instants), 4))
    for k, step in enumerate(instants.tolist()):
        if own_row is not None and tracks.valid[own_row, step]:
            xy, yaw = tracks.xy_m[own_row, step], tracks.yaw_rad[own_row, step]
            speed = tracks.speed_mps[own_row, step]
        else:
            xy = xy + MODEL_STEP_S * speed * np.array((np.cos(yaw), np.sin(yaw)))
        states[k] = (*(xy - origin), yaw, max(float(speed), 0.0))
    return states


def description(options: RunOptions, result: WarmedUp) -> dict[str, Any]:
    """Return the header of the file of a warmed-up reward model."""
    return {
        "target": options.target,
        "net": options.net,
        "seed": options.seed,
        "steps": result.steps,
        "episodes": result.episodes,
        "contacts": result.contacts,
    }
