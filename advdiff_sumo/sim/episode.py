"""One closed-loop episode: look, plan, move, step, record."""

from __future__ import annotations

import tempfile
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from advdiff_sumo.core.errors import EpisodeFailure
from advdiff_sumo.core.record import EndReason, EpisodeRecord, Failure
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.planner_protocol import Target
from advdiff_sumo.sim.episode_loop import Loop
from advdiff_sumo.sim.seed_scene import SavedTraffic, SeedScene
from advdiff_sumo.sim.session import Session
from advdiff_sumo.sim.sim_options import SimOptions
from advdiff_sumo.sim.start import prepare
from advdiff_sumo.traffic.policy_protocol import TrafficPolicy


@dataclass(frozen=True)
class Timing:
    """Wall-clock of one episode; kept apart from the record, which is the same on every machine.

    Attributes:
        wall_s: whole episode, the start included.
        target_plans_s: each plan of a Python planner.
        background_plans_s: each plan of the policy.
    """

    wall_s: float
    target_plans_s: tuple[float, ...] = ()
    background_plans_s: tuple[float, ...] = ()


@dataclass(frozen=True)
class Episode:
    """Everything that one episode is made of.

    Attributes:
        number: in its run.
        scene: where it starts.
        road: the map.
        target: what drives the tested vehicle.
        policy: what moves the background.
        names: of target and background, for messages.
        sim: steps and radii.
        horizon_s: longest duration.
        seed: the episode's node of the seed tree.
        gui: open sumo-gui.
    """

    number: int
    scene: SeedScene
    road: RoadMap
    target: Target
    policy: TrafficPolicy
    names: tuple[str, str]
    sim: SimOptions
    horizon_s: float
    seed: SeedTree
    gui: bool = field(default=False)

    def run(self) -> tuple[EpisodeRecord, Timing]:
        """Run it; a failure of SUMO, planner or policy is part of the record, not an exception.

        Raises:
            InputError: an option cannot be used with this scene.
        """
        begun = time.perf_counter()
        failure: Failure | None = None
        with self.opened() as loop:
            try:
                loop.start()
                end = loop.run(self.steps)
            except EpisodeFailure as error:
                end, failure = (
                    EndReason.FAILED,
                    Failure(error.kind, str(error), loop.time_s, _trace(error)),
                )
            record = loop.record(end, failure)
        timing = Timing(time.perf_counter() - begun, *loop.planning_s())
        return record, timing

    @contextmanager
    def opened(self) -> Iterator[Loop]:
        """Yield the loop with SUMO running, not started yet; ``run`` on it goes on from where it stands.

        Raises:
            InputError: an option cannot be used with this scene.
            SimulationError: SUMO does not start, or a simulation is running in this process.
        """
        with tempfile.TemporaryDirectory(prefix="advdiff-") as folder:
            preparation = prepare(self.scene, self.target, self.sim, Path(folder), self.gui)
            with Session(preparation.options) as session:
                yield Loop(self, session, preparation.type_of_class)

    @property
    def steps(self) -> int:
        """SUMO steps that it lasts at most."""
        longest = self.horizon_s
        if not isinstance(self.scene.start, SavedTraffic) or getattr(self.policy, "everywhere", False):
            longest = min(longest, self.scene.horizon_s)
        return round(longest / self.sim.step_s)


def _trace(error: EpisodeFailure) -> str:
    """Return where the planner or policy raised; "" when the failure was found by ourselves."""
    cause = error.__cause__
    return "".join(traceback.format_exception(cause)) if cause is not None else ""
