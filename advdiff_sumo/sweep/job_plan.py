"""Plan a sweep: make all checks and compute all keys before any worker starts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from advdiff_sumo.core.errors import ConfigError, InputError, UnknownNameError
from advdiff_sumo.data import open_log
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.net_oddities import net_oddities
from advdiff_sumo.maps.shipped_nets import net_name
from advdiff_sumo.planners.planner_protocol import Target
from advdiff_sumo.planners.planner_registry import TARGETS
from advdiff_sumo.plugins import Registry
from advdiff_sumo.sim.demand_files import DemandFiles, read_demand
from advdiff_sumo.sim.run_episodes import (
    Run,
    RunOptions,
    check_together,
    left_out,
    policy_of,
    read_road,
    target_of,
)
from advdiff_sumo.sweep.attack_kinds import by_kind
from advdiff_sumo.sweep.fingerprint import cell_digest, digest, net_files, source_digest
from advdiff_sumo.sweep.spec import Case, SweepSpec
from advdiff_sumo.sweep.tasks import Batch
from advdiff_sumo.traffic.policy_registry import POLICIES


@dataclass(frozen=True)
class Job:
    """One episode.

    Attributes:
        key: digest of all that the episode depends on; in a run, its number.
        index: index in the sweep.
        cell: index of its run.
        number: number of the episode in that run.
        batch: key of the batch with its seed scene.
        scene_index: index of the scene in that batch.
        scene_key: key of the seed scene; the same for all targets and backgrounds.
    """

    key: str
    index: int
    cell: int
    number: int
    batch: str
    scene_index: int
    scene_key: str


@dataclass(frozen=True)
class SweepPlan:
    """A checked sweep.

    Attributes:
        spec: content of the sweep file.
        cells: the runs of the sweep.
        jobs: all episodes in the sweep's order.
        batches: the batches of seed scenes by key.
        junction_types: types of junction on the nets that a car can drive over.
        episode_count: number of episodes to run; in a diverse sweep fewer than there are jobs.
    """

    spec: SweepSpec
    cells: tuple[RunOptions, ...]
    jobs: tuple[Job, ...]
    batches: Mapping[str, Batch]
    junction_types: tuple[str, ...]
    episode_count: int

    @cached_property
    def by_key(self) -> Mapping[str, Job]:
        """The episodes by key."""
        return {job.key: job for job in self.jobs}

    @cached_property
    def keys(self) -> str:
        """Digest of the keys of all episodes."""
        return digest([job.key for job in self.jobs])

    def options(self, job: Job) -> RunOptions:
        """Return the options of the run that *job* belongs to."""
        return self.cells[job.cell]

    def find(self, key: str) -> Job:
        """Return the episode whose key begins with *key*.

        Raises:
            ConfigError: there is none, or more than one.
        """
        jobs = [job for job in self.jobs if job.key.startswith(key)]
        if len(jobs) != 1:
            problem = "belongs to no episode" if not jobs else f"is the beginning of {len(jobs)} keys"
            raise ConfigError(f"'{key}' {problem} of this sweep; take a key from its episodes.parquet")
        return jobs[0]


def plan_sweep(spec: SweepSpec, *, drives: bool = True, places: bool = False) -> SweepPlan:
    """Check *spec* and plan its episodes. Nets, demand and logs are read, and each target is made once.

    Args:
        spec: the requested sweep.
        drives: whether episodes are to be run. If False, no target or background is made, imported or connected to,
            except that the background of a diverse sweep is imported for its kinds of attack.
        places: whether messages about the target or background of a case begin with its place in the file, "cases.0".

    Raises:
        InputError: one of its subclasses; a sentence that names the culprit.
    """
    checks = _Check(drives, places)
    entries = tuple(spec.placed_cells())
    cells = tuple(checks.cell(*placed) for placed in (_by_kind(entries) if spec.diverse else entries))
    jobs: list[Job] = []
    batches: dict[str, Batch] = {}
    counts: dict[str, int] = {}
    for cell, options in enumerate(cells):
        source = source_digest(options, checks.demand(options))
        cell_key = cell_digest(options, source)
        if cell_key in counts:
            raise ConfigError(
                f"two entries of the sweep are the same: {options.target} with {options.background} on "
                f"{options.net}, seed {options.seed}; leave one out"
            )
        counts[cell_key] = cell
        for number in range(spec.first_episode, spec.first_episode + options.episodes):
            batch, scene_index = _batch(options, source, number, batches)
            scene_key = digest([source, "scene", number])
            key = digest([cell_key, "episode", number])
            jobs.append(Job(key, len(jobs), cell, number, batch, scene_index, scene_key))
    episode_count = sum(options.episodes for _, options in entries)
    return SweepPlan(spec, cells, tuple(jobs), batches, car_junctions(checks.roads), episode_count)


def plan_run(run: Run) -> SweepPlan:
    """Plan a run as a sweep of one cell; the keys of its episodes are their numbers."""
    options = RunOptions.model_validate(run.settings["options"])
    source = _source_of(run, options)
    batches: dict[str, Batch] = {}
    jobs: list[Job] = []
    for number in range(options.episodes):
        batch, scene_index = _batch(options, source, number, batches)
        scene_key = digest([source, "scene", number])
        jobs.append(Job(run_key(number), number, 0, number, batch, scene_index, scene_key))
    case_values = options.model_dump(exclude={"horizon_s", "sim", "scene"})
    spec = SweepSpec(
        episodes=options.episodes,
        horizon_s=options.horizon_s,
        seeds=(options.seed,),
        sim=options.sim,
        scene=options.scene,
        cases=(Case(**case_values),),
    )
    return SweepPlan(spec, (options,), tuple(jobs), batches, car_junctions([run.road]), len(jobs))


def _by_kind(cells: Iterable[tuple[str, RunOptions]]) -> list[tuple[str, RunOptions]]:
    """Return *cells*, each with its place in the file, once for every kind of attack.

    Raises:
        ConfigError: no background has more than one kind.
    """
    variants_by_cell = [[(place, kind) for kind in by_kind(cell)] for place, cell in cells]
    if all(len(variants) == 1 for variants in variants_by_cell):
        raise ConfigError(
            "a diverse sweep chooses among kinds of attack, and no background here has several; "
            "take scripted or diffusion without the option attack, or leave --diverse out"
        )
    return [cell for variants in variants_by_cell for cell in variants]


def run_key(number: int) -> str:
    """Return the key of episode *number* of a run."""
    return f"{number:06d}"


def run_inputs(run: Run) -> str:
    """Return the digest of all that the episodes of a run depend on, including the contents of files."""
    options = RunOptions.model_validate(run.settings["options"])
    return cell_digest(options, _source_of(run, options))


def _source_of(run: Run, options: RunOptions) -> str:
    """Return the digest of all that the seed scenes of *run* depend on."""
    return source_digest(options, run.demand)


def _batch(options: RunOptions, source: str, number: int, batches: dict[str, Batch]) -> tuple[str, int]:
    """Return the key of the batch with seed scene *number*, and the scene's index in it; extend *batches* if needed."""
    stretch, scene_index = (0, number) if options.scenes else divmod(number, options.scene.scenes_per_warmup)
    key = digest([source, "batch", stretch])
    if key not in batches or batches[key].scenes <= scene_index:
        batches[key] = Batch(key, options, stretch, scene_index + 1)
    return key, scene_index


def car_junctions(roads: Iterable[RoadMap]) -> tuple[str, ...]:
    """Return the types of junction on *roads* that a car can drive over."""
    kinds = (junction.type for road in roads for junction in road.junctions.values())
    return tuple(sorted(set(kinds) - {"dead_end", "internal"}))


class _Check:
    """Checks each net, target and background once, no matter how many runs share it."""

    def __init__(self, drives: bool, places: bool) -> None:
        self._drives, self._places = drives, places
        self._roads: dict[str, RoadMap] = {}
        self._checked: dict[str, Any] = {}
        self._demands: dict[tuple[str, str], DemandFiles] = {}

    def cell(self, where: str, options: RunOptions) -> RunOptions:
        """Return *options* in canonical form: names as registered, files with full paths.

        Raises:
            InputError: one of its subclasses; a sentence that names the culprit.
        """
        if self._drives:
            try:
                self._check_drivers(options)
            except (ConfigError, UnknownNameError) as error:
                if not (self._places and where):
                    raise
                raise ConfigError(f"{where}: {error}") from error
        if options.net not in self._roads:
            self._roads[options.net] = read_road(options.net)
        if options.scenes:
            self._once(["log", options.scenes], lambda opts: open_log(Path(opts.scenes)), options)
        canonical: dict[str, Any] = {
            "net": net_name(options.net),
            "target": self._registered(TARGETS, options.target),
            "background": self._registered(POLICIES, options.background),
            **{
                name: str(Path(getattr(options, name)).resolve())
                for name in ("demand", "scenes")
                if getattr(options, name)
            },
        }
        result = options.model_copy(update=canonical)
        self._roads[result.net] = self._roads[options.net]
        return result

    def _check_drivers(self, options: RunOptions) -> None:
        """Check target and background, each by itself and both together."""
        target: Target = self._once(["target", options.target, options.target_options], target_of, options)
        self._once(["background", options.background, options.background_options], policy_of, options)
        check_together(options, target)

    def _registered(self, registry: Registry, name: str) -> str:
        """Return the registered form of *name*; an unknown name is an error only if episodes are to be run."""
        try:
            return registry.canonical(name)
        except InputError:
            if self._drives:
                raise
            return name

    def demand(self, options: RunOptions) -> DemandFiles | None:
        """Return the demand files of *options*, checked against the net once; None without demand."""
        key = (options.net, options.demand)
        if options.demand and key not in self._demands:
            self._demands[key] = read_demand(Path(options.demand), self._roads[options.net])
        return self._demands.get(key)

    @property
    def roads(self) -> Iterable[RoadMap]:
        """The nets."""
        return self._roads.values()

    def _once(self, content: list[Any], make: Callable[[RunOptions], Any], options: RunOptions) -> Any:
        """Call *make* for the first *options* with this content; return the target, or None for anything else."""
        key = digest(content)
        if key not in self._checked:
            checked = make(options)
            self._checked[key] = checked if content[0] == "target" else None
        return self._checked[key]


def sweep_notes(plan: SweepPlan) -> Iterator[str]:
    """Yield sentences on oddities of the nets, and on parts of logs and demand that are left out, each once.

    Raises:
        InputError: a log cannot be read.
    """
    road_of = cache(read_road)  # a net may have several logs and demands
    for net in dict.fromkeys(cell.net for cell in plan.cells):
        yield from net_oddities(road_of(net))
    sources = {
        (cell.net, cell.demand, cell.scenes): cell for cell in plan.cells if cell.demand or cell.scenes
    }
    for (net, demand, scenes), options in sources.items():
        road = road_of(net)
        files = read_demand(Path(demand), road) if demand else None
        yield from left_out(options, road, files, open_log(Path(scenes)) if scenes else None)


def needed_nets(plan: SweepPlan) -> tuple[Path, ...]:
    """Return the net files of a sweep and their drivable areas, for workers on other machines."""
    names = dict.fromkeys(options.net for options in plan.cells)
    return tuple(path for name in names for path in net_files(name))
