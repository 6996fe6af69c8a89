"""Window files as one data set: held-out windows, and the order of the training windows."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from advdiff_sumo.core.errors import ConfigError, FileError
from advdiff_sumo.core.map_view import MAP_PIECES, MapView
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.core.whole_file import sha256_of
from advdiff_sumo.data.window_files import DRIVEN, WindowFile, read_windows, window_paths
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.collate import Jitter, collate

IntArray = NDArray[np.int64]
_VIEWS: Mapping[int, MapView] = {lanes + edges: view for view, (lanes, edges) in MAP_PIECES.items()}


@dataclass(frozen=True)
class WindowSet:
    """Windows of several files; window number n is row ``row[n]`` of file ``file[n]``.

    Attributes:
        files: the files, opened.
        file: (n,) which file.
        row: (n,) which window of it.
        agents: (n,) number of agents.
        digest: sha256 of the files' contents, independent of their names and order.
    """

    files: tuple[WindowFile, ...]
    file: IntArray
    row: IntArray
    agents: IntArray
    digest: str

    def __len__(self) -> int:
        """Return the number of windows."""
        return len(self.row)

    def spread(self, most: int) -> IntArray:
        """Return the numbers of at most *most* windows, evenly spaced."""
        return np.linspace(0, len(self) - 1, min(len(self), most)).round().astype(np.int64)

    @property
    def map_view(self) -> MapView:
        """How much of the map the windows show."""
        return _VIEWS[self.files[0].near.shape[1]]

    @property
    def driven(self) -> NDArray[np.bool_]:
        """(n,) in which windows the past was driven by a model."""
        of_file = np.array([DRIVEN in file.extra for file in self.files], dtype=np.bool_)
        return of_file[self.file]

    def must_show(self, view: MapView, which: str = "the windows") -> None:
        """Refuse windows of another *view* of the map than that of the networks.

        Raises:
            ConfigError: the views differ; the sentence begins with *which*.
        """
        if self.map_view != view:
            raise ConfigError(
                f"{which} show the map's '{self.map_view}' view, but the networks see '{view}': make windows with "
                f"--map-view {view}"
            )

    def subset(self, numbers: IntArray) -> WindowSet:
        """Return the windows with these numbers."""
        return WindowSet(self.files, self.file[numbers], self.row[numbers], self.agents[numbers], self.digest)

    def batch(
        self, numbers: IntArray, rng: np.random.Generator | None = None, jitter: Jitter | None = None
    ) -> SceneBatch:
        """Return the windows with these numbers, padded to the largest of them.

        Args:
            numbers: which windows.
            rng: random numbers of the augmentation.
            jitter: augmentation; None: none.
        """
        parts, order = [], []
        for index in np.unique(self.file[numbers]):
            chosen = np.flatnonzero(self.file[numbers] == index)
            parts.append(collate(self.files[index], self.row[numbers[chosen]], rng, jitter))
            order.append(chosen)
        return parts[0] if len(parts) == 1 else join(parts).rows(_inverse(np.concatenate(order)))


def read_window_set(paths: Iterable[Path]) -> WindowSet:
    """Read window files.

    Args:
        paths: files, and folders of such files.

    Raises:
        FileError: one is missing or no window file, or no file holds a window.
    """
    sources = sorted(set(window_paths(list(paths))))
    files = tuple(read_windows(path) for path in sources)
    counts = [file.windows for file in files]
    if not sum(counts):
        raise FileError(sources[0], "holds no window", "build it from more driving")
    for path, file in zip(sources, files, strict=True):
        if file.near.shape[1] not in _VIEWS or file.near.shape[1] != files[0].near.shape[1]:
            raise FileError(
                path,
                "shows another part of the map than the other windows",
                "leave it out, or build it again",
            )
    agents = np.concatenate([np.diff(file.offset) for file in files])
    digest = hashlib.sha256("".join(sorted(map(sha256_of, sources))).encode()).hexdigest()
    return WindowSet(
        files,
        np.repeat(np.arange(len(files)), counts),
        np.concatenate([np.arange(count) for count in counts]),
        agents.astype(np.int64),
        digest,
    )


def split(windows: WindowSet, share: float, seed: int) -> tuple[WindowSet, WindowSet]:
    """Split the windows by drives, so that no drive is in both parts.

    A drive's part depends only on its name, the file's source and map, and *seed*: further files do not change it.

    Args:
        windows: all windows.
        share: approximate share of the drives that is held out.
        seed: of the choice.

    Returns:
        The windows to train on, and those held out.

    Raises:
        ConfigError: there is only one drive.
    """
    tree = SeedTree(seed, ("held-out",))
    names = np.array([_drive(windows.files[f], r) for f, r in zip(windows.file, windows.row, strict=True)])
    rank = {name: tree.child(name).integer(53) / 2.0**53 for name in sorted(set(names))}
    if len(rank) < 2:
        raise ConfigError(
            "all windows are of one drive, so none can be held out; add more data, or --val (train) or --all (evaluate)"
        )
    ordered = sorted(rank, key=lambda name: (rank[name], name))
    held_out_names = [name for name in ordered[:-1] if rank[name] < share] or ordered[:1]
    held = np.isin(names, held_out_names)
    return windows.subset(np.flatnonzero(~held)), windows.subset(np.flatnonzero(held))


def of_epoch(windows: WindowSet, count: int, driven_share: float, rng: np.random.Generator) -> IntArray:
    """Return the numbers of the windows of one epoch.

    All windows of a kind are drawn equally often, up to one.

    Args:
        windows: all windows.
        count: windows of an epoch; 0: as many as there are.
        driven_share: share of windows whose past was driven by a model; 0: as in *windows*.
        rng: random numbers of the draw.

    Raises:
        ConfigError: *driven_share* is not 0, and there are no windows of one kind.
    """
    count = count or len(windows)
    if not driven_share:
        return _spread(np.arange(len(windows)), count, rng)
    kinds = np.flatnonzero(windows.driven), np.flatnonzero(~windows.driven)
    many = round(count * driven_share)
    counts = many, count - many
    if any(number and not len(kind) for kind, number in zip(kinds, counts, strict=True)):
        raise ConfigError(
            f"driven_share = {driven_share:g}: the windows hold {len(kinds[0])} that a model drove and {len(kinds[1])} "
            "others; make the former with 'advdiff-sumo data simulate --driven-by'"
        )
    return np.concatenate([_spread(kind, number, rng) for kind, number in zip(kinds, counts, strict=True)])


def _spread(numbers: IntArray, count: int, rng: np.random.Generator) -> IntArray:
    """Return *count* of *numbers*, each equally often, up to one."""
    if count == len(numbers):
        return numbers
    whole = np.tile(numbers, count // max(len(numbers), 1))
    return np.concatenate((whole, rng.permutation(numbers)[: count - len(whole)]))


def batches(windows: WindowSet, size: int, rng: np.random.Generator | None = None) -> list[IntArray]:
    """Return the windows' numbers in batches of scenes with similar numbers of agents.

    Args:
        windows: the windows.
        size: windows in a batch; the last one may have fewer.
        rng: shuffles windows and batches; None: fixed order by number of agents.
    """
    spread = rng.uniform(0.0, 4.0, len(windows)) if rng is not None else np.zeros(len(windows))
    order = np.argsort(windows.agents + spread, kind="stable")
    cut = [order[start : start + size] for start in range(0, len(order), size)]
    return [cut[i] for i in rng.permutation(len(cut))] if rng is not None else cut


def join(parts: Sequence[SceneBatch]) -> SceneBatch:
    """Return the scenes of several batches as one, padded to the most agents."""
    agents = max(part.agents for part in parts)
    names = [f.name for f in fields(SceneBatch)]
    return SceneBatch(**{n: torch.cat([_padded(getattr(p, n), agents) for p in parts]) for n in names})


def nearest(batch: SceneBatch, agents: int) -> SceneBatch:
    """Return the scenes with only their first *agents* agents, those nearest to the focal one."""
    if batch.agents <= agents:
        return batch
    return batch.rows_of(slice(agents))


def padded(batch: SceneBatch, agents: int) -> SceneBatch:
    """Return *batch* with padding up to *agents* agents."""
    return batch.mapped(lambda part: _padded(part, agents))


def _padded(value: Tensor, agents: int) -> Tensor:
    missing = agents - value.shape[1]
    if not missing:
        return value
    return torch.cat((value, value.new_zeros(value.shape[0], missing, *value.shape[2:])), dim=1)


def _inverse(order: IntArray) -> Tensor:
    return torch.from_numpy(np.argsort(order))


def _drive(file: WindowFile, row: int) -> str:
    return f"{file.source}|{file.map_name}|{file.scene_names[file.scene[row]]}"
