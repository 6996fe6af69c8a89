"""Read a sweep file: a grid of nets, targets and backgrounds, a list of cases, or both."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, TypeVar

from pydantic import Field, field_validator

from advdiff_sumo.config import Options, OwnOptions, Seed, Variants, read_toml
from advdiff_sumo.core.errors import AdvdiffError, ConfigError
from advdiff_sumo.maps.shipped_nets import net_name
from advdiff_sumo.sim.run_episodes import RunOptions
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions, Situation


class Choice(Options):
    """One target or background of the grid, or several that differ in their options only.

    Attributes:
        name: name as for ``--target`` or ``--background``.
        options: options common to all.
        vary: option → values to try; all combinations are tried.
    """

    name: str
    options: OwnOptions = Field(default_factory=dict)
    vary: Variants = Field(default_factory=dict)

    def combinations(self, where: str) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield the name with each combination of options.

        Raises:
            ConfigError: an option has no value, or is also in ``options``.
        """
        for key, values in self.vary.items():
            if not values:
                raise ConfigError(f"{where}.vary.{key} is empty; give it a value or leave it out")
            if key in self.options:
                raise ConfigError(f"{where}: '{key}' stands in options and in vary; leave one out")
        for values in product(*self.vary.values()):
            yield self.name, {**self.options, **dict(zip(self.vary, values, strict=True))}


class NetChoice(Options):
    """A source of seed scenes.

    Attributes:
        net: file of a SUMO net, or name of a shipped one.
        demand: route file or SUMO configuration; empty: generated traffic.
        scenes: root folder of a driving log; empty: scenes from SUMO traffic.
    """

    net: str
    demand: str = ""
    scenes: str = ""


class Grid(Options):
    """Every combination of net, situation, target and background.

    Attributes:
        nets: names, files, or tables with ``net``, ``demand`` and ``scenes``.
        situations: values of ``scene.situation``; empty: that of the sweep's ``scene``.
        targets: drivers of the target.
        backgrounds: drivers of the background vehicles.
    """

    nets: tuple[NetChoice, ...] = (NetChoice(net="downtown"),)
    situations: tuple[Situation, ...] = ()
    targets: tuple[Choice, ...] = ()
    backgrounds: tuple[Choice, ...] = ()

    @field_validator("nets", mode="before")
    @classmethod
    def _plain_nets(cls, value: Any) -> Any:
        return [{"net": v} if isinstance(v, str) else v for v in value] if isinstance(value, list) else value

    @field_validator("targets", "backgrounds", mode="before")
    @classmethod
    def _plain_names(cls, value: Any) -> Any:
        return [{"name": v} if isinstance(v, str) else v for v in value] if isinstance(value, list) else value


class Case(Options):
    """One entry of the list: the options of ``advdiff-sumo run``; missing ones are taken from the sweep.

    Attributes are those of :class:`~advdiff_sumo.sim.run_episodes.RunOptions`. Missing options of ``scene`` are
    taken from the sweep, too.
    """

    net: str = "downtown"
    target: str = "IDM"
    target_options: OwnOptions = Field(default_factory=dict)
    background: str = "sumo"
    background_options: OwnOptions = Field(default_factory=dict)
    demand: str = ""
    scenes: str = ""
    seed: Seed | None = None
    episodes: int | None = Field(None, ge=1)
    scene: dict[str, Any] | None = None


_Entry = TypeVar("_Entry", NetChoice, Case)


class SweepSpec(Options):
    """Content of a sweep file.

    Attributes:
        episodes: seed scenes for each net and seed.
        first_episode: number of the first of them; earlier ones are left out.
        horizon_s: longest duration of an episode.
        seeds: root seeds.
        sim: time steps and radii.
        scene: choice of seed scenes.
        grid: all combinations are tried.
        cases: tried as they are.
        diverse: whether the episodes are chosen in rounds, for kinds of encounter that have not occurred yet.
    """

    episodes: int = Field(10, ge=1)
    first_episode: int = Field(0, ge=0)
    horizon_s: float = Field(20.0, gt=0.0, le=3600.0)
    seeds: tuple[Seed, ...] = (0,)
    sim: SimOptions = SimOptions()
    scene: SceneOptions = SceneOptions()
    grid: Grid | None = None
    cases: tuple[Case, ...] = ()
    diverse: bool = False

    @staticmethod
    def read(path: Path) -> SweepSpec:
        """Read a sweep file.

        Raises:
            FileError: the file is missing or no TOML.
            ConfigError: a key is misspelt, a value impossible, or no episode is requested.
        """
        content = read_toml(path)
        if content.keys() >= {"run", "options"}:
            raise ConfigError(
                f"{path}: is the file of a run; repeat it with advdiff-sumo run --config {path}"
            )
        values = content.get("sweep", content)  # sweep.toml in a sweep's folder has it in a table
        return SweepSpec.of(values if isinstance(values, dict) else content, str(path))

    @staticmethod
    def of(values: Mapping[str, Any], where: str) -> SweepSpec:
        """Check *values*; messages begin with *where* they come from."""
        spec = SweepSpec.parse(values, where)
        try:
            cells = list(spec.placed_cells())
        except AdvdiffError as error:
            raise ConfigError(f"{where}: {error}") from None
        if not cells:
            raise ConfigError(f"{where}: asks for no episode; add a [grid] or [[cases]]")
        return spec._absolute()

    def with_targets(self, names: Sequence[str]) -> SweepSpec:
        """Return the same sweep of the targets *names*, with default options, in place of those that it names."""
        grid = self.grid
        if grid is not None:
            grid = grid.model_copy(
                update={"targets": tuple(Choice(name=name) for name in dict.fromkeys(names))}
            )
        cases: list[Case] = []
        for case, name in product(self.cases, dict.fromkeys(names)):
            of_target = case.model_copy(update={"target": name, "target_options": {}})
            if of_target not in cases:  # else two cases differ in their targets only
                cases.append(of_target)
        return self.model_copy(update={"grid": grid, "cases": tuple(cases)})

    def _absolute(self) -> SweepSpec:
        """Return the same spec with full paths, so that it does not depend on the working folder."""
        grid = self.grid
        if grid is not None:
            grid = grid.model_copy(update={"nets": tuple(_absolute(net) for net in grid.nets)})
        return self.model_copy(update={"grid": grid, "cases": tuple(_absolute(case) for case in self.cases)})

    def cells(self) -> Iterator[RunOptions]:
        """Yield the runs of the sweep, the grid's first.

        Raises:
            ConfigError: a part of the grid is empty, or an option of a case is impossible.
        """
        return (options for _, options in self.placed_cells())

    def placed_cells(self) -> Iterator[tuple[str, RunOptions]]:
        """Yield the runs of the sweep, each after its place in the file: "cases.0", …, or "" for the grid."""
        if not self.seeds:
            raise ConfigError("seeds is empty; give at least one, such as seeds = [0]")
        if self.grid is not None:
            yield from self._grid_cells(self.grid)
        for number, case in enumerate(self.cases):
            where = f"cases.{number}"
            values = case.model_dump(exclude={"seed", "episodes", "scene"})
            values["scene"] = self._scene_of(case, where)
            for seed in self.seeds if case.seed is None else (case.seed,):
                yield where, self._cell(where, seed, case.episodes or self.episodes, values)

    def _grid_cells(self, grid: Grid) -> Iterator[tuple[str, RunOptions]]:
        """Yield the runs of *grid*, each after an empty place."""
        for name in ("nets", "targets", "backgrounds"):
            if not getattr(grid, name):
                raise ConfigError(f"the grid is empty: grid.{name} has no entry; name at least one")
        targets = list(_combinations(grid.targets, "grid.targets"))
        backgrounds = list(_combinations(grid.backgrounds, "grid.backgrounds"))
        places = product(grid.nets, self._scenes_of(grid), self.seeds)
        for (net, scene, seed), target, background in product(places, targets, backgrounds):
            values = {
                **net.model_dump(),
                "target": target[0],
                "target_options": target[1],
                "background": background[0],
                "background_options": background[1],
                "scene": scene,
            }
            yield "", self._cell("grid", seed, self.episodes, values)

    def _scenes_of(self, grid: Grid) -> list[SceneOptions]:
        """Return how the seed scenes of *grid* are found: once for each of its situations."""
        if grid.situations and self.scene.situation != "any":
            raise ConfigError("scene.situation stands beside grid.situations; leave one out")
        if len(set(grid.situations)) < len(grid.situations):
            raise ConfigError("grid.situations names a situation twice; leave one out")
        situations = grid.situations or (self.scene.situation,)
        return [self.scene.model_copy(update={"situation": situation}) for situation in situations]

    def _cell(self, where: str, seed: int, episodes: int, values: Mapping[str, Any]) -> RunOptions:
        shared = {"seed": seed, "episodes": episodes, "horizon_s": self.horizon_s, "sim": self.sim}
        return RunOptions.parse({**values, **shared}, where)

    def _scene_of(self, case: Case, where: str) -> SceneOptions:
        if case.scene is None:
            return self.scene
        return SceneOptions.parse({**self.scene.model_dump(), **case.scene}, f"{where}.scene")


def _absolute(entry: _Entry) -> _Entry:
    """Return *entry* with full paths."""
    files = {name: getattr(entry, name) for name in ("demand", "scenes")}
    paths = {name: str(Path(file).resolve()) for name, file in files.items() if file}
    return entry.model_copy(update={"net": net_name(entry.net), **paths})


def _combinations(choices: Sequence[Choice], where: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the name and options of each combination of *choices*."""
    for k, choice in enumerate(choices):
        yield from choice.combinations(f"{where}.{k}")
