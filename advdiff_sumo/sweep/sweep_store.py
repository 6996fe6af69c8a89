"""Manage a sweep's folder: its settings, seed scenes while they are needed, and one file an episode."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tomli_w

from advdiff_sumo.config import read_toml
from advdiff_sumo.core.errors import ConfigError, FileError
from advdiff_sumo.core.whole_file import ASIDE, is_free
from advdiff_sumo.data.run_tables import RUN_SETTINGS, SWEEP_SETTINGS
from advdiff_sumo.sweep.spec import SweepSpec
from advdiff_sumo.sweep.stored_episode import StoredEpisode, pack, unpack
from advdiff_sumo.sweep.sweep_files import (
    DiskFullError,
    read_checked,
    unwritable,
    with_earlier,
    write_checked,
    write_whole,
    written_checksum,
)

_EPISODES, _SCENES, _BALLAST = "episodes", "scenes", "ballast"
_CACHED_BATCHES = 4
_WANTED = "wanted"  # entry of a batch's file: how many seed scenes were wanted


@dataclass(frozen=True)
class Store:
    """The folder of a sweep; only the process that runs the sweep writes to it.

    Attributes:
        path: the folder.
    """

    path: Path
    _batch_cache: OrderedDict[str, Mapping[str, bytes]] = field(default_factory=OrderedDict)

    # --- the folder --------------------------------------------------------------------------------------

    @staticmethod
    def create(path: Path, settings: Mapping[str, Any], ballast_bytes: int) -> Store:
        """Create a folder for a new sweep.

        Args:
            path: a new or empty folder.
            settings: content of ``sweep.toml``.
            ballast_bytes: disk space to reserve, so that running episodes can be stored when the disk is full.

        Raises:
            FileError: the folder is not empty, or cannot be written.
        """
        must_be_free(path)
        try:
            return Store(path)._begin(settings, ballast_bytes)
        except DiskFullError:
            for folder in (path / _EPISODES, path / _SCENES, path):
                with contextlib.suppress(OSError):
                    folder.rmdir()
            raise FileError(path, "the disk is full", "free some space, or choose another --out") from None

    @staticmethod
    def resume(path: Path, spec: SweepSpec | None, settings: Mapping[str, Any], ballast_bytes: int) -> Store:
        """Continue in the folder of a sweep; ``sweep.toml`` is written anew from *settings*.

        Raises:
            FileError: the folder holds no sweep, or cannot be written.
            ConfigError: its sweep differs from *spec*.
        """
        stored = Store.open(path)
        if spec is not None:
            must_equal(path, stored.spec(), spec)
        stored.must_match(str(settings.get("keys", "")))
        settings = with_earlier(settings, "made_by", {"made_by": stored.made_by()})
        return Store(path)._begin(settings, ballast_bytes)

    @staticmethod
    def open(path: Path) -> Store:
        """Open the folder of a sweep for reading.

        Raises:
            FileError: it holds no sweep.
        """
        if (path / SWEEP_SETTINGS).is_file():
            return Store(path)
        if (path / RUN_SETTINGS).is_file():
            remedy = "look at it with advdiff-sumo report, results or verdict, or repeat it with run --config"
            raise FileError(path, "holds a run, no sweep", remedy)
        raise FileError(path, "holds no sweep", "give the folder that advdiff-sumo sweep wrote")

    def spec(self) -> SweepSpec:
        """Return the stored content of the sweep file.

        Raises:
            InputError: ``sweep.toml`` is damaged.
        """
        content = read_toml(self.path / SWEEP_SETTINGS)
        values = content.get("sweep")
        if not isinstance(values, dict):
            raise FileError(
                self.path / SWEEP_SETTINGS, "has no [sweep]", "it is damaged; begin again with a new --out"
            )
        return SweepSpec.of(values, str(self.path / SWEEP_SETTINGS))

    def made_by(self) -> Mapping[str, Any]:
        """Return the versions and digests of code that made the sweep; earlier ones are under ``begun_with``.

        Raises:
            InputError: ``sweep.toml`` is damaged.
        """
        made_by: Mapping[str, Any] = read_toml(self.path / SWEEP_SETTINGS).get("made_by", {})
        return made_by

    def must_match(self, keys: str) -> None:
        """Check that the keys of the episodes are still the same.

        Args:
            keys: digest of all keys of the present plan.

        Raises:
            ConfigError: a net, demand, log or file of weights has changed.
        """
        stored_keys = read_toml(self.path / SWEEP_SETTINGS).get("keys", keys)
        if stored_keys != keys:
            raise ConfigError(
                f"{self.path}: a net, demand or log is not what it was when that sweep was begun, "
                "or a file of weights; put the old one back, or begin a new sweep"
            )

    def _begin(self, settings: Mapping[str, Any], ballast_bytes: int) -> Store:
        """Prepare the folder and write ``sweep.toml``."""
        self.prepare(ballast_bytes)
        write_whole(self.path / SWEEP_SETTINGS, tomli_w.dumps(settings).encode())
        return self

    def prepare(self, ballast_bytes: int) -> None:
        """Create the folders for episodes and seed scenes, and reserve disk space; see :meth:`create`."""
        try:
            for name in (_EPISODES, _SCENES):
                (self.path / name).mkdir(parents=True, exist_ok=True)
            for leftover in self.path.rglob(f"*{ASIDE}"):
                leftover.unlink()  # left by a killed process
            if ballast_bytes:
                self._reserve(ballast_bytes)
        except OSError as error:
            self.drop_ballast()
            raise unwritable(self.path, error) from None

    def _reserve(self, size: int) -> None:
        """Reserve *size* bytes of disk space."""
        with (self.path / _BALLAST).open("wb") as file:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, size)
            else:
                file.write(bytes(size))

    def drop_ballast(self) -> None:
        """Release the reserved disk space."""
        with contextlib.suppress(OSError):
            (self.path / _BALLAST).unlink()

    def end(self) -> None:
        """Remove what only a running sweep needs."""
        self.drop_ballast()
        shutil.rmtree(self.path / _SCENES, ignore_errors=True)

    # --- episodes ----------------------------------------------------------------------------------------

    def write(self, key: str, content: bytes) -> None:
        """Store a finished episode.

        Raises:
            DiskFullError: the disk is full.
            FileError: it cannot be written for another reason.
        """
        path = self._episode(key)
        try:
            path.parent.mkdir(exist_ok=True)
        except OSError as error:
            raise unwritable(path, error) from None
        write_checked(path, content)

    def read(self, key: str) -> StoredEpisode | None:
        """Return a finished episode; None if it is missing or its file is damaged."""
        content = read_checked(self._episode(key))
        return None if content is None else StoredEpisode.from_bytes(content)

    def episode_row(self, key: str) -> dict[str, Any] | None:
        """Return the row of a finished episode; None if it is missing, has no row, or its file is damaged."""
        content = read_checked(self._episode(key))
        return None if content is None else StoredEpisode.row_and_failure(content)[0]

    def finished(self) -> list[str]:
        """Return the keys of the finished episodes whose files are intact."""
        return sorted(path.name for path in self._files() if read_checked(path) is not None)

    def changed_ns(self) -> Iterator[int]:
        """Yield the modification time of each episode's file, in nanoseconds."""
        return (path.stat().st_mtime_ns for path in self._files())

    def has(self, key: str) -> bool:
        """Return whether the file of a finished episode exists and is intact."""
        return read_checked(self._episode(key)) is not None

    def is_done(self, key: str, retry_failed: bool = False) -> bool:
        """Return whether an episode need not be run: it is stored and, with *retry_failed*, did not fail."""
        if not retry_failed:
            return self.has(key)
        episode = self.read(key)
        return episode is not None and episode.failed is None

    def checksum(self, key: str) -> str:
        """Return the checksum written in the file of a finished episode; "" if there is none."""
        return written_checksum(self._episode(key))

    def _files(self) -> Iterator[Path]:
        """Yield the files of the finished episodes."""
        return (path for path in (self.path / _EPISODES).glob("*/*") if not path.name.endswith(ASIDE))

    def _episode(self, key: str) -> Path:
        """Return the file of an episode."""
        return self.path / _EPISODES / key[:2] / key

    # --- seed scenes -------------------------------------------------------------------------------------

    def write_scenes(self, batch: str, scenes: tuple[bytes, ...], wanted: int) -> None:
        """Store the seed scenes of a batch, with the number *wanted*; errors as in :meth:`write`."""
        entries = {f"{k}": scene for k, scene in enumerate(scenes)} | {_WANTED: str(wanted).encode()}
        self._cache_batch(batch, entries)
        write_checked(self.path / _SCENES / batch, pack(entries))

    def read_scenes(self, batch: str) -> tuple[bytes, ...] | None:
        """Return the seed scenes of a batch; None if they are missing or damaged."""
        entries = self._scenes(batch)
        return None if entries is None else tuple(scene for name, scene in entries.items() if name != _WANTED)

    def has_scenes(self, batch: str, wanted: int) -> bool:
        """Return whether *wanted* seed scenes of a batch are stored, or all there are if as many were wanted before."""
        entries = self._scenes(batch)
        if entries is None:
            return False
        return max(int(entries.get(_WANTED, b"0")), len(entries.keys() - {_WANTED})) >= wanted

    def _scenes(self, batch: str) -> Mapping[str, bytes] | None:
        """Return the entries of a batch's file, cached; None if it is missing or damaged."""
        if batch not in self._batch_cache:
            content = read_checked(self.path / _SCENES / batch)
            if content is None:
                return None
            self._cache_batch(batch, unpack(content))
        self._batch_cache.move_to_end(batch)
        return self._batch_cache[batch]

    def _cache_batch(self, batch: str, entries: Mapping[str, bytes]) -> None:
        """Cache the entries of a batch; the batch used least recently is dropped."""
        self._batch_cache[batch] = entries
        while len(self._batch_cache) > _CACHED_BATCHES:
            self._batch_cache.popitem(last=False)


def must_be_free(path: Path) -> None:
    """Check that a new sweep can be begun in *path*.

    Raises:
        FileError: it is a file, or a folder that is not empty.
    """
    if (path / SWEEP_SETTINGS).exists():
        raise FileError(path, "already holds a sweep", "go on with --resume, or choose a new --out")
    if not is_free(path):
        raise FileError(path, "is there already and no empty folder", "choose a new --out")


def must_equal(path: Path, stored: SweepSpec, requested: SweepSpec) -> None:
    """Check that the sweep in *path* is the requested one.

    Raises:
        ConfigError: the two differ.
    """
    stored_values, requested_values = stored.model_dump(mode="json"), requested.model_dump(mode="json")
    for key in stored_values:
        if stored_values[key] != requested_values[key]:
            raise ConfigError(
                f"{path}: belongs to another sweep: its {key} differ from those of the file; "
                "give the file, and the --target, that it was begun with, or choose a new --out"
            )
