"""Manage the folder of a run: each finished episode is stored at once, the tables are written at the end."""

from __future__ import annotations

import contextlib
import shlex
import shutil
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import tomli_w

from advdiff_sumo.core.errors import ConfigError, FileError, os_reason
from advdiff_sumo.core.whole_file import ASIDE
from advdiff_sumo.core.wording import counted
from advdiff_sumo.data.run_tables import RUN_PARTS, RUN_SETTINGS, RunTables
from advdiff_sumo.metrics.arrow_tables import schema_of, table_of
from advdiff_sumo.sim.run_store import LATER_TABLES, TABLES
from advdiff_sumo.sweep.job_plan import run_key
from advdiff_sumo.sweep.stored_episode import StoredEpisode
from advdiff_sumo.sweep.sweep_columns import RUN_FAILURE_COLUMNS
from advdiff_sumo.sweep.sweep_files import with_earlier, write_whole
from advdiff_sumo.sweep.sweep_store import Store
from advdiff_sumo.sweep.table_writer import TableWriter
from advdiff_sumo.sweep.tasks import Failed

FAILURES = "failures.parquet"
_BALLAST_BYTES = 8 << 20  # disk space reserved for running episodes


@dataclass(frozen=True)
class RunFolder:
    """The folder of a run.

    Attributes:
        path: the folder.
        created: folders that this run created, innermost first.
        fresh: whether it held no run before.
    """

    path: Path
    created: tuple[Path, ...] = ()
    fresh: bool = False

    @staticmethod
    def create(
        path: Path, settings: Mapping[str, Any], resume: bool, remedy: str = "choose a new --out"
    ) -> RunFolder:
        """Create the folder and write ``run.toml``.

        Args:
            path: a new or empty folder; with *resume*, one with an earlier run.
            settings: content of ``run.toml``.
            resume: whether to continue that run.
            remedy: advice if the folder holds a run that is not to be continued.

        Raises:
            FileError: the folder cannot be written, holds something else, or a table in it is damaged.
            ConfigError: its run has other options.
        """
        holds_run = (path / RUN_SETTINGS).exists()
        missing_folders = tuple(folder for folder in (path, *path.parents) if not folder.exists())
        folder = RunFolder(path, missing_folders, fresh=not holds_run)
        if holds_run:
            if not resume:
                raise FileError(path, "already holds a run", remedy)
            folder._must_continue(settings)
            settings = with_earlier(settings, "run", read_settings(path))
        elif path.is_dir() and any(child.name != RUN_PARTS for child in path.iterdir()):
            raise FileError(path, "is a folder that holds other files", "choose a new --out")
        finished = folder._only_in_tables()
        try:
            folder._store_again(finished)
            folder.store.prepare(_BALLAST_BYTES)
            write_whole(path / RUN_SETTINGS, tomli_w.dumps(settings).encode())
        except (FileError, OSError) as error:
            folder.discard()
            reason = os_reason(error) if isinstance(error, OSError) else _reason(error)
            raise FileError(path, f"cannot be written ({reason})", "choose another --out") from None
        return folder

    @property
    def store(self) -> Store:
        """Store of the episodes while the run is unfinished; their keys are those of :func:`run_key`."""
        return Store(self.path / RUN_PARTS)

    def discard(self) -> None:
        """Remove a new folder whose run finished no episode; what was there before stays."""
        if not self.fresh or self.done():
            return
        shutil.rmtree(self.path / RUN_PARTS, ignore_errors=True)
        for file in (self.path / RUN_SETTINGS, *self.path.glob(f"{RUN_SETTINGS}*{ASIDE}")):
            with contextlib.suppress(OSError):
                file.unlink()
        for folder in self.created:
            with contextlib.suppress(OSError):  # another program put something there
                folder.rmdir()

    def _must_continue(self, settings: Mapping[str, Any]) -> None:
        """Check that the run in the folder can be continued with *settings*."""
        stored = read_settings(self.path)
        old, new = stored.get("options", {}), settings["options"]
        for key in sorted({*old, *new} - {"episodes", "out"}):
            if old.get(key) != new.get(key):
                raise ConfigError(
                    f"{self.path}: that run had {key} = {old.get(key)!r}, not {new.get(key)!r}; "
                    "leave that option out, or choose a new --out"
                )
        count = max(self.done() or self._in_tables(), default=-1) + 1
        if count > new["episodes"]:
            raise ConfigError(
                f"{self.path}: that run has {counted(count, 'episode')}; ask for as many, or choose a new --out"
            )
        must_have_inputs(self.path, stored, settings.get("run", {}).get("inputs"), "choose a new --out")

    # --- episodes ----------------------------------------------------------------------------------------

    def done(self, retry_failed: bool = False) -> list[int]:
        """Return the numbers of the stored episodes; with *retry_failed*, only of those that did not fail."""
        store = self.store
        return [int(key) for key in store.finished() if not retry_failed or store.is_done(key, retry_failed)]

    def add(self, number: int, episode: StoredEpisode) -> None:
        """Store one finished episode; it counts only when its file is complete."""
        self.store.write(run_key(number), episode.to_bytes())

    def part(self, number: int) -> StoredEpisode | None:
        """Return the stored form of an episode, of an unfinished or finished run; None if there is none."""
        stored = self.store.read(run_key(number))
        if stored is not None or number not in self._in_tables():
            return stored
        return self._from_tables((number,))[number]

    def episodes(self) -> dict[int, StoredEpisode]:
        """Return the stored forms of all episodes by number, of an unfinished or finished run."""
        if not (numbers := self.done()):
            return self._from_tables(self._in_tables())
        stored = {number: self.store.read(run_key(number)) for number in numbers}
        return {number: episode for number, episode in stored.items() if episode is not None}

    def catch_up(self) -> None:
        """Write the tables of an unfinished run if episodes have been stored since they were written.

        Raises:
            FileError: they cannot be written, or the run has ended meanwhile.
        """
        table_path, numbers = self._tables.path("episodes"), self.done()
        written_ns = table_path.stat().st_mtime_ns if table_path.exists() else 0
        if numbers and max(self.store.changed_ns(), default=0) > written_ns:
            self.consolidate(finished=False)

    def consolidate(self, finished: bool) -> int:
        """Write the finished episodes into one file a table.

        Args:
            finished: whether no episode is missing; the files of single episodes are then removed.

        Returns:
            Number of episodes with rows in the tables.
        """
        rows = 0
        failures: list[dict[str, Any]] = []
        with contextlib.ExitStack() as stack:
            writers = {name: stack.enter_context(self._writer(name)) for name in TABLES}
            for number in self.done():
                episode = self.store.read(run_key(number))
                if episode is None and not finished:
                    raise FileError(self.path, "has changed while it was read", "ask once more")
                if episode is None:
                    continue
                rows += bool(episode.tables)
                for name, table in episode.tables.items():
                    writers[name].add(table.select([*TABLES[name]]))
                if episode.failed is not None:
                    failures.append(self.failure_row(number, episode.failed))
        self._write_failures(failures)
        if finished:
            shutil.rmtree(self.path / RUN_PARTS)
        return rows

    def failures(self) -> list[dict[str, Any]]:
        """Return the rows of ``failures.parquet``; [] if no episode failed."""
        return self._tables.rows("failures").to_pylist() if (self.path / FAILURES).exists() else []

    def _writer(self, name: str) -> TableWriter:
        """Return a writer for table *name*."""
        return TableWriter(self.path / f"{name}.parquet", schema_of(TABLES[name]), rows_together=0)

    def failure_row(self, number: int, failed: Failed) -> dict[str, Any]:
        """Return an episode's row of ``failures``, with the command that repeats the episode."""
        command = f"advdiff-sumo replay {number} --run {shlex.quote(str(self.path))}"
        return {"episode": number, **vars(failed), "command": command}

    def _write_failures(self, rows: list[dict[str, Any]]) -> None:
        """Write ``failures.parquet``, or remove it if there are no rows."""
        path = self.path / FAILURES
        if not rows:
            path.unlink(missing_ok=True)
            return
        with TableWriter(path, schema_of(RUN_FAILURE_COLUMNS), rows_together=0) as writer:
            writer.add(table_of(rows, RUN_FAILURE_COLUMNS))

    # --- continuing a finished run ------------------------------------------------------------------------

    def _in_tables(self) -> list[int]:
        """Return the numbers of the episodes in the tables of a finished run, failed ones without a row included."""
        if not all((self.path / f"{table}.parquet").exists() for table in TABLES.keys() - LATER_TABLES):
            return []
        numbers = self._tables.rows("episodes", ["episode"])["episode"]
        with_row = {number for number in numbers.to_pylist() if number is not None}
        return sorted(with_row | {int(row["episode"]) for row in self.failures()})

    def _only_in_tables(self) -> dict[int, StoredEpisode]:
        """Return the episodes of a finished run that are in its tables only."""
        return {} if (self.path / RUN_PARTS).exists() else self._from_tables(self._in_tables())

    def _store_again(self, finished: Mapping[int, StoredEpisode]) -> None:
        """Write the episodes of a finished run into single files again, so that none is lost or run again."""
        if not finished:
            return
        aside = RunFolder(self.path / f"{RUN_PARTS}{ASIDE}")
        shutil.rmtree(aside.path, ignore_errors=True)
        aside.store.prepare(0)
        for number, episode in finished.items():
            aside.add(number, episode)
        (aside.path / RUN_PARTS).replace(self.path / RUN_PARTS)
        shutil.rmtree(aside.path)

    def _from_tables(self, numbers: Sequence[int]) -> dict[int, StoredEpisode]:
        """Return the episodes *numbers* out of the tables."""
        if not numbers:
            return {}
        tables = {name: self._table(name) for name in TABLES}
        with_rows = set(tables["episodes"]["episode"].to_pylist())
        names = Failed.__dataclass_fields__
        failed = {row["episode"]: Failed(**{name: row[name] for name in names}) for row in self.failures()}
        return {
            number: StoredEpisode(_rows_of(tables, number) if number in with_rows else {}, failed.get(number))
            for number in numbers
        }

    def _table(self, name: str) -> pa.Table:
        """Return a table; one that an earlier version did not write is empty."""
        schema = schema_of(TABLES[name])
        reader = self._tables
        return reader.rows(name, schema=schema) if reader.path(name).exists() else schema.empty_table()

    @property
    def _tables(self) -> RunTables:
        """Reader of the run's tables."""
        command = f"advdiff-sumo run --config {shlex.quote(str(self.path / RUN_SETTINGS))}"
        return RunTables(self.path, remedy=f"begin the run again: {command}")


def must_have_inputs(folder: Path, begun: Mapping[str, Any], inputs: str | None, otherwise: str) -> None:
    """Check that the input files of a run have not changed since it was begun.

    Args:
        folder: folder of the run.
        begun: content of its ``run.toml``.
        inputs: present digest of the files, as in :func:`~advdiff_sumo.sweep.job_plan.run_inputs`.
        otherwise: advice, as an alternative to restoring the old files.

    Raises:
        ConfigError: they have changed.
    """
    if begun.get("run", {}).get("inputs", inputs) != inputs:
        raise ConfigError(
            f"{folder}: a net, demand or log is not what it was when that run was begun, or a file of weights; "
            f"put the old one back, or {otherwise}"
        )


def _rows_of(tables: Mapping[str, pa.Table], number: int) -> dict[str, pa.Table]:
    """Return the rows of episode *number* of each table."""
    is_episode = pc.field("episode") == number
    return {name: table.filter(is_episode).combine_chunks() for name, table in tables.items()}


def read_settings(folder: Path) -> dict[str, Any]:
    """Return the content of ``run.toml``.

    Raises:
        FileError: it is missing or damaged.
    """
    path = folder / RUN_SETTINGS
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError:
        raise FileError(folder, "holds no run", "give the folder that advdiff-sumo run wrote") from None
    except tomllib.TOMLDecodeError as error:
        raise FileError(path, f"is damaged ({error})", "choose a new --out") from None


def _reason(error: FileError) -> str:
    """Return the system's reason in the message of *error*."""
    return error.problem.partition("(")[2].rpartition(")")[0] or error.problem
