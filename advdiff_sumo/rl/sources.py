"""Draws the episodes of the attacker's environment: seed scenes and targets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps.shipped_nets import find_net
from advdiff_sumo.rl.rl_options import AdversaryOptions
from advdiff_sumo.sim.episode import Episode
from advdiff_sumo.sim.run_episodes import Run, RunOptions, check_together, target_of
from advdiff_sumo.sim.seed_scene import SeedScene
from advdiff_sumo.traffic.policy_protocol import TrafficPolicy
from advdiff_sumo.traffic.rl.prior import load_prior


def check(options: AdversaryOptions) -> None:
    """Check the names and files in *options* without reading a net or starting a process.

    Raises:
        InputError: a net, a target or the behaviour model is missing or unusable.
    """
    for net in options.nets:
        find_net(net)
    for target in options.targets:
        run = RunOptions(target=target, scene=options.scene)
        check_together(run, target_of(run))
    load_prior(options.prior, options.prior_weights)


class StretchCache:
    """Seed scenes of *run* by number; a stretch of traffic is simulated when one of its scenes is first needed."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._stretches: dict[int, list[SeedScene]] = {}

    def scene(self, number: int) -> SeedScene:
        """Return scene *number*.

        Raises:
            SceneError: the traffic never has a usable target.
        """
        stretch, index = divmod(number, self._run.options.scene.scenes_per_warmup)
        if stretch not in self._stretches:
            self._stretches[stretch] = self._run.scene_batch(stretch)
        scenes = self._stretches[stretch]
        return scenes[index % len(scenes)]


class Sources:
    """All nets and targets of an environment; nets are read at once, scenes when they are drawn.

    Raises:
        InputError: a net or target cannot be used.
    """

    def __init__(self, options: AdversaryOptions) -> None:
        self._options = options
        self._runs = [[self._prepare(net, target) for target in options.targets] for net in options.nets]
        self._scenes = [StretchCache(runs[0]) for runs in self._runs]

    def _prepare(self, net: str, target: str) -> Run:
        options = self._options
        return Run.prepare(
            RunOptions(
                net=net,
                target=target,
                seed=options.scene_seed,
                horizon_s=options.horizon_s,
                scene=options.scene,
            )
        )

    def draw(self, policy: TrafficPolicy, rng: np.random.Generator) -> Episode:
        """Return an episode with *policy* in the background.

        No other simulation may be running, as one is needed to make a scene drawn for the first time.

        Raises:
            SceneError: the traffic never has a usable target.
        """
        net = int(rng.integers(len(self._runs)))
        run = self._runs[net][int(rng.integers(len(self._runs[net])))]
        number = int(rng.integers(self._options.scenes))
        seed = SeedTree(int(rng.integers(2**31))).child("adversary")
        scene = self._scenes[net].scene(number)
        episode = run.episode(number, scene)
        return replace(episode, policy=policy, names=(episode.names[0], "adv-rl"), seed=seed)
