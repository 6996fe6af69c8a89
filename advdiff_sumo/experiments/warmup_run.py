"""Warm-up: the reward model alone is refitted while the tested planner is met for the first time (Sec. III-C)."""

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
_IDLE = 5
"""After so many episodes in a row that nothing can be learned from a warm-up gives up."""


@dataclass(frozen=True)
class DrawnLatents:
    """A plan of the policy.

    Attributes:
        view: the scene it was made for.
        latents: (A, Z) of the plan, scaled.
    """

    view: View
    latents: torch.Tensor


@dataclass(frozen=True)
class WarmedUp:
    """What a warm-up came to.

    Attributes:
        reward: the refitted reward model.
        steps: plans it learned from.
        episodes: episodes they were made in.
        contacts: episodes that ended with the target's collision.
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
    tell: Callable[[int], None],
    marks: Sequence[int] = (),
    keep: Callable[[int, RewardModel], None] | None = None,
) -> WarmedUp:
    """Let the diffusion policy meet the target of *options* for *steps* plans, and refit its reward model.

    After every episode the new experiences join the old ones and Q takes ``UPDATES_PER_STEP`` steps for each of
    them; the next episode is guided by the new Q. Nothing else of the networks changes.

    Args:
        options: of a run with background "diffusion"; its number of episodes does not count.
        steps: plans, the paper's interactive steps.
        tell: called with the steps done after each episode.
        marks: steps at which *keep* gets a copy of the reward model as it is then.
        keep: takes these copies.

    Raises:
        ConfigError: the background is another one, or is not guided.
        EpisodeFailure: planner or background fail before anything can be learned, again and again.
    """
    run = Run.prepare(options)
    policy = run.policy
    if not isinstance(policy, DiffusionTraffic) or not policy.options.guided:
        raise ConfigError("warm-up is for background 'diffusion' with its guide and a strength above 0")
    policy.networks = policy.networks.guided_by(copy.deepcopy(policy.networks.bundle.reward))
    bundle = policy.networks.bundle
    learner, reward_options = WarmUp(bundle, RewardOptions(), seed=options.seed), RewardOptions()
    stored: list[Experience] = []
    losses: list[float] = []
    episodes, contacts, idle = 0, 0, 0
    for record, plans in _episodes(run, policy):
        episodes += 1
        contacts += int(record.end == "collision")
        fresh = list(experiences(record, plans, reward_options))[: steps - len(stored)]
        idle = 0 if fresh else idle + 1
        if idle >= _IDLE:
            raise EpisodeFailure(
                f"{counted(idle, 'episode')} that nothing can be learned from; the last one: {_why(record)}"
            )
        for piece in _cut(fresh, len(stored), marks):
            stored += piece
            losses += learner.fit(stored, UPDATES_PER_STEP * len(piece))
            if keep is not None and len(stored) in marks:
                keep(len(stored), copy.deepcopy(bundle.reward))
        policy.networks = policy.networks.guided_by(bundle.reward)
        tell(len(stored))
        if len(stored) >= steps:
            break
    bundle.reward.eval().requires_grad_(False)
    return WarmedUp(bundle.reward, len(stored), episodes, contacts, tuple(losses))


def _why(record: EpisodeRecord) -> str:
    """Return why there is nothing to learn from *record*."""
    if record.failure is not None:
        return record.failure.message
    return f"it ended after {record.tracks.times_s[-1]:.1f} s ({record.end}); give a longer --horizon"


def _cut(fresh: list[Experience], done: int, marks: Sequence[int]) -> Iterator[list[Experience]]:
    """Yield *fresh* in pieces that end at each of *marks*, which count from the first experience of all."""
    ends = sorted({mark - done for mark in marks if 0 < mark - done < len(fresh)} | {len(fresh)})
    for start, end in zip([0, *ends], ends, strict=False):
        if start < end:
            yield fresh[start:end]


def _episodes(run: Run, policy: DiffusionTraffic) -> Iterator[tuple[EpisodeRecord, list[DrawnLatents]]]:
    """Yield the records of episodes and the plans that were made in each."""
    for number, scene in enumerate(run.seed_scenes()):
        plans: list[DrawnLatents] = []

        def keep_plan(view: View, drawn: Drawn, into: list[DrawnLatents] = plans) -> None:
            into.append(DrawnLatents(view, drawn.latents.cpu()))

        policy.listener = keep_plan
        try:
            record, _ = run.episode(number, scene).run()
        finally:
            policy.listener = None
        yield record, plans


def experiences(
    record: EpisodeRecord, plans: list[DrawnLatents], options: RewardOptions
) -> Iterator[Experience]:
    """Yield what each plan led to within ``options.execute`` model steps, as the record tells.

    A plan counts when the target is still there then, or has been hit; who has gone coasts on. Its scene knows the
    target's drive in the next ``options.look`` steps, where the record goes on for so long.
    """
    for plan in plans:
        path = _happened(record, plan.view, options.execute)
        if path is not None:
            target = torch.zeros(1, dtype=torch.long)
            state = _with_drive(plan.view.batch, _happened(record, plan.view, options.look))
            yield observed(state, path, target, plan.latents[None], options)


def _with_drive(batch: SceneBatch, path: Rollout | None) -> SceneBatch:
    """Return *batch* with the target's drive, row 0 of *path*, as its future; unknown where there is no path."""
    if path is None:
        return batch
    future, known = batch.future.clone(), batch.future_valid.clone()
    steps = path.yaw.shape[2]
    future[0, 0, :steps] = torch.cat((path.xy, path.yaw[..., None], path.speed[..., None]), dim=-1)[0, 0]
    known[0, 0, :steps] = True
    return replace(batch, future=future, future_valid=known)


def _happened(record: EpisodeRecord, view: View, steps: int) -> Rollout | None:
    """Return where the agents of *view* were in the next model steps; None where the record ends before."""
    tracks = record.tracks
    now = round((view.scene.time_s - tracks.t0_s) / tracks.dt_s)
    stride = round(MODEL_STEP_S / tracks.dt_s)
    at = now + stride * np.arange(1, steps + 1)
    if record.end == "collision":
        at = np.minimum(at, tracks.steps - 1)  # the contact is what the plan led to
    if at[-1] >= tracks.steps or at[0] <= now:
        return None
    states = np.stack([_states(record, view, row, at) for row in range(len(view.ids))])
    x = torch.from_numpy(states[None].astype(np.float32))
    nothing = torch.zeros_like(x[..., 0])
    return Rollout(x[..., :2], x[..., 2], x[..., 3], nothing, nothing)


def _states(record: EpisodeRecord, view: View, row: int, at: IntArray) -> FloatArray:
    """Return x, y from the view's origin, yaw and speed (T, 4) of one agent at instants *at* of the record."""
    tracks, now = record.tracks, view.now
    origin, name = now.xy_m[0, -1], view.ids[row]
    place, yaw, speed = now.xy_m[row, -1], now.yaw_rad[row, -1], max(float(now.speed_mps[row, -1]), 0.0)
    own = tracks.index.get(name)
    out = np.empty((len(at), 4))
    for k, step in enumerate(at.tolist()):
        if own is not None and tracks.valid[own, step]:
            place, yaw, speed = tracks.xy_m[own, step], tracks.yaw_rad[own, step], tracks.speed_mps[own, step]
        else:
            place = place + MODEL_STEP_S * speed * np.array((np.cos(yaw), np.sin(yaw)))
        out[k] = (*(place - origin), yaw, max(float(speed), 0.0))
    return out


def description(options: RunOptions, done: WarmedUp) -> dict[str, Any]:
    """Return what the header of a warmed-up reward model says about it."""
    return {
        "target": options.target,
        "net": options.net,
        "seed": options.seed,
        "steps": done.steps,
        "episodes": done.episodes,
        "contacts": done.contacts,
    }
