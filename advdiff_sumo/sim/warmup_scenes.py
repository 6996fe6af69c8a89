"""Make seed scenes from natural SUMO traffic: warm up, choose a target, save SUMO's state."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from advdiff_sumo.core.arrays import IntArray
from advdiff_sumo.core.errors import SceneError, SimulationError
from advdiff_sumo.core.record import Controller
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.demand import write_demand
from advdiff_sumo.sim.demand_check import file_that_names
from advdiff_sumo.sim.demand_files import DemandFiles
from advdiff_sumo.sim.demand_xml import content_of
from advdiff_sumo.sim.seed_scene import SavedTraffic, SeedScene
from advdiff_sumo.sim.session import Session, SessionOptions
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sim.situations import SHORT_LIVED_S
from advdiff_sumo.sim.target_choice import TargetChoice
from advdiff_sumo.sim.target_route import remaining_route
from advdiff_sumo.sim.world import Frame, World, read, register, stack

_RNG_ELEMENT, _DRAW_COUNT = re.compile(rb"<rngState [^>]*>"), re.compile(rb'([\w.]+)="(\d+)"')
_UNKNOWN = "is not known"  # part of SUMO's message on an unknown type, route or stop
_MAX_ATTEMPTS = 40  # consecutive choices without a usable target, ``spacing_s`` apart


@dataclass(frozen=True)
class _SceneChoice:
    """A moment at which an episode may start; *frame* is its recorded frame, *target* the target's row."""

    frame: int
    time_s: float
    target: int
    routes: dict[str, tuple[str, ...]]
    state_xml: bytes


@dataclass(frozen=True)
class NaturalTraffic:
    """Makes seed scenes from natural traffic on one net.

    Attributes:
        road: the net.
        demand: the user's; None if demand is to be generated.
        scene: requirements of a scene.
        sim: steps and radii.
        horizon_s: duration of a scene's log.
        seed: the source's node of the seed tree.
    """

    road: RoadMap
    demand: DemandFiles | None
    scene: SceneOptions
    sim: SimOptions
    horizon_s: float
    seed: SeedTree

    def batch(self, number: int, wanted: int | None = None) -> list[SeedScene]:
        """Return the scenes of stretch *number* of traffic; the same number gives the same scenes.

        Args:
            number: of the stretch.
            wanted: number of scenes to return; the rest is not simulated. None: ``scenes_per_warmup``.

        Raises:
            SceneError: the traffic never has a usable target.
        """
        seed = self.seed.child("natural", number)
        with tempfile.TemporaryDirectory(prefix="advdiff-") as folder:
            files = self.demand or self._generate(seed, Path(folder))
            try:
                return self._run(number, seed, files, Path(folder), wanted or self.scene.scenes_per_warmup)
            except SimulationError as error:
                problem = f"no natural traffic could be made: {str(error).rstrip('.')}{self._remedy(error)}"
                raise SceneError(f"{self._culprit(error)}: {problem}") from error

    def _culprit(self, error: SimulationError) -> Path:
        """Return the file to which SUMO's message belongs, as far as it is known: SUMO names vehicles and no files."""
        if self.demand is None:
            return self.road.path
        named = file_that_names(re.findall("'([^']*)'", str(error)), self.demand.files)
        return named or self.demand.files[0]

    def _remedy(self, error: SimulationError) -> str:
        """Return what users can do about their own demand, as the end of a sentence; "" for generated demand."""
        if self.demand is None:
            return ""
        if _UNKNOWN in str(error):
            return "; define it in this file, or give a .sumocfg that names the file with it before this one"
        return "; correct the demand, or give other demand"

    def _generate(self, seed: SeedTree, folder: Path) -> DemandFiles:
        """Write demand for the whole stretch, with time for all attempts to find targets."""
        duration = (
            self.scene.warmup_s
            + self.horizon_s
            + self.scene.spacing_s * (self.scene.scenes_per_warmup + _MAX_ATTEMPTS)
        )
        path = write_demand(self.road, self.scene, duration, seed.child("demand"), folder / "demand.rou.xml")
        return DemandFiles((path,), (), 0.0)

    def _run(
        self, number: int, seed: SeedTree, files: DemandFiles, folder: Path, wanted: int
    ) -> list[SeedScene]:
        """Simulate the traffic of one stretch and return its first *wanted* scenes."""
        options = SessionOptions(
            net=self.road.path,
            seed=seed.child("sumo").integer(),
            step_s=self.sim.step_s,
            lateral_resolution_m=self.sim.lateral_resolution_m,
            routes=files.routes,
            additional=files.additional,
            begin_s=files.begin_s,
        )
        with Session(options) as session:
            traffic = _RecordedTraffic(session, self.sim, folder, self.road.beyond_rim)
            choices = list(self._choices(traffic, seed.child("target").generator(), wanted))
            traffic.advance(self.horizon_s)
        routes, extra = (tuple(map(content_of, group)) for group in (files.routes, files.additional))
        return [
            self._scene(
                number, k, traffic, choice, SavedTraffic(choice.state_xml, choice.time_s, routes, extra)
            )
            for k, choice in enumerate(choices)
        ]

    def _choices(
        self, traffic: _RecordedTraffic, rng: np.random.Generator, wanted: int
    ) -> Iterator[_SceneChoice]:
        """Yield *wanted* moments with a usable target, ``spacing_s`` or more apart."""
        traffic.skip(max(self.scene.warmup_s - self.sim.history_s, 0.0))
        traffic.advance(self.sim.history_s)
        target_choice = TargetChoice(self.road, self.scene, self.sim)
        spacing_s = self.scene.spacing_s
        retry_s = min(SHORT_LIVED_S.get(self.scene.situation, spacing_s), spacing_s)
        most_attempts = round(_MAX_ATTEMPTS * spacing_s / retry_s)
        count = attempts = 0
        while True:
            target = target_choice.choose(traffic.session.api, traffic.world, traffic.frames, rng)
            if target is None:
                attempts += 1
                if attempts > most_attempts:
                    raise SceneError(self._no_target(target_choice, traffic.session))
            else:
                count, attempts = count + 1, 0
                yield traffic.save(target)
                if count == wanted:
                    return
            traffic.advance(retry_s if target is None else spacing_s)

    def _no_target(self, choice: TargetChoice, session: Session) -> str:
        """Return a sentence that says which requirement no vehicle met, and what helps."""
        is_own, spent_s = self.demand is not None, session.time_s - session.options.begin_s
        files = self.road.path if self.demand is None else ", ".join(map(str, self.demand.files))
        return f"{files}: no vehicle {choice.wanted} in {spent_s:g} s of traffic; {choice.advice(is_own)}"

    def _scene(
        self, number: int, k: int, traffic: _RecordedTraffic, choice: _SceneChoice, start: SavedTraffic
    ) -> SeedScene:
        """Return scene *k* of stretch *number*, which starts at *choice*, with its history and log."""
        sim, now = self.sim, choice.frame
        first = now - sim.substeps * (sim.history_steps - 1)
        stop = now + round(self.horizon_s / sim.step_s) + 1
        frames = traffic.frames
        rows = _rows_near_target(frames[now:stop], choice.target, sim.record_radius_m)
        rows_now = rows[np.flatnonzero(frames[now].present[rows[rows < len(frames[now].controller)]])]
        history, _ = stack(
            traffic.world, frames[first : now + 1 : sim.substeps], rows_now, -sim.history_s, sim.model_step_s
        )
        log, _ = stack(traffic.world, frames[now:stop], rows, 0.0, sim.step_s)
        return SeedScene(
            name=f"{self.road.name}-{number:03d}-{k:02d}",
            net=self.road.path,
            seed=traffic.session.options.seed,
            history=history,
            target=traffic.world.ids[choice.target],
            routes=choice.routes,
            log=log,
            start=start,
            horizon_s=self.horizon_s,
        )


class _RecordedTraffic:
    """Natural traffic whose states are recorded at every step."""

    def __init__(self, session: Session, sim: SimOptions, folder: Path, beyond_rim: Collection[str]) -> None:
        self.session, self.sim = session, sim
        self.world = World(256, beyond_rim)
        self.frames: list[Frame] = []
        self._file = folder / "state.xml"
        self._begin_xml = self._state_xml()

    def skip(self, seconds: float) -> None:
        """Let traffic run unrecorded for *seconds*, and record the instant at the end."""
        for _ in range(round(seconds / self.sim.step_s)):
            self.session.step()
        register(self.world, self.session.api, self.session.api.vehicle.getIDList())
        self._record()

    def advance(self, seconds: float) -> None:
        """Let traffic run for *seconds* and record it."""
        for _ in range(round(seconds / self.sim.step_s)):
            self.session.step()
            register(self.world, self.session.api, self.session.api.simulation.getDepartedIDList())
            self._record()

    def save(self, target: int) -> _SceneChoice:
        """Save SUMO's present state as a possible start with *target*."""
        api = self.session.api
        state_xml = with_draws_since(self._state_xml(), self._begin_xml)
        beyond_rim = self.world.beyond_rim
        routes = {name: remaining_route(api, name, beyond_rim) for name in api.vehicle.getIDList()}
        return _SceneChoice(len(self.frames) - 1, self.session.time_s, target, routes, state_xml)

    def _state_xml(self) -> bytes:
        self.session.api.simulation.saveState(str(self._file))
        return self._file.read_bytes()

    def _record(self) -> None:
        self.world.remove(read(self.world, self.session.api, ()))
        self.frames.append(self.world.frame())


def with_draws_since(state_xml: bytes, begin_xml: bytes) -> bytes:
    """Return a saved state that counts the random numbers drawn since *begin_xml* was saved.

    SUMO seeds its generators when a simulation begins. Their counts of draws, however, continue from the simulation
    before in the same process, and as many draws are skipped when the state is loaded. Uncorrected, the traffic would
    depend on what the process simulated before.
    """
    before = {name: int(count) for name, count in _draw_counts(begin_xml)}

    def since_begin(attribute: re.Match[bytes]) -> bytes:
        name, count = attribute[1], int(attribute[2])
        return b'%s="%d"' % (name, count - before.get(name, 0))

    return _RNG_ELEMENT.sub(lambda element: _DRAW_COUNT.sub(since_begin, element[0]), state_xml, count=1)


def _draw_counts(state_xml: bytes) -> list[tuple[bytes, bytes]]:
    """Return (name, count) of each random generator in a saved state."""
    element = _RNG_ELEMENT.search(state_xml)
    return [] if element is None else _DRAW_COUNT.findall(element[0])


def _rows_near_target(frames: list[Frame], target: int, radius_m: float) -> IntArray:
    """Return rows that come within *radius_m* of the target in *frames*, of which every fifth is checked."""
    n = len(frames[-1].controller)
    is_near = np.zeros(n, dtype=np.bool_)
    for frame in frames[::5]:
        if frame.controller[target] == Controller.ABSENT:
            continue
        distance = np.linalg.norm(frame.xy_m - frame.xy_m[target], axis=-1)
        is_near[: len(distance)] |= distance < radius_m  # NaN compares as False
    return np.flatnonzero(is_near)
