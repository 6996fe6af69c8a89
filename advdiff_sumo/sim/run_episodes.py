"""Define a run: episodes of one target, one background and one source of seed scenes, in one folder."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import Any, Self, TypeVar

from pydantic import Field, model_validator

from advdiff_sumo import __version__
from advdiff_sumo.config import Options, OwnOptions, Seed
from advdiff_sumo.core.errors import AdvdiffError, ConfigError, NetError
from advdiff_sumo.core.plug_in_source import described, raised_at
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.core.wording import counted
from advdiff_sumo.data import open_log
from advdiff_sumo.data.log_reader import LogReader
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.net_oddities import net_oddities
from advdiff_sumo.maps.shipped_nets import find_net, net_name
from advdiff_sumo.planners.planner_protocol import Planner, Served, SumoDriver, Target
from advdiff_sumo.planners.planner_registry import BUILTIN_PLAN_S, TARGETS, make_target, plans_briefly
from advdiff_sumo.sim.demand_check import unordered_departure
from advdiff_sumo.sim.demand_files import DemandFiles, net_of_configuration, read_demand
from advdiff_sumo.sim.episode import Episode
from advdiff_sumo.sim.logs import LoggedTraffic
from advdiff_sumo.sim.seed_scene import SeedScene
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sim.start import lane_change_model
from advdiff_sumo.sim.warmup_scenes import NaturalTraffic
from advdiff_sumo.traffic.policy_protocol import TrafficPolicy
from advdiff_sumo.traffic.policy_registry import POLICIES, make_policy

_Plugin = TypeVar("_Plugin")


class RunOptions(Options):
    """Options of ``advdiff-sumo run``, with the same names in a configuration file.

    Attributes:
        net: a SUMO net (``.net.xml``, ``.net.xml.gz``), the name of a shipped one, or a ``.sumocfg``, which also names
            its demand.
        target: what drives the tested vehicle.
        target_options: of that target.
        background: what moves the background vehicles.
        background_options: of that policy.
        episodes: how many.
        horizon_s: longest duration of an episode.
        seed: root of all random numbers.
        demand: route file or SUMO configuration; empty: traffic is generated.
        scenes: root of a driving log; empty: scenes come from SUMO traffic.
        sim: steps and radii.
        scene: how seed scenes are chosen.
    """

    net: str = "downtown"
    target: str = "IDM"
    target_options: OwnOptions = Field(default_factory=dict)
    background: str = "sumo"
    background_options: OwnOptions = Field(default_factory=dict)
    episodes: int = Field(10, ge=1)
    horizon_s: float = Field(20.0, gt=0.0, le=3600.0)
    seed: Seed = 0
    demand: str = ""
    scenes: str = ""
    sim: SimOptions = SimOptions()
    scene: SceneOptions = SceneOptions()

    @model_validator(mode="before")
    @classmethod
    def _from_configuration(cls, values: Any) -> Any:
        """Replace a ``.sumocfg`` given as net by the net that it names, and use its demand if no other is given."""
        net = values.get("net") if isinstance(values, dict) else None
        if not (isinstance(net, str) and net.endswith(".sumocfg")):
            return values
        demand = "" if values.get("scenes") else net
        return {
            **values,
            "net": str(net_of_configuration(Path(net))),
            "demand": values.get("demand") or demand,
        }

    @model_validator(mode="after")
    def _must_last_a_step(self) -> Self:
        if round(self.horizon_s / self.sim.step_s) == 0:
            raise ValueError(
                f"horizon_s = {self.horizon_s:g} is shorter than a step; give at least sim.step_s, {self.sim.step_s:g}"
            )
        return self


@dataclass(frozen=True)
class Run:
    """A checked run; making it reads the net and imports target and policy, but starts nothing.

    Attributes:
        options: as given.
        road: the net.
        target: what drives the tested vehicle.
        policy: what moves the background vehicles.
        names: of target and background, as the registries spell them.
        gui: use sumo-gui instead of libsumo; the loop is the same, but traci may differ in the last digits.
    """

    options: RunOptions
    road: RoadMap
    target: Target
    policy: TrafficPolicy
    names: tuple[str, str]
    gui: bool = False

    @staticmethod
    def prepare(options: RunOptions, gui: bool = False, planner: Planner | None = None) -> Run:
        """Check *options* and read the net.

        Args:
            options: of the run.
            gui: use sumo-gui.
            planner: the object that ``options.target`` names; None: it is made from the options.

        Raises:
            InputError: one of its kinds; the message names the culprit.
        """
        target = target_of(options) if planner is None else planner
        policy = policy_of(options)
        check_together(options, target)
        names = TARGETS.canonical(options.target), POLICIES.canonical(options.background)
        road = read_road(options.net)
        run = Run(options, road, target, policy, names, gui)
        _ = run.demand, run.log
        return run

    @cached_property
    def demand(self) -> DemandFiles | None:
        """The user's demand, checked against the net; None if traffic is generated."""
        return read_demand(Path(self.options.demand), self.road) if self.options.demand else None

    @cached_property
    def log(self) -> LogReader | None:
        """The driving log from which scenes come, if any."""
        return open_log(Path(self.options.scenes)) if self.options.scenes else None

    def notes(self) -> list[str]:
        """Return sentences on oddities of the net, and on parts of the driving log and demand that are not used."""
        return [*net_oddities(self.road), *left_out(self.options, self.road, self.demand, self.log)]

    def why_no_scene(self) -> str:
        """Return a sentence on why no episode can start, as far as known."""
        if self.log is None:
            return f"{self.road.path}: no seed scene was found"
        return f"{self.options.scenes}: the log gives no seed scene: {self._logged(self.log).why_none()}"

    def _logged(self, log: LogReader) -> LoggedTraffic:
        seed = SeedTree(self.options.seed).child("scenes")
        return LoggedTraffic(self.road, log, self.options.scene, self.options.sim, seed)

    def seed_scenes(self) -> Iterator[SeedScene]:
        """Yield seed scenes in their order; those of a log are finite, those from SUMO traffic are not.

        Raises:
            InputError: the demand or the log does not fit the net, or has no usable scene.
        """
        if self.log is not None:
            yield from self._logged(self.log).scenes()
            return
        number = 0
        while True:
            yield from self.scene_batch(number)
            number += 1

    def scene_batch(self, number: int, wanted: int | None = None) -> list[SeedScene]:
        """Return scenes of stretch *number* of SUMO traffic, or those of the driving log.

        Args:
            number: of the stretch; of no effect with a log.
            wanted: number of scenes to return, from the first on; None: ``scene.scenes_per_warmup``, or all of the log.

        Raises:
            SceneError: the traffic never has a usable target.
        """
        if self.log is not None:
            return list(islice(self._logged(self.log).scenes(), wanted))
        options = self.options
        seed = SeedTree(options.seed).child("scenes")
        source = NaturalTraffic(self.road, self.demand, options.scene, options.sim, options.horizon_s, seed)
        return source.batch(number, wanted)

    def episode(self, number: int, scene: SeedScene) -> Episode:
        """Return episode *number* of this run, which starts in *scene*."""
        return Episode(
            number=number,
            scene=scene,
            road=self.road,
            target=self.target,
            policy=self.policy,
            names=self.names,
            sim=self.options.sim,
            horizon_s=self.options.horizon_s,
            seed=SeedTree(self.options.seed).child("episode", self.road.path.name, number),
            gui=self.gui,
        )

    @cached_property
    def settings(self) -> dict[str, Any]:
        """Content of ``run.toml``: all that is needed to repeat the run."""
        options = self.options.model_dump(mode="json")
        options |= {"net": net_name(self.options.net), "target": self.names[0], "background": self.names[1]}
        for key in ("demand", "scenes"):
            if options[key]:
                options[key] = str(Path(options[key]).resolve())
        return {"run": versions(), "options": options}


def left_out(
    options: RunOptions, road: RoadMap, demand: DemandFiles | None, log: LogReader | None
) -> list[str]:
    """Return sentences on parts of the driving log and of the demand that are not used.

    Args:
        options: of the run.
        road: its net.
        demand: what ``options.demand`` names, if anything.
        log: what ``options.scenes`` names, if anything.

    Raises:
        InputError: the log cannot be read.
    """
    sentences = [] if demand is None else _left_out_of(demand)
    if log is None:
        return sentences
    logged = LoggedTraffic(road, log, options.scene, options.sim, SeedTree(options.seed))
    standing, min_speed_mps = logged.standing_starts(), options.scene.min_speed_mps
    if standing:
        reason = f"its ego is slower than {min_speed_mps:g} m/s there"
        sentences.append(f"{counted(standing, 'start')} of the log passed over, {reason} ({options.scenes})")
    return sentences


def _left_out_of(demand: DemandFiles) -> list[str]:
    """Return sentences on files of *demand* that are not used, and on departures that SUMO leaves out."""
    sentences = [f"{file} holds detectors and outputs only, and is left out" for file in demand.ignored]
    for file in demand.routes:
        if (name := unordered_departure(file)) is not None:
            problem = (
                f"'{name}' departs before one above it, so SUMO leaves it and all others out of order out"
            )
            sentences.append(f"{file}: {problem}; sort the file by departure")
    return sentences


def target_of(options: RunOptions) -> Target:
    """Return the target that *options* name.

    Raises:
        InputError: there is none of that name, its options do not fit, or it cannot be made.
    """
    name = TARGETS.canonical(options.target)
    return make_or_explain(f"target '{name}'", make_target, name, options.target_options)


def policy_of(options: RunOptions) -> TrafficPolicy:
    """Return the background policy that *options* name; errors as in :func:`target_of`."""
    name = POLICIES.canonical(options.background)
    policy_options = options.background_options
    if name == "replay":  # it plans the log's states at SUMO's steps, at least until the next plan
        period_s = max(1.0, options.sim.model_step_s * options.sim.replan_every)
        policy_options = {"step_s": options.sim.step_s, "period_s": period_s, **policy_options}
    return make_or_explain(f"background '{name}'", make_policy, name, policy_options)


def check_together(options: RunOptions, target: Target) -> None:
    """Check combinations of options, and that a remote target answers.

    Raises:
        ConfigError: two options contradict each other, or a remote target does not answer.
    """
    if isinstance(target, SumoDriver):
        lane_change_model(target, options.sim)
    _check_plan_length(options)
    if isinstance(target, Served):
        target.check()
    if options.demand and options.scenes:
        raise ConfigError("demand and scenes cannot go together: a log brings its own traffic")
    if options.scenes and options.sim.history_steps == 1:
        raise ConfigError(
            f"sim.history_s = {options.sim.history_s:g}: vehicles of a log are inserted into SUMO in the model step "
            f"before the start; set it to {options.sim.model_step_s:g} (sim.model_step_s) or more"
        )


def _check_plan_length(options: RunOptions) -> None:
    """Refuse intervals between plans that are longer than the plans of a built-in target."""
    sim = options.sim
    if sim.model_step_s * sim.replan_every > BUILTIN_PLAN_S + 1e-9 and plans_briefly(options.target):
        max_steps = max(int(BUILTIN_PLAN_S / sim.model_step_s + 1e-9), 1)
        raise ConfigError(
            f"sim.replan_every = {sim.replan_every} steps of {sim.model_step_s:g} s: target '{options.target}' plans "
            f"{BUILTIN_PLAN_S:g} s, which ends before the next plan; set sim.replan_every to {max_steps} at most"
        )


def read_road(net: str) -> RoadMap:
    """Read a net, by path or shipped name, on which a run is possible.

    Raises:
        NetError: it is missing or damaged, or has no route for cars.
    """
    road = RoadMap.read(find_net(net))
    if not any(road.edge_graph().successors.values()):
        raise NetError(road.path, "has no route that a car could drive", "give a net with connected edges")
    return road


def versions() -> dict[str, str]:
    """Return the versions on which results depend."""
    names = ("libsumo", "numpy", "shapely", "torch", "pyarrow")
    versions_of = {name: version(name) for name in names}
    return {"advdiff_sumo": __version__, "revision": git_revision(), **versions_of}


def make_or_explain(
    what: str, make: Callable[..., _Plugin], name: str, options: Mapping[str, Any]
) -> _Plugin:
    """Return ``make(name, options)``.

    Args:
        what: kind and name for messages, such as "target 'mine:Planner'".
        make: of a registry.
        name: in it.
        options: of the planner or policy.

    Raises:
        InputError: there is none of that name, its options do not fit, or it raised something while it was made.
    """
    try:
        return make(name, options)
    except AdvdiffError:
        raise
    except (Exception, SystemExit) as error:  # a user's class may raise anything, also when imported
        place = raised_at(error, None)
        raise ConfigError(f"{what} cannot be made: {described(error)}{place}; correct it") from error


def git_revision() -> str:
    """Return the revision of the checkout from which the package runs; "" for an installed package."""
    package = Path(__file__).resolve().parent.parent
    if not (package.parent / ".git").exists():  # git would find that of a project around the environment
        return ""
    try:
        done = subprocess.run(
            ["git", "-C", str(package), "rev-parse", "HEAD"],
            capture_output=True,
            text=True,
            check=False,
            timeout=10,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
