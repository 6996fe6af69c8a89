"""Record traffic that a trained model drives for a while, and then SUMO's drivers: data aggregation.

A model trained on recordings alone never sees the situations into which its own errors lead. Here it first drives
itself. SUMO's drivers then take over and show the right response (DAgger, Ross et al. 2011, arXiv:1011.0686, with SUMO
as the expert).
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from advdiff_sumo.core.errors import EpisodeFailure
from advdiff_sumo.core.record import Controller
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.core.whole_file import sha256_of
from advdiff_sumo.data.window_files import DT_S, FUTURE
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.shipped_weights import find_weights
from advdiff_sumo.planners.planner_protocol import SumoDriver
from advdiff_sumo.sim.demand_files import DemandFiles
from advdiff_sumo.sim.episode import Episode
from advdiff_sumo.sim.episode_loop import Loop
from advdiff_sumo.sim.plan_memo import PlanSource
from advdiff_sumo.sim.seed_scene import SeedScene
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sim.training_windows.mixed_demand import write_mixed_demand
from advdiff_sumo.sim.training_windows.simulation_run import WARMUP_S, Recording
from advdiff_sumo.sim.warmup_scenes import NaturalTraffic
from advdiff_sumo.sim.world import stack
from advdiff_sumo.traffic.policy_protocol import TrafficPolicy
from advdiff_sumo.traffic.sumo_traffic import SumoTraffic

_EPISODE_S = 70.0
_MODEL_TURN_S = (3.0, 25.0)  # shortest and longest turn of the model
_WINDOW_STEPS = (0, 2, 4)  # model steps after the hand-over at which windows are cut
_SIM = SimOptions(stop_at_collision=False, record_plans=0, record_natural=False)
_SCENE = SceneOptions(
    warmup_s=WARMUP_S, min_route_m=250.0, min_speed_mps=0.0, spacing_s=8.0, scenes_per_warmup=2
)


@dataclass(frozen=True)
class DrivingModel:
    """A trained model that drives the traffic.

    Attributes:
        weights: file of its networks.
        digest: sha256 of that file.
    """

    weights: Path
    digest: str

    @staticmethod
    def read(weights: str) -> DrivingModel:
        """Return the model of *weights*, a path or a shipped name.

        Raises:
            WeightsError: the file is missing, damaged, or contains other networks.
        """
        path = find_weights(weights)
        _policy(str(path))  # raises if the networks cannot drive
        return DrivingModel(path, sha256_of(path))

    def policy(self) -> TrafficPolicy:
        """Return the model as a background without a guide; the networks are read once per process.

        Raises:
            WeightsError: the file is missing, damaged, or contains other networks.
        """
        return _policy(str(self.weights))


@lru_cache(maxsize=1)
def _policy(weights: str) -> TrafficPolicy:
    # imports PyTorch, which traffic of SUMO alone does not need
    from advdiff_sumo.traffic.diffusion.diffusion_policy import DiffusionTraffic

    return DiffusionTraffic(guide="none", weights=weights, device="cpu")


def record_handbacks(road: RoadMap, seed: SeedTree, model: DrivingModel) -> Iterator[Recording]:
    """Yield stretches of traffic on *road* that *model* and SUMO drive in turn; *seed* decides everything.

    The model moves the vehicles around one vehicle for 3 to 25 s, then SUMO's drivers move them for 8 s, and so on for
    70 s.

    Raises:
        SceneError: no vehicle ever has others around it.
        SimulationError: SUMO refused the net or stopped.
        NetError: the net has no route.
    """
    with tempfile.TemporaryDirectory(prefix="advdiff-") as folder:
        path = Path(folder) / "demand.rou.xml"
        duration_s = _SCENE.warmup_s + _SCENE.scenes_per_warmup * _SCENE.spacing_s + _EPISODE_S
        write_mixed_demand(road, duration_s, seed.child("demand"), path, stops=False)
        files = DemandFiles((path,), (), 0.0)
        scenes = NaturalTraffic(road, files, _SCENE, _SIM, DT_S, seed).batch(0)
    for number, scene in enumerate(scenes):
        yield drive_in_turn(road, scene, seed.child("handback", number), model.policy())


def drive_in_turn(
    road: RoadMap,
    scene: SeedScene,
    seed: SeedTree,
    policy: TrafficPolicy,
    duration_s: float = _EPISODE_S,
    spans_s: tuple[float, float] = _MODEL_TURN_S,
) -> Recording:
    """Return traffic around the target of *scene* that *policy* and SUMO's drivers drive in turn.

    Args:
        road: the map.
        scene: where it begins.
        seed: of all random numbers.
        policy: drives first.
        duration_s: no turn of the policy begins later.
        spans_s: shortest and longest turn of the policy.
    """
    target, names = SumoDriver("IDM"), ("IDM", "a model")
    episode = Episode(0, scene, road, target, policy, names, _SIM, duration_s, seed)
    rng = seed.child("spans").generator()
    handbacks = list[int]()
    with episode.opened() as loop:
        try:
            loop.start()
            while loop.time_s < duration_s and _drive_both(loop, policy, _turn_s(rng, *spans_s), handbacks):
                pass
        except EpisodeFailure:
            pass  # the recording until then is usable
        return recording_of(loop, handbacks)


def _turn_s(rng: np.random.Generator, least_s: float, most_s: float) -> float:
    """Return a random duration of the policy's turn, uniform in its logarithm."""
    return float(np.exp(rng.uniform(np.log(least_s), np.log(most_s))))


def _drive_both(loop: Loop, policy: TrafficPolicy, span_s: float, handbacks: list[int]) -> bool:
    """Let *policy* drive for *span_s* and then SUMO, and append the instant between to *handbacks*.

    Return whether the episode can continue.
    """
    for driver, seconds in ((policy, span_s), (SumoTraffic(), DT_S * (FUTURE + max(_WINDOW_STEPS)))):
        loop.background.source = PlanSource(driver)
        loop.background.start(loop.scene_now())
        end_step = loop.steps + round(seconds / DT_S) * loop.sim.substeps
        loop.run(end_step)
        if loop.steps < end_step:
            return False
        if driver is policy:
            handbacks.append(len(loop.recorder.model_frames) - 1)
    return True


def recording_of(loop: Loop, handbacks: Sequence[int]) -> Recording:
    """Return the recording of *loop*, with windows from where SUMO's drivers take over, and futures while they drive.

    Args:
        loop: of an episode that has ended or failed.
        handbacks: instants at which SUMO's drivers take over.
    """
    frames, sim = loop.recorder.model_frames, loop.sim
    tracks, controller = stack(loop.world, frames, np.arange(len(loop.world)), 0.0, DT_S)
    focal = np.zeros_like(tracks.valid)
    for handback in handbacks:
        later = [handback + steps for steps in _WINDOW_STEPS if handback + steps < len(frames)]
        focal[:, later] = (controller[:, handback] == Controller.POLICY)[:, None]
    past_steps = sim.history_steps - 1
    signals = [loop.recorder.signals[max(k - past_steps, 0) * sim.substeps] for k in range(len(frames))]
    instants = tuple(
        start + k for start in handbacks for k in _WINDOW_STEPS if start + k + FUTURE < len(frames)
    )
    parked = np.zeros(tracks.agents, dtype=np.bool_)
    return Recording(
        tracks, parked, tuple(signals), instants, focal & tracks.valid, controller == Controller.SUMO
    )
