"""Warm-up under a licence: learns from a few episodes in which kinds of encounter a planner fails."""

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
from advdiff_sumo.traffic.manoeuvres.commitments import UNPREDICTED_KINDS
from advdiff_sumo.traffic.manoeuvres.encounter_features import FEATURES
from advdiff_sumo.traffic.manoeuvres.encounter_preference import EncounterPreference, is_probed
from advdiff_sumo.traffic.manoeuvres.repertoire import KINDS
from advdiff_sumo.traffic.manoeuvres.speed_profiles import PLAN_DT_S
from advdiff_sumo.traffic.policy_protocol import TrafficPolicy
from advdiff_sumo.traffic.scripted.scripted_policy import ScriptedTraffic

EPISODE_S = 7.0
"""Default duration of a warm-up's episode: the first encounters of an episode are staged nearest to the target."""
SCENE = SceneOptions(density_per_km=1.5, min_neighbours=0, min_speed_mps=6.0, scenes_per_warmup=8)
"""Default seed scenes of a warm-up: sparse traffic, which leaves room for encounters."""
_MAX_TRIES = 2
"""Episodes in which an encounter is tried; after these the next one is tried, even if it never took place."""
_FREE_AHEAD_M, _FREE_ASIDE_M = 60.0, 4.0
"""A seed scene is skipped if a vehicle is this near ahead of the target and this near to its side."""
_MAX_SKIPPED = 20
"""Seed scenes skipped in a row at most."""
_MAX_IDLE_EPISODES = 3
"""A warm-up fails after this many episodes in a row without a plan."""


@dataclass(frozen=True)
class MetEncounters:
    """How a planner fared in the encounters of a warm-up.

    Attributes:
        predictor: predicts its failures; fitted to these encounters.
        features: (N, D) of the encounters.
        outcomes: (N,) from 0 (resolved) to 1 (valid failure), see ``encounter_outcomes``.
        plans: number of plans that were made.
        episodes: number of episodes.
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
    on_progress: Callable[[int], None],
    learns: bool = True,
    probes: bool = True,
) -> MetEncounters:
    """Run episodes of *options* until *plans* plans are made, and learn in which encounters the target fails.

    After each episode a new predictor is fitted, from *prior*, to all encounters so far.

    Args:
        options: of a run with background "scripted" or "diffusion" under a licence. Its number of episodes is ignored.
        prior: predictor before the first episode.
        plans: number of plans to make.
        on_progress: called with the number of plans after each episode.
        learns: False: *prior* is used throughout.
        probes: True: kinds and classes of encounters take turns, see ``encounter_preference``. False: each episode
            stages the encounters that the predictor prefers by then.

    Raises:
        ConfigError: the background has no encounters, or nothing is learned of its attack.
        EpisodeFailure: planner or background fail before their first plan in several episodes in a row.
    """
    run = Run.prepare(options)
    policy = _with_encounters(run.policy)
    log = EncounterLog(policy)
    run = replace(run, policy=log)
    features, encounter_outcomes = np.zeros((0, len(FEATURES))), np.zeros(0)
    predictor, plans_made, episodes, idle_episodes = prior, 0, 0, 0
    probe, tries = 0, 0
    for number, scene in enumerate(with_room(run.seed_scenes()) if probes else run.seed_scenes()):
        policy.preference = EncounterPreference(predictor, 0.0, probe if probes else None)
        left_s = PLAN_DT_S * (plans - plans_made)
        log.forget()  # a planner that fails as the episode begins ends it before the policy starts
        record, _ = replace(run.episode(number, scene), horizon_s=min(options.horizon_s, left_s)).run()
        ended, new_outcomes = outcomes(record, run.road, log.begun)
        tries += 1
        if is_probed(probe, features_of(ended)) or tries == _MAX_TRIES:
            probe, tries = probe + 1, 0
        features = np.concatenate((features, features_of(ended)))
        encounter_outcomes = np.concatenate((encounter_outcomes, new_outcomes))
        plans_made, episodes = plans_made + len(log.plans), episodes + 1
        can_learn = learns and len(encounter_outcomes) > 0
        predictor = prior.adapted(features, encounter_outcomes) if can_learn else prior
        idle_episodes = 0 if log.plans else idle_episodes + 1
        if idle_episodes >= _MAX_IDLE_EPISODES and record.failure is not None:
            raise EpisodeFailure(
                f"{counted(idle_episodes, 'episode')} without a plan; the last one: {record.failure.message}"
            )
        on_progress(min(plans_made, plans))
        if plans_made >= plans:
            break
    return MetEncounters(predictor, features, encounter_outcomes, plans_made, episodes)


def _with_encounters(policy: TrafficPolicy) -> ScriptedTraffic | DiffusionTraffic:
    """Return *policy*.

    Raises:
        ConfigError: it has no encounters, or nothing is learned of its attack.
    """
    if not isinstance(policy, ScriptedTraffic | DiffusionTraffic) or policy.options.licence == "reckless":
        raise ConfigError("a lawful warm-up is for background 'scripted' or 'diffusion' under a licence")
    if isinstance(policy, DiffusionTraffic) and not policy.options.guided:
        raise ConfigError("warm-up is for traffic that attacks: give a guide, and a strength above 0")
    if policy.options.attack in UNPREDICTED_KINDS:
        kinds = ", ".join(KINDS)
        raise ConfigError(f"a warm-up learns nothing of --attack {policy.options.attack}; give any, {kinds}")
    return policy


def with_room(scenes: Iterable[SeedScene]) -> Iterator[SeedScene]:
    """Yield the *scenes* in which the road ahead of the target is free, so that attackers can be inserted there.

    After ``_MAX_SKIPPED`` scenes with a vehicle ahead, the next one is yielded in any case.
    """
    skipped = 0
    for scene in scenes:
        history, target = scene.history, scene.history.index[scene.target]
        offset = local_from_world(history.xy_m[:, -1], history.xy_m[target, -1], history.yaw_rad[target, -1])
        is_near = (
            (offset[:, 0] > 0.0) & (offset[:, 0] < _FREE_AHEAD_M) & (np.abs(offset[:, 1]) < _FREE_ASIDE_M)
        )
        is_near[target] = False
        skipped += 1
        if not (is_near & history.valid[:, -1]).any() or skipped > _MAX_SKIPPED:
            skipped = 0
            yield scene


def features_of(encounters: Sequence[BegunEncounter]) -> FloatArray:
    """Return (N, D) features of *encounters*."""
    return np.array([encounter.features for encounter in encounters]).reshape(-1, len(FEATURES))


def warm_up_failures(options: RunOptions, plans: int, on_progress: Callable[[int], None]) -> MetEncounters:
    """Run :func:`meet` from the shipped prior, with ``EPISODE_S`` and ``SCENE`` where *options* do not set them.

    Args:
        options: of a run, see :func:`meet`.
        plans: number of plans to make.
        on_progress: called with the number of plans after each episode.

    Raises:
        ConfigError: the background has no encounters, or nothing is learned of its attack.
        EpisodeFailure: planner or background fail before their first plan in several episodes in a row.
    """
    defaults = {"horizon_s": EPISODE_S, "scene": SCENE}
    update = {name: value for name, value in defaults.items() if name not in options.model_fields_set}
    prior = load_failures(shipped_weights("failures"), len(FEATURES))
    return meet(options.model_copy(update=update), prior, plans, on_progress)


def failure_probabilities(predictor: FailurePredictor) -> Mapping[str, float]:
    """Return the predicted failure probability of each kind in its mean encounter, highest first."""
    predicted = dict(zip(KINDS, predictor.probability(predictor.typical).tolist(), strict=True))
    return dict(sorted(predicted.items(), key=lambda pair: -pair[1]))


def header(options: RunOptions, result: MetEncounters) -> Mapping[str, object]:
    """Return the header of a warm-up's file."""
    return {
        "target": options.target,
        "net": options.net,
        "seed": options.seed,
        "steps": result.plans,
        "episodes": result.episodes,
        "encounters": len(result.outcomes),
        "failures": result.failures,
    }
