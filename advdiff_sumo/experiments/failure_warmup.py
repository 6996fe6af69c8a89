"""Warm-up under a licence: which lawful encounters break a planner, from the first plans against it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import ConfigError, EpisodeFailure
from advdiff_sumo.core.frames import local_from_world
from advdiff_sumo.core.wording import counted
from advdiff_sumo.experiments.encounter_outcomes import BegunEncounter, EncounterLog, outcomes
from advdiff_sumo.models.failure_predictor import FailurePredictor, load_failures
from advdiff_sumo.models.shipped_weights import shipped_weights
from advdiff_sumo.sim.run_episodes import Run, RunOptions
from advdiff_sumo.sim.seed_scene import SeedScene
from advdiff_sumo.sim.sim_options import SceneOptions
from advdiff_sumo.traffic.diffusion.diffusion_policy import DiffusionTraffic
from advdiff_sumo.traffic.manoeuvres.encounter_features import FEATURES
from advdiff_sumo.traffic.manoeuvres.encounter_preference import EncounterPreference, answers
from advdiff_sumo.traffic.manoeuvres.repertoire import KINDS
from advdiff_sumo.traffic.manoeuvres.speed_profiles import PLAN_DT_S
from advdiff_sumo.traffic.scripted.scripted_policy import ScriptedTraffic

EPISODE_S = 7.0
"""Longest duration of an episode of a warm-up, if nobody says otherwise: the first encounters are staged nearest."""
SCENE = SceneOptions(density_per_km=1.5, min_neighbours=0, min_speed_mps=6.0, scenes_per_warmup=8)
"""Seed scenes of a warm-up, if nobody says otherwise: with room for encounters."""
_TRIES = 2
"""So often an encounter is tried that does not come about."""
_ROOM_M, _ASIDE_M, _PASSED_OVER = 60.0, 4.0, 20
"""Seed scenes with somebody so near ahead of the target are passed over, at most so many in a row."""
_IDLE = 3
"""After so many episodes in a row without a plan a warm-up gives up."""


@dataclass(frozen=True)
class MetEncounters:
    """What a planner did in the encounters that it met.

    Attributes:
        predictor: what is believed of it now.
        features: (N, D) of the encounters.
        outcomes: (N,) 0: resolved, 1: failed validly.
        plans: plans that were made.
        episodes: in so many episodes.
    """

    predictor: FailurePredictor
    features: FloatArray
    outcomes: FloatArray
    plans: int
    episodes: int

    @property
    def failures(self) -> int:
        """Number of valid failures."""
        return int((self.outcomes == 1.0).sum())


def meet(
    options: RunOptions,
    prior: FailurePredictor,
    plans: int,
    tell: Callable[[int], None],
    learns: bool = True,
    probes: bool = True,
) -> MetEncounters:
    """Let the background of *options* meet the target for *plans* plans, and learn in which encounters it fails.

    After each episode the belief is made anew from *prior* and all encounters so far.

    Args:
        options: of a run with background "scripted" or "diffusion" under a licence; its number of episodes does
            not count.
        prior: what is believed before.
        plans: to be made.
        tell: called with the plans made after each episode.
        learns: False: the belief stays *prior*.
        probes: whether kinds and classes take turns, see ``encounter_preference``; False: each episode goes for what is
            believed by then.

    Raises:
        ConfigError: the background has no encounters.
        EpisodeFailure: planner or background fail before their first plan, again and again.
    """
    run = Run.prepare(options)
    policy = run.policy
    if not isinstance(policy, ScriptedTraffic | DiffusionTraffic) or policy.options.licence == "reckless":
        raise ConfigError("a lawful warm-up is for background 'scripted' or 'diffusion' under a licence")
    if isinstance(policy, DiffusionTraffic) and not policy.options.guided:
        raise ConfigError("warm-up is for traffic that attacks: give a guide, and a strength above 0")
    log = EncounterLog(policy)
    run = replace(run, policy=log)
    features, came = np.zeros((0, len(FEATURES))), np.zeros(0)
    believed, made, episodes, idle = prior, 0, 0, 0
    probe, tries = 0, 0
    for number, scene in enumerate(with_room(run.seed_scenes()) if probes else run.seed_scenes()):
        policy.preference = EncounterPreference(believed, 0.0, probe if probes else None)
        left_s = PLAN_DT_S * (plans - made)
        log.forget()  # a planner that fails as the episode begins ends it before the policy starts
        record, _ = replace(run.episode(number, scene), horizon_s=min(options.horizon_s, left_s)).run()
        ended, of_them = outcomes(record, run.road, log.begun)
        tries += 1
        if answers(probe, features_of(ended)) or tries == _TRIES:
            probe, tries = probe + 1, 0
        features = np.concatenate((features, features_of(ended)))
        came = np.concatenate((came, of_them))
        made, episodes = made + len(log.plans), episodes + 1
        believed = prior.adapted(features, came) if learns and len(came) else prior
        idle = 0 if log.plans else idle + 1
        if idle >= _IDLE and record.failure is not None:
            raise EpisodeFailure(
                f"{counted(idle, 'episode')} without a plan; the last one: {record.failure.message}"
            )
        tell(min(made, plans))
        if made >= plans:
            break
    return MetEncounters(believed, features, came, made, episodes)


def with_room(scenes: Iterable[SeedScene]) -> Iterator[SeedScene]:
    """Yield those of *scenes* in which nobody is ahead of the target, so that whom a warm-up asks about can come in.

    Where too many have somebody there, one of them is taken all the same.
    """
    passed_over = 0
    for scene in scenes:
        now, own = scene.history, scene.history.index[scene.target]
        place = local_from_world(now.xy_m[:, -1], now.xy_m[own, -1], now.yaw_rad[own, -1])
        near = (place[:, 0] > 0.0) & (place[:, 0] < _ROOM_M) & (np.abs(place[:, 1]) < _ASIDE_M)
        near[own] = False
        passed_over += 1
        if not (near & now.valid[:, -1]).any() or passed_over > _PASSED_OVER:
            passed_over = 0
            yield scene


def features_of(encounters: Sequence[BegunEncounter]) -> FloatArray:
    """Return (N, D) features of *encounters*."""
    return np.array([one.features for one in encounters]).reshape(-1, len(FEATURES))


def warm_up_failures(options: RunOptions, plans: int, tell: Callable[[int], None]) -> MetEncounters:
    """Meet the target of *options*, from the shipped prior, in scenes with room where none are asked for.

    Args:
        options: of a run, see :func:`meet`.
        plans: to be made.
        tell: called with the plans made after each episode.

    Raises:
        ConfigError: the background has no encounters.
        EpisodeFailure: planner or background fail before their first plan, again and again.
    """
    usual = {"horizon_s": EPISODE_S, "scene": SCENE}
    update = {name: value for name, value in usual.items() if name not in options.model_fields_set}
    prior = load_failures(shipped_weights("failures"), len(FEATURES))
    return meet(options.model_copy(update=update), prior, plans, tell)


def promises(predictor: FailurePredictor) -> Mapping[str, float]:
    """Return the failures predicted of each kind in its mean encounter, most likely first, as shares."""
    predicted = dict(zip(KINDS, predictor.probability(predictor.typical).tolist(), strict=True))
    return dict(sorted(predicted.items(), key=lambda one: -one[1]))


def header(options: RunOptions, done: MetEncounters) -> Mapping[str, object]:
    """Return what the file of a warm-up says about it."""
    return {
        "target": options.target,
        "net": options.net,
        "seed": options.seed,
        "steps": done.plans,
        "episodes": done.episodes,
        "encounters": len(done.outcomes),
        "failures": done.failures,
    }
