"""The run folder: finished episodes are on disk at once, tables are put together at the end."""

from __future__ import annotations

import contextlib
import shutil
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import tomli_w

from advdiff_sumo.core.errors import ConfigError, FileError
from advdiff_sumo.core.record import Controller, EpisodeRecord
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.metrics.columns import COLLISION_COLUMNS, EPISODE_COLUMNS, Column
from advdiff_sumo.sim.episode import Timing

_PARTS = "parts"
_ARROW = {"str": pa.string(), "int64": pa.int64(), "float64": pa.float64(), "bool": pa.bool_()}

STATE_COLUMNS: Mapping[str, Column] = {
    "episode": Column("int64", "", "number of the episode in its run", nullable=False),
    "step": Column("int64", "", "SUMO step since the episode's start; 0 is the seed scene", nullable=False),
    "time_s": Column("float64", "s", "time since the episode's start", nullable=False),
    "agent": Column("str", "", "name of the road user", nullable=False),
    "class": Column("str", "", "car, truck, bus, motorcycle, bicycle or pedestrian", nullable=False),
    "length_m": Column("float64", "m", "length of the box", nullable=False),
    "width_m": Column("float64", "m", "width of the box", nullable=False),
    "x_m": Column("float64", "m", "east, centre of the box, the net's frame", nullable=False),
    "y_m": Column("float64", "m", "north, centre of the box, the net's frame", nullable=False),
    "yaw_rad": Column("float64", "rad", "heading, counter-clockwise from east", nullable=False),
    "speed_mps": Column("float64", "m/s", "speed along the heading", nullable=False),
    "controller": Column("str", "", "who moved it in this step: sumo, policy or planner", nullable=False),
    "is_target": Column("bool", "", "whether it is the tested vehicle", nullable=False),
}
PLAN_COLUMNS: Mapping[str, Column] = {
    "episode": Column("int64", "", "number of the episode in its run", nullable=False),
    "made_s": Column("float64", "s", "when the plan was made, since the episode's start", nullable=False),
    "agent": Column("str", "", "whose plan: the target, or a vehicle that the policy moves", nullable=False),
    "time_s": Column("float64", "s", "when it would be there, since the episode's start", nullable=False),
    "x_m": Column("float64", "m", "east, planned centre of the box, to 1 cm", nullable=False),
    "y_m": Column("float64", "m", "north, planned centre of the box, to 1 cm", nullable=False),
}
NATURAL_COLUMNS: Mapping[str, Column] = {
    name: column for name, column in STATE_COLUMNS.items() if name != "controller"
} | {"step": Column("int64", "", "number of the instant, `sim.model_step_s` apart", nullable=False)}
SIGNAL_COLUMNS: Mapping[str, Column] = {
    "episode": Column("int64", "", "number of the episode in its run", nullable=False),
    "step": Column("int64", "", "SUMO step from which on it shows this; 0 is the seed scene", nullable=False),
    "traffic_light": Column("str", "", "SUMO's id of the traffic light", nullable=False),
    "state": Column("str", "", "SUMO's letters, one a connection: r, y, g, G, u, o, O, s", nullable=False),
}
TIMING_COLUMNS: Mapping[str, Column] = {
    "episode": Column("int64", "", "number of the episode in its run", nullable=False),
    "simulated_s": Column("float64", "s", "simulated time", nullable=False),
    "wall_s": Column("float64", "s", "wall-clock of the episode, SUMO's start included", nullable=False),
    "real_time_factor": Column("float64", "", "simulated_s / wall_s", nullable=False),
    "cpu_s": Column("float64", "s", "processor time of the episode, SUMO's included"),
    "target_plan_p50_s": Column("float64", "s", "median time of a plan of a Python target"),
    "target_plan_p99_s": Column("float64", "s", "99th percentile of the same"),
    "background_plan_p50_s": Column("float64", "s", "median time of a plan of the policy"),
    "background_plan_p99_s": Column("float64", "s", "99th percentile of the same"),
}
TABLES: Mapping[str, Mapping[str, Column]] = {
    "episodes": EPISODE_COLUMNS,
    "states": STATE_COLUMNS,
    "collisions": COLLISION_COLUMNS,
    "plans": PLAN_COLUMNS,
    "unattacked": NATURAL_COLUMNS,
    "signals": SIGNAL_COLUMNS,
    "timing": TIMING_COLUMNS,
}
#: Tables that folders of earlier versions lack.
LATER_TABLES = frozenset(("signals",))


@dataclass(frozen=True)
class RunFolder:
    """A run's folder.

    Attributes:
        path: the folder.
        made: folders that this run made, innermost first.
        fresh: there was no run in it before.
    """

    path: Path
    made: tuple[Path, ...] = ()
    fresh: bool = False

    @staticmethod
    def create(path: Path, settings: Mapping[str, Any], resume: bool) -> RunFolder:
        """Make the folder and write ``run.toml``.

        Args:
            path: a new or empty folder; with *resume*, one that an interrupted run left.
            settings: what ``run.toml`` holds.
            resume: go on with that run.

        Raises:
            FileError: the folder cannot be written, or holds something else.
            ConfigError: it is of a run with other options.
        """
        begun = (path / "run.toml").exists()
        made = tuple(folder for folder in (path, *path.parents) if not folder.exists())
        folder = RunFolder(path, made, fresh=not begun)
        if begun:
            folder._must_continue(path / "run.toml", settings, resume)
        elif path.is_dir() and any(child.name != _PARTS for child in path.iterdir()):
            raise FileError(path, "is a folder that holds other files", "choose a new --out")
        try:
            folder._take_apart()
            (path / _PARTS).mkdir(parents=True, exist_ok=True)
            _replace(path / "run.toml", tomli_w.dumps(settings).encode())
        except OSError as error:
            folder.discard()
            raise FileError(path, f"cannot be written ({error.strerror})", "choose another --out") from None
        return folder

    def discard(self) -> None:
        """Take a new folder away again, for a run of which no episode finished; what was there before stays."""
        if not self.fresh or self.done():
            return
        shutil.rmtree(self.path / _PARTS, ignore_errors=True)
        for name in ("run.toml", "run.aside"):
            with contextlib.suppress(OSError):
                (self.path / name).unlink()
        for folder in self.made:
            with contextlib.suppress(OSError):  # somebody else put something there
                folder.rmdir()

    def _must_continue(self, before: Path, settings: Mapping[str, Any], resume: bool) -> None:
        if not resume:
            raise FileError(
                self.path, "already holds a run", "choose a new --out, or add --resume to go on with it"
            )
        try:
            old = tomllib.loads(before.read_text(encoding="utf-8")).get("options", {})
        except tomllib.TOMLDecodeError as error:
            raise FileError(before, f"is damaged ({error})", "choose a new --out") from None
        new = settings["options"]
        for key in sorted({*old, *new} - {"episodes", "out"}):
            if old.get(key) != new.get(key):
                raise ConfigError(
                    f"{self.path}: that run had {key} = {old.get(key)!r}, not {new.get(key)!r}; "
                    "leave that option out, or choose a new --out"
                )
        had = max(self.done() or self._in_tables(), default=-1) + 1
        if had > new["episodes"]:
            raise ConfigError(
                f"{self.path}: that run has {had} episodes; ask for as many, or choose a new --out"
            )

    def _in_tables(self) -> list[int]:
        """Return the numbers of the episodes of a finished run."""
        if not all((self.path / f"{table}.parquet").exists() for table in TABLES.keys() - LATER_TABLES):
            return []
        numbers = pq.read_table(self.path / "episodes.parquet", columns=["episode"])["episode"]
        return [number for number in numbers.to_pylist() if number is not None]

    def _take_apart(self) -> None:
        """Make parts of a finished run's tables again, so that none of its episodes is run or lost."""
        numbers = self._in_tables()
        if (self.path / _PARTS).exists() or not numbers:
            return
        aside = self.path / f"{_PARTS}.aside"
        shutil.rmtree(aside, ignore_errors=True)
        aside.mkdir()
        for table, columns in TABLES.items():
            path = self.path / f"{table}.parquet"
            whole = pq.read_table(path) if path.exists() else schema_of(columns).empty_table()
            for number in numbers:
                part = whole.filter(pc.field("episode") == number).combine_chunks()
                _write(aside / f"{number:06d}.{table}.parquet", part)
                (aside / f"{number:06d}.done").touch()
        aside.replace(self.path / _PARTS)

    def done(self) -> list[int]:
        """Return the numbers of the episodes that are on disk."""
        return sorted(int(p.stem) for p in (self.path / _PARTS).glob("*.done"))

    def add(
        self,
        record: EpisodeRecord,
        episode: Mapping[str, Any],
        collisions: list[dict[str, Any]],
        timing: Timing,
    ) -> None:
        """Write one finished episode; it counts only once all of it is on disk."""
        base = self.path / _PARTS / f"{record.episode:06d}"
        for name, table in episode_tables(record, episode, collisions, timing).items():
            _write(base.with_suffix(f".{name}.parquet"), table)
        base.with_suffix(".done").touch()

    def consolidate(self, finished: bool) -> None:
        """Put the finished episodes together in one file a table.

        Args:
            finished: nothing is missing: the parts are removed.
        """
        numbers = self.done()
        for table, columns in TABLES.items():
            parts = (self.path / _PARTS / f"{n:06d}.{table}.parquet" for n in numbers)
            _write_all(self.path / f"{table}.parquet", parts, schema_of(columns))
        if finished:
            shutil.rmtree(self.path / _PARTS)


def episode_tables(
    record: EpisodeRecord,
    episode: Mapping[str, Any],
    collisions: list[dict[str, Any]],
    timing: Timing,
) -> dict[str, pa.Table]:
    """Return what one episode adds to each of ``TABLES``."""
    rows = {"episodes": [dict(episode)], "collisions": collisions, "timing": [timing_row(record, timing)]}
    tables = {name: table_of(content, TABLES[name]) for name, content in rows.items()}
    tables |= {"states": states_table(record), "plans": plans_table(record)}
    return {**tables, "unattacked": natural_table(record), "signals": signals_table(record)}


def states_table(record: EpisodeRecord) -> pa.Table:
    """Return one row an agent and step of *record*, in the order of agents, then steps."""
    movers = np.array([c.name.lower() for c in Controller if c >= 0], dtype=object)
    columns = _state_columns(record.tracks, record.episode, record.target)
    columns["controller"] = movers[record.controller[np.nonzero(record.tracks.valid)]]
    return pa.table({name: columns[name] for name in STATE_COLUMNS}, schema=schema_of(STATE_COLUMNS))


def natural_table(record: EpisodeRecord) -> pa.Table:
    """Return one row an agent and instant of what happens without attack, to 1 cm, 1 mrad and 1 cm/s."""
    natural = record.natural if record.natural is not None else Tracks.empty()
    target = record.tracks.ids[record.target] if record.tracks.agents else ""
    columns = _state_columns(natural, record.episode, natural.index.get(target, -1))
    for name, digits in (("x_m", 2), ("y_m", 2), ("yaw_rad", 3), ("speed_mps", 2)):
        columns[name] = np.round(columns[name], digits) + 0.0  # no −0
    return pa.table({name: columns[name] for name in NATURAL_COLUMNS}, schema=schema_of(NATURAL_COLUMNS))


def _state_columns(tracks: Tracks, episode: int, target: int) -> dict[str, Any]:
    """Return the columns of *tracks* that ``states`` and ``unattacked`` share."""
    agent, step = np.nonzero(tracks.valid)
    names = np.array(tracks.ids, dtype=object)
    classes = np.array([c.name.lower() for c in AgentClass], dtype=object)
    return {
        "episode": np.full(len(agent), episode),
        "step": step,
        "time_s": np.round(tracks.times_s[step], 6),
        "agent": names[agent],
        "class": classes[tracks.classes[agent]],
        "length_m": tracks.size_m[agent, 0],
        "width_m": tracks.size_m[agent, 1],
        "x_m": tracks.xy_m[agent, step, 0],
        "y_m": tracks.xy_m[agent, step, 1],
        "yaw_rad": tracks.yaw_rad[agent, step],
        "speed_mps": tracks.speed_mps[agent, step],
        "is_target": agent == target,
    }


def signals_table(record: EpisodeRecord) -> pa.Table:
    """Return what each traffic light shows at first, and each change, in the order of time."""
    rows: list[dict[str, Any]] = []
    shown: dict[str, str] = {}
    for step, states in enumerate(record.signals):
        for name in sorted(states):
            if shown.get(name) != states[name]:
                shown[name] = states[name]
                row = {"episode": record.episode, "step": step, "traffic_light": name, "state": states[name]}
                rows.append(row)
    return table_of(rows, SIGNAL_COLUMNS)


def plans_table(record: EpisodeRecord) -> pa.Table:
    """Return one row a planned position of *record*, in the order of plans, agents, times."""
    there = [np.nonzero(np.isfinite(plans.xy_m).all(axis=-1)) for plans in record.plans]
    counts = [len(agent) for agent, _ in there]
    pairs = list(zip(record.plans, there, strict=True))
    times = [plans.made_s + plans.dt_s * (step + 1) for plans, (_, step) in pairs]
    places = [plans.xy_m[where] for plans, where in pairs]
    xy = np.round(np.concatenate([np.zeros((0, 2)), *places]), 2) + 0.0  # no −0
    made = [np.full(count, plans.made_s) for plans, count in zip(record.plans, counts, strict=True)]
    columns: dict[str, Any] = {
        "episode": np.full(sum(counts), record.episode),
        "made_s": np.round(np.concatenate([np.zeros(0), *made]), 6),
        "agent": [plans.ids[row] for plans, (agent, _) in pairs for row in agent.tolist()],
        "time_s": np.round(np.concatenate([np.zeros(0), *times]), 6),
        "x_m": xy[:, 0],
        "y_m": xy[:, 1],
    }
    return pa.table(columns, schema=schema_of(PLAN_COLUMNS))


def timing_row(record: EpisodeRecord, timing: Timing) -> dict[str, Any]:
    """Return the row of ``timing.parquet`` of one episode."""
    simulated = max(record.tracks.steps - 1, 0) * record.tracks.dt_s
    return {
        "episode": record.episode,
        "simulated_s": simulated,
        "wall_s": timing.wall_s,
        "real_time_factor": simulated / timing.wall_s,
        "cpu_s": timing.cpu_s,
        "target_plan_p50_s": _percentile(timing.target_plans_s, 50),
        "target_plan_p99_s": _percentile(timing.target_plans_s, 99),
        "background_plan_p50_s": _percentile(timing.background_plans_s, 50),
        "background_plan_p99_s": _percentile(timing.background_plans_s, 99),
    }


def _percentile(values: tuple[float, ...], share: float) -> float | None:
    return float(np.percentile(values, share)) if values else None


def schema_of(columns: Mapping[str, Column]) -> pa.Schema:
    """Return the Arrow schema of *columns*."""
    return pa.schema([pa.field(name, _ARROW[column.dtype]) for name, column in columns.items()])


def table_of(rows: list[dict[str, Any]], columns: Mapping[str, Column]) -> pa.Table:
    """Return *rows* as a table of *columns*."""
    return pa.Table.from_pylist(rows, schema=schema_of(columns))


def _write(path: Path, table: pa.Table) -> None:
    _write_all(path, (table,), table.schema)


def _write_all(path: Path, parts: Iterable[Path | pa.Table], schema: pa.Schema) -> None:
    """Write *parts* one after the other into *path*, aside first and then renamed."""
    aside = path.with_suffix(".aside")
    try:
        with pq.ParquetWriter(aside, schema, compression="zstd") as writer:
            for part in parts:
                writer.write_table(pq.read_table(part, schema=schema) if isinstance(part, Path) else part)
    except OSError as error:
        raise FileError(path, f"cannot be written ({error.strerror or error})", "free some space") from None
    aside.replace(path)


def _replace(path: Path, content: bytes) -> None:
    aside = path.with_suffix(".aside")
    aside.write_bytes(content)
    aside.replace(path)
