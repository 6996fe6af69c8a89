"""A sweep's folder: what was asked, the seed scenes while they are needed, and one file an episode."""

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
from advdiff_sumo.core.whole_file import ASIDE
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
_KEPT_BATCHES = 4
_WANTED = "wanted"


@dataclass(frozen=True)
class Store:
    """The folder of a sweep; only the process that leads the sweep writes to it.

    Attributes:
        path: the folder.
    """

    path: Path
    _recent: OrderedDict[str, Mapping[str, bytes]] = field(default_factory=OrderedDict)

    # --- the folder --------------------------------------------------------------------------------------

    @staticmethod
    def create(path: Path, settings: Mapping[str, Any], ballast_bytes: int) -> Store:
        """Make a new folder for a sweep.

        Args:
            path: new or empty.
            settings: what ``sweep.toml`` holds.
            ballast_bytes: room kept back, so that what is being computed can be stored when the disk is full.

        Raises:
            FileError: it holds something, or cannot be written.
        """
        if (path / SWEEP_SETTINGS).exists():
            raise FileError(path, "already holds a sweep", "go on with --resume, or choose a new --out")
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise FileError(path, "is there already and no empty folder", "choose a new --out")
        try:
            return Store(path)._begin(settings, ballast_bytes)
        except DiskFullError:
            for folder in (path / _EPISODES, path / _SCENES, path):
                with contextlib.suppress(OSError):
                    folder.rmdir()
            raise FileError(path, "the disk is full", "free some space, or choose another --out") from None

    @staticmethod
    def resume(path: Path, spec: SweepSpec | None, settings: Mapping[str, Any], ballast_bytes: int) -> Store:
        """Go on in the folder of a sweep; *settings* are written when the old ones are damaged.

        Raises:
            FileError: it holds no sweep, or cannot be written.
            ConfigError: it belongs to another sweep than *spec*.
        """
        begun = Store.open(path)
        if spec is not None:
            must_equal(path, begun.spec(), spec)
        begun.must_match(str(settings.get("keys", "")))
        settings = with_earlier(settings, "made_by", {"made_by": begun.made_by()})
        return Store(path)._begin(settings, ballast_bytes)

    @staticmethod
    def open(path: Path) -> Store:
        """Open the folder of a sweep to read.

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
        """Return what was asked.

        Raises:
            InputError: ``sweep.toml`` is damaged.
        """
        content = read_toml(self.path / SWEEP_SETTINGS)
        asked = content.get("sweep")
        if not isinstance(asked, dict):
            raise FileError(
                self.path / SWEEP_SETTINGS, "has no [sweep]", "it is damaged; begin again with a new --out"
            )
        return SweepSpec.of(asked, str(self.path / SWEEP_SETTINGS))

    def made_by(self) -> Mapping[str, Any]:
        """Return the versions and the digests of code that it was made with, and under ``begun_with`` earlier ones.

        Raises:
            InputError: ``sweep.toml`` is damaged.
        """
        made_by: Mapping[str, Any] = read_toml(self.path / SWEEP_SETTINGS).get("made_by", {})
        return made_by

    def must_match(self, keys: str) -> None:
        """Refuse the folder when what the keys of its episodes are made of has changed since.

        Args:
            keys: digest of all keys of the plan made now.

        Raises:
            ConfigError: a net, demand or log is not what it was.
        """
        begun = read_toml(self.path / SWEEP_SETTINGS).get("keys", keys)
        if begun != keys:
            raise ConfigError(
                f"{self.path}: a net, demand or log is not what it was when that sweep was begun, "
                "or a file of weights; put the old one back, or begin a new sweep"
            )

    def _begin(self, settings: Mapping[str, Any], ballast_bytes: int) -> Store:
        self.prepare(ballast_bytes)
        write_whole(self.path / SWEEP_SETTINGS, tomli_w.dumps(settings).encode())
        return self

    def prepare(self, ballast_bytes: int) -> None:
        """Make the folders for episodes and seed scenes, and keep room back; see :meth:`create`."""
        try:
            for name in (_EPISODES, _SCENES):
                (self.path / name).mkdir(parents=True, exist_ok=True)
            for rest in self.path.rglob(f"*{ASIDE}"):
                rest.unlink()  # of a process that was killed
            if ballast_bytes:
                self._load_ballast(ballast_bytes)
        except OSError as error:
            self.drop_ballast()
            raise unwritable(self.path, error) from None

    def _load_ballast(self, size: int) -> None:
        with (self.path / _BALLAST).open("wb") as file:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, size)
            else:
                file.write(bytes(size))

    def drop_ballast(self) -> None:
        """Give the room back that was kept for a full disk."""
        with contextlib.suppress(OSError):
            (self.path / _BALLAST).unlink()

    def end(self) -> None:
        """Take away what only a running sweep needs."""
        self.drop_ballast()
        shutil.rmtree(self.path / _SCENES, ignore_errors=True)

    # --- episodes ----------------------------------------------------------------------------------------

    def write(self, key: str, part: bytes) -> None:
        """Store a finished episode.

        Raises:
            DiskFullError: there is no room.
            FileError: it cannot be written for another reason.
        """
        path = self._episode(key)
        try:
            path.parent.mkdir(exist_ok=True)
        except OSError as error:
            raise unwritable(path, error) from None
        write_checked(path, part)

    def read(self, key: str) -> StoredEpisode | None:
        """Return a finished episode; None when there is none, or its file is damaged."""
        content = read_checked(self._episode(key))
        return None if content is None else StoredEpisode.from_bytes(content)

    def glance(self, key: str) -> dict[str, Any] | None:
        """Return the row of a finished episode; None when there is none, or its file is damaged."""
        content = read_checked(self._episode(key))
        return None if content is None else StoredEpisode.glance(content)[0]

    def finished(self) -> list[str]:
        """Return the keys of the finished episodes that are there and whole."""
        return sorted(path.name for path in self._files() if read_checked(path) is not None)

    def changed_ns(self) -> Iterator[int]:
        """Yield when each file of a finished episode was written, in nanoseconds of the file system's clock."""
        return (path.stat().st_mtime_ns for path in self._files())

    def has(self, key: str) -> bool:
        """Return whether a finished episode is there and whole."""
        return read_checked(self._episode(key)) is not None

    def is_done(self, key: str, retry_failed: bool = False) -> bool:
        """Return whether an episode is not to be run (again): it is there and, with *retry_failed*, did not fail."""
        if not retry_failed:
            return self.has(key)
        part = self.read(key)
        return part is not None and part.failed is None

    def checksum(self, key: str) -> str:
        """Return what the file of a finished episode says of its content; "" where there is none."""
        return written_checksum(self._episode(key))

    def _files(self) -> Iterator[Path]:
        return (path for path in (self.path / _EPISODES).glob("*/*") if not path.name.endswith(ASIDE))

    def _episode(self, key: str) -> Path:
        return self.path / _EPISODES / key[:2] / key

    # --- seed scenes -------------------------------------------------------------------------------------

    def write_scenes(self, batch: str, scenes: tuple[bytes, ...], wanted: int) -> None:
        """Store the seed scenes of a batch of which so many were *wanted*; errors as in :meth:`write`."""
        entries = {f"{k}": scene for k, scene in enumerate(scenes)} | {_WANTED: str(wanted).encode()}
        self._remember(batch, entries)
        write_checked(self.path / _SCENES / batch, pack(entries))

    def read_scenes(self, batch: str) -> tuple[bytes, ...] | None:
        """Return the seed scenes of a batch; None when they are missing or damaged."""
        entries = self._scenes(batch)
        return None if entries is None else tuple(scene for name, scene in entries.items() if name != _WANTED)

    def has_scenes(self, batch: str, wanted: int) -> bool:
        """Return whether so many seed scenes of a batch are stored, or all that there were when as many were wanted."""
        entries = self._scenes(batch)
        if entries is None:
            return False
        return max(int(entries.get(_WANTED, b"0")), len(entries.keys() - {_WANTED})) >= wanted

    def _scenes(self, batch: str) -> Mapping[str, bytes] | None:
        if batch not in self._recent:
            content = read_checked(self.path / _SCENES / batch)
            if content is None:
                return None
            self._remember(batch, unpack(content))
        self._recent.move_to_end(batch)
        return self._recent[batch]

    def _remember(self, batch: str, entries: Mapping[str, bytes]) -> None:
        self._recent[batch] = entries
        while len(self._recent) > _KEPT_BATCHES:
            self._recent.popitem(last=False)


def must_equal(path: Path, begun: SweepSpec, asked: SweepSpec) -> None:
    """Refuse to go on in *path* with another sweep than it was begun with.

    Raises:
        ConfigError: the two differ.
    """
    old, new = begun.model_dump(mode="json"), asked.model_dump(mode="json")
    for key in old:
        if old[key] != new[key]:
            raise ConfigError(
                f"{path}: belongs to another sweep: its {key} differ from those of the file; "
                "give the file that it was begun with, or choose a new --out"
            )
