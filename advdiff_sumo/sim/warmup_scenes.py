"""Seed scenes out of natural SUMO traffic: warm up, choose a target with traffic around it, save the state."""

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
from advdiff_sumo.sim.target_choice import TargetChoice, remaining_route
from advdiff_sumo.sim.world import Frame, World, read, register, stack

_GENERATORS, _DRAWS = re.compile(rb"<rngState [^>]*>"), re.compile(rb'([\w.]+)="(\d+)"')
_UNKNOWN = "is not known"  # SUMO's words of a type, route or stop
_PATIENCE = 40  # looks at the traffic without a usable target before giving up


@dataclass(frozen=True)
class _SceneChoice:
    """A moment at which an episode may start."""

    frame: int
    time_s: float
    target: int
    routes: dict[str, tuple[str, ...]]
    state_xml: bytes


@dataclass(frozen=True)
class NaturalTraffic:
    """A source of seed scenes on one net.

    Attributes:
        road: the net.
        demand: the user's, or None to generate some.
        scene: what makes a scene usable.
        sim: steps and radii.
        horizon_s: how long the log of a scene must be.
        seed: the source's node of the seed tree.
    """

    road: RoadMap
    demand: DemandFiles | None
    scene: SceneOptions
    sim: SimOptions
    horizon_s: float
    seed: SeedTree

    def batch(self, number: int, wanted: int | None = None) -> list[SeedScene]:
        """Return the scenes of one stretch of traffic; the same number, the same scenes.

        Args:
            number: of the stretch.
            wanted: the first so many of ``scenes_per_warmup``, without the traffic that the others take; None: all.

        Raises:
            SceneError: the traffic never has a usable target.
        """
        seed = self.seed.child("natural", number)
        with tempfile.TemporaryDirectory(prefix="advdiff-") as folder:
            files = self.demand or self._generate(seed, Path(folder))
            try:
                return self._run(number, seed, files, Path(folder), wanted or self.scene.scenes_per_warmup)
            except SimulationError as error:
                problem = f"no natural traffic could be made: {error}{self._remedy(error)}"
                raise SceneError(f"{self._culprit(error)}: {problem}") from error

    def _culprit(self, error: SimulationError) -> Path:
        """Return the file that SUMO complains of, as far as its words tell: it names vehicles and no files."""
        if self.demand is None:
            return self.road.path
        named = file_that_names(re.findall("'([^']*)'", str(error)), self.demand.files)
        return named or self.demand.files[0]

    def _remedy(self, error: SimulationError) -> str:
        """Return what a user can do about their own demand, as the end of a sentence."""
        if self.demand is None:
            return ""
        if _UNKNOWN in str(error):
            return "; define it in this file, or give a .sumocfg that names the file with it before this one"
        return "; correct the demand, or give other demand"

    def _generate(self, seed: SeedTree, folder: Path) -> DemandFiles:
        duration = (
            self.scene.warmup_s
            + self.horizon_s
            + self.scene.spacing_s * (self.scene.scenes_per_warmup + _PATIENCE)
        )
        path = write_demand(self.road, self.scene, duration, seed.child("demand"), folder / "demand.rou.xml")
        return DemandFiles((path,), (), 0.0)

    def _run(
        self, number: int, seed: SeedTree, files: DemandFiles, folder: Path, wanted: int
    ) -> list[SeedScene]:
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
            stretch = _Stretch(session, self.sim, folder, self.road.beyond_rim)
            candidates = list(self._look(stretch, seed.child("target").generator(), wanted))
            stretch.advance(self.horizon_s)
        routes, extra = ([content_of(f) for f in group] for group in (files.routes, files.additional))
        return [
            self._scene(
                number, k, stretch, f, SavedTraffic(f.state_xml, f.time_s, tuple(routes), tuple(extra))
            )
            for k, f in enumerate(candidates)
        ]

    def _look(self, stretch: _Stretch, rng: np.random.Generator, wanted: int) -> Iterator[_SceneChoice]:
        stretch.skip(max(self.scene.warmup_s - self.sim.history_s, 0.0))
        stretch.advance(self.sim.history_s)
        sought = TargetChoice(self.road, self.scene, self.sim)
        count = tries = 0
        while True:
            target = sought.choose(stretch.session.api, stretch.world, stretch.frames, rng)
            if target is None:
                tries += 1
                if tries > _PATIENCE:
                    raise SceneError(self._no_target(sought, stretch.session))
            else:
                count, tries = count + 1, 0
                yield stretch.save(target)
                if count == wanted:
                    return
            stretch.advance(self.scene.spacing_s)

    def _no_target(self, sought: TargetChoice, session: Session) -> str:
        """Return a sentence on what no vehicle of the traffic was, and what helps."""
        own, spent_s = self.demand is not None, session.time_s - session.options.begin_s
        files = self.road.path if self.demand is None else ", ".join(map(str, self.demand.files))
        return f"{files}: no vehicle {sought.wanted} in {spent_s:g} s of traffic; {sought.advice(own)}"

    def _scene(
        self, number: int, k: int, stretch: _Stretch, choice: _SceneChoice, start: SavedTraffic
    ) -> SeedScene:
        sub, last = self.sim.substeps, choice.frame
        first = last - sub * (self.sim.history_steps - 1)
        stop = last + round(self.horizon_s / self.sim.step_s) + 1
        frames = stretch.frames
        rows = _near(frames[last:stop], choice.target, self.sim.record_radius_m)
        now = rows[np.flatnonzero(frames[last].present[rows[rows < len(frames[last].controller)]])]
        history, _ = stack(
            stretch.world, frames[first : last + 1 : sub], now, -self.sim.history_s, self.sim.model_step_s
        )
        log, _ = stack(stretch.world, frames[last:stop], rows, 0.0, self.sim.step_s)
        return SeedScene(
            name=f"{self.road.name}-{number:03d}-{k:02d}",
            net=self.road.path,
            seed=stretch.session.options.seed,
            history=history,
            target=stretch.world.ids[choice.target],
            routes=choice.routes,
            log=log,
            start=start,
            horizon_s=self.horizon_s,
        )


class _Stretch:
    """Natural traffic that is being recorded."""

    def __init__(self, session: Session, sim: SimOptions, folder: Path, beyond_rim: Collection[str]) -> None:
        self.session, self.sim = session, sim
        self.world = World(256, beyond_rim)
        self.frames: list[Frame] = []
        self._file = folder / "state.xml"
        self._begin_xml = self._state_xml()

    def skip(self, seconds: float) -> None:
        """Let traffic run unrecorded."""
        for _ in range(round(seconds / self.sim.step_s)):
            self.session.step()
        register(self.world, self.session.api, self.session.api.vehicle.getIDList())
        self._record()

    def advance(self, seconds: float) -> None:
        """Let traffic run and record it."""
        for _ in range(round(seconds / self.sim.step_s)):
            self.session.step()
            register(self.world, self.session.api, self.session.api.simulation.getDepartedIDList())
            self._record()

    def save(self, target: int) -> _SceneChoice:
        """Save SUMO's state now."""
        api = self.session.api
        state_xml = with_draws_since(self._state_xml(), self._begin_xml)
        beyond = self.world.beyond_rim
        routes = {name: remaining_route(api, name, beyond) for name in api.vehicle.getIDList()}
        return _SceneChoice(len(self.frames) - 1, self.session.time_s, target, routes, state_xml)

    def _state_xml(self) -> bytes:
        self.session.api.simulation.saveState(str(self._file))
        return self._file.read_bytes()

    def _record(self) -> None:
        self.world.remove(read(self.world, self.session.api, ()))
        self.frames.append(self.world.frame())


def with_draws_since(state_xml: bytes, begin_xml: bytes) -> bytes:
    """Return a saved state that counts the random numbers drawn since *begin_xml* was saved.

    SUMO seeds its generators when a simulation begins, but counts their draws on from the one before in the same
    process, and skips that many when it loads the state: what follows would depend on what the process did before.
    """
    before = {name: int(count) for name, count in _draws(begin_xml)}

    def counted(attribute: re.Match[bytes]) -> bytes:
        name, count = attribute[1], int(attribute[2])
        return b'%s="%d"' % (name, count - before.get(name, 0))

    return _GENERATORS.sub(lambda element: _DRAWS.sub(counted, element[0]), state_xml, count=1)


def _draws(state_xml: bytes) -> list[tuple[bytes, bytes]]:
    element = _GENERATORS.search(state_xml)
    return [] if element is None else _DRAWS.findall(element[0])


def _near(frames: list[Frame], target: int, radius_m: float) -> IntArray:
    """Return rows that come within *radius_m* of the target in any of *frames*."""
    n = len(frames[-1].controller)
    near = np.zeros(n, dtype=np.bool_)
    for frame in frames[::5]:
        if frame.controller[target] == Controller.ABSENT:
            continue
        gap = np.linalg.norm(frame.xy_m - frame.xy_m[target], axis=-1)
        near[: len(gap)] |= gap < radius_m  # NaN compares as False
    return np.flatnonzero(near)
