"""Window files out of driving logs, on nets that were given or are converted from the logs' own maps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.distinct_names import distinct_names
from advdiff_sumo.core.errors import ConfigError, LogError, SceneError
from advdiff_sumo.core.map_view import MapView
from advdiff_sumo.core.resample import resample
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.core.whole_file import make_folder
from advdiff_sumo.data import LogReader, LogScene, NuScenesReader
from advdiff_sumo.data.splits import in_split, prediction_windows
from advdiff_sumo.data.window_arrays import WindowArrays, WindowFileBuilder, crop, crops, window_arrays
from advdiff_sumo.data.window_files import DT_S, FUTURE, PAST, SUFFIX, WindowFile, write_windows
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.read_net import base_name
from advdiff_sumo.sim.training_windows.log_nets import LogNets, NoNetError

_SOURCE = "advdiff-sumo data build"
_MOST_FOCAL = 8
_SEEN = 4  # instants of past and of future that a focal agent other than the ego must have
_MOVING_M = 1.0
_TOO_SHORT = "too short for a window of 8 s"


@dataclass(frozen=True)
class BuildOptions:
    """Which windows are taken.

    Attributes:
        stride_s: time between two windows of a drive.
        others: whether moving vehicles other than the ego become focal agents too.
        split: published nuScenes split, or None for all scenes.
        challenge: take the windows of nuScenes' prediction challenge and no others.
        view: how much of the map they show.
    """

    stride_s: float = DT_S
    others: bool = True
    split: str | None = None
    challenge: bool = False
    view: MapView = "near"


@dataclass(frozen=True)
class Skipped:
    """A drive that gave no window, and why."""

    drive: str
    reason: str


@dataclass
class Built:
    """What became of the logs.

    Attributes:
        files: path → windows in it.
        drives: name and number of windows of each drive, in the order of the logs.
        skipped: drives without windows.
    """

    files: dict[Path, int] = field(default_factory=dict)
    drives: list[tuple[str, int]] = field(default_factory=list)
    skipped: list[Skipped] = field(default_factory=list)

    def count(self, drive: LogScene, windows: int) -> None:
        """Note that *drive* is on a net and gave *windows*."""
        self.drives.append((drive.name, windows))
        if not windows:
            self.skipped.append(Skipped(drive.name, _TOO_SHORT))


def build(
    logs: Sequence[tuple[Path, LogReader]],
    nets: LogNets,
    options: BuildOptions,
    out: Path,
    tell: Callable[[str, int], None],
) -> Built:
    """Write the windows of all drives in *logs*, one file a net.

    Args:
        logs: logs with their readers.
        nets: nets to choose from.
        options: which windows.
        out: a ``.safetensors`` file where all drives are on one net, or a folder.
        tell: called with each drive's name and its number of windows.

    Raises:
        InputError: a log or a net cannot be used, or no drive is on any of the nets.
    """
    built, builders, seen = Built(), dict[Path, WindowFileBuilder](), Counter[str]()
    for path, reader in logs:
        for drive, focal in _drives(path, reader, options):
            count = 0
            seen[drive.name] += 1
            try:
                road = nets.of(drive, reader)
            except NoNetError as error:
                built.skipped.append(Skipped(drive.name, str(error)))
            else:
                count = _add(_renamed(drive, seen[drive.name]), road, options, focal, builders)
                built.count(drive, count)
            tell(drive.name, count)
    names = distinct_names({net: base_name(net) for net in builders})
    window_files = {
        names[net]: replace(b, map_name=names[net]).build() for net, b in builders.items() if b.windows
    }
    if not window_files:
        raise SceneError(_nothing(logs, nets, built))
    for path, windows in _placed(out, window_files):
        write_windows(path, windows)
        built.files[path] = windows.windows
    return built


def _renamed(drive: LogScene, number: int) -> LogScene:
    """Return *drive* under a name of its own, where it is the *number*-th of its name."""
    return drive if number == 1 else replace(drive, name=f"{drive.name}-{number}")


def _add(
    drive: LogScene,
    road: RoadMap,
    options: BuildOptions,
    focal: Sequence[tuple[int, str]] | None,
    builders: dict[Path, WindowFileBuilder],
) -> int:
    """Add the windows of *drive* to those of its net, and return how many they are."""
    source = f"{_SOURCE} ({drive.source.name})"
    table = road.pieces(options.view)
    builder = builders.setdefault(road.path, WindowFileBuilder(table, road.name, source))
    before = len(builder.windows)
    builder.windows += log_windows(drive, road, options, focal)
    return len(builder.windows) - before


def log_windows(
    drive: LogScene,
    road: RoadMap,
    options: BuildOptions,
    focal: Sequence[tuple[int, str]] | None = None,
) -> Iterator[WindowArrays]:
    """Yield the windows of *drive* on *road* that have their whole future within the drive.

    Args:
        drive: at any spacing; resampled to 0.5 s where its own differs.
        road: the net it was driven on.
        options: the stride, and whether others than the ego are focal.
        focal: (instant, agent) pairs to take and no others; windows may then end with the drive.
    """
    table = road.pieces(options.view)
    tracks = drive.tracks if abs(drive.tracks.dt_s - DT_S) < 1e-9 else resample(drive.tracks, DT_S)
    if focal is not None:
        for now, name in focal:
            row = tracks.index.get(name)
            if row is not None and now < tracks.steps and tracks.valid[row, now]:
                rows = crop(tracks.xy_m[:, now], row)
                yield window_arrays(tracks, now, rows, drive.parked, table, {}, drive.name)
        return
    stride = max(1, round(options.stride_s / DT_S))
    for now in range(PAST - 1, tracks.steps - FUTURE, stride):
        order = _focal_order(tracks, now, drive, options.others)
        for rows in crops(tracks.xy_m[:, now], order, _MOST_FOCAL):
            yield window_arrays(tracks, now, rows, drive.parked, table, {}, drive.name)


def _focal_order(tracks: Tracks, now: int, drive: LogScene, others: bool) -> IntArray:
    """Return the ego, where it is there, then other vehicles that move and are seen long enough."""
    past = tracks.valid[:, now - PAST + 1 : now + 1].sum(axis=1)
    future = tracks.valid[:, now + 1 : now + 1 + FUTURE].sum(axis=1)
    moves = _moved_m(tracks.xy_m[:, now : now + 1 + FUTURE]) > _MOVING_M
    on_wheels = tracks.classes != AgentClass.PEDESTRIAN
    usable: BoolArray = (past >= _SEEN) & (future >= _SEEN) & moves & on_wheels & ~drive.parked
    usable = usable & tracks.valid[:, now] & others
    usable[drive.ego] = False
    first = [drive.ego] if tracks.valid[drive.ego, now] else []
    return np.concatenate((first, np.flatnonzero(usable))).astype(np.int64)


def _moved_m(xy_m: FloatArray) -> FloatArray:
    away = np.linalg.norm(xy_m - xy_m[:, :1], axis=-1)
    return np.asarray(np.nan_to_num(away).max(axis=1))


def _drives(
    path: Path, reader: LogReader, options: BuildOptions
) -> Iterator[tuple[LogScene, list[tuple[int, str]] | None]]:
    """Yield the drives of the split, with the challenge's windows where these are asked for."""
    if not isinstance(reader, NuScenesReader):
        if options.split or options.challenge:
            wanted = "--challenge" if options.challenge else f"--split {options.split}"
            raise ConfigError(f"{wanted} goes with the tables of nuScenes only, and {path} is another log")
        yield from ((drive, None) for drive in reader.scenes())
        return
    wanted_windows = prediction_windows(reader.folder.parent) if options.challenge else None
    names = [
        name
        for name in reader.names()
        if (options.split is None or in_split(name, options.split, options.challenge))
        and (wanted_windows is None or name in wanted_windows)
    ]
    if not names:
        raise SceneError(
            f"{path}: none of its scenes is in the split '{options.split}'; choose another --split"
        )
    for name in names:
        focal = None
        if wanted_windows is not None:
            focal = _instants(reader.instants(name), wanted_windows[name], name, path)
        yield reader.read(name), focal


def _instants(
    instants: Mapping[str, int], wanted: Sequence[tuple[str, str]], name: str, path: Path
) -> list[tuple[int, str]]:
    unknown = next((sample for _, sample in wanted if sample not in instants), None)
    if unknown is not None:
        problem = f"the prediction challenge names sample {unknown}, which {name} does not have"
        raise LogError(path, problem, "use tables and map expansion of one release")
    return [(instants[sample], instance) for instance, sample in wanted]


def _placed(out: Path, placed: Mapping[str, WindowFile]) -> Iterator[tuple[Path, WindowFile]]:
    if out.suffix == SUFFIX:
        if len(placed) > 1:
            raise ConfigError(
                f"--out {out}: the drives are on {len(placed)} nets ({', '.join(sorted(placed))}) and a file holds "
                "one; name a folder"
            )
        make_folder(out.parent)
        yield out, next(iter(placed.values()))
        return
    make_folder(out)
    yield from ((out / f"{name}{SUFFIX}", placed[name]) for name in sorted(placed))


def _nothing(logs: Sequence[tuple[Path, LogReader]], nets: LogNets, built: Built) -> str:
    first = logs[0][0]
    if not built.drives and not nets.given and nets.converted is None:
        return f"{first}: no net was given for its drives; name one with --net, or add --convert"
    reasons = Counter(one.reason for one in built.skipped)
    hindrances = "; ".join(
        f"{count} of {reasons.total()}: {reason}" for reason, count in reasons.most_common(3)
    )
    return f"{first}: none of the {reasons.total()} drives gives a window ({hindrances})"
