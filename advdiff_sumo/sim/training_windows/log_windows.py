"""Make window files from driving logs, on nets that were given or are converted from the logs' own maps."""

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
_MAX_FOCAL = 8  # focal agents in a window
_MIN_INSTANTS = 4  # of past, and of future, that a focal agent other than the ego must have
_MOVING_M = 1.0  # an agent moves if it gets farther than this from where it is
_TOO_SHORT = "too short for a window of 8 s"


@dataclass(frozen=True)
class BuildOptions:
    """Which windows are made.

    Attributes:
        stride_s: time between two windows of a drive.
        others: whether moving vehicles other than the ego also become focal agents.
        split: published nuScenes split; None: all scenes.
        challenge: make the windows of nuScenes' prediction challenge only.
        view: how much of the map the windows contain.
    """

    stride_s: float = DT_S
    others: bool = True
    split: str | None = None
    challenge: bool = False
    view: MapView = "near"


@dataclass(frozen=True)
class Skipped:
    """A drive without windows, and the reason."""

    drive: str
    reason: str


@dataclass
class Built:
    """Result of building windows from logs.

    Attributes:
        files: path → number of windows in it.
        drives: name and number of windows of each drive, in the order of the logs.
        skipped: drives without windows.
    """

    files: dict[Path, int] = field(default_factory=dict)
    drives: list[tuple[str, int]] = field(default_factory=list)
    skipped: list[Skipped] = field(default_factory=list)

    def count(self, drive: LogScene, windows: int) -> None:
        """Note that *drive* has a net and gave *windows* windows."""
        self.drives.append((drive.name, windows))
        if not windows:
            self.skipped.append(Skipped(drive.name, _TOO_SHORT))


def build(
    logs: Sequence[tuple[Path, LogReader]],
    nets: LogNets,
    options: BuildOptions,
    out: Path,
    on_drive: Callable[[str, int], None],
) -> Built:
    """Write the windows of all drives in *logs*, one file for each net.

    Args:
        logs: logs with their readers.
        nets: nets to choose from.
        options: which windows.
        out: a ``.safetensors`` file if all drives are on one net, or a folder.
        on_drive: called with each drive's name and its number of windows.

    Raises:
        InputError: a log or a net cannot be used, or no drive is on any of the nets.
    """
    built, builders, name_counts = Built(), dict[Path, WindowFileBuilder](), Counter[str]()
    for path, reader in logs:
        for drive, focal in _drives(path, reader, options):
            count = 0
            name_counts[drive.name] += 1
            try:
                road = nets.of(drive, reader)
            except NoNetError as error:
                built.skipped.append(Skipped(drive.name, str(error)))
            else:
                count = _add_windows(
                    _with_unique_name(drive, name_counts[drive.name]), road, options, focal, builders
                )
                built.count(drive, count)
            on_drive(drive.name, count)
    names = distinct_names({net: base_name(net) for net in builders})
    window_files = {
        names[net]: replace(builder, map_name=names[net]).build()
        for net, builder in builders.items()
        if builder.windows
    }
    if not window_files:
        raise SceneError(_why_none(logs, nets, built))
    for path, windows in _with_paths(out, window_files):
        write_windows(path, windows)
        built.files[path] = windows.windows
    return built


def _with_unique_name(drive: LogScene, number: int) -> LogScene:
    """Return *drive*, with *number* added to its name if it is not the first of that name."""
    return drive if number == 1 else replace(drive, name=f"{drive.name}-{number}")


def _add_windows(
    drive: LogScene,
    road: RoadMap,
    options: BuildOptions,
    focal: Sequence[tuple[int, str]] | None,
    builders: dict[Path, WindowFileBuilder],
) -> int:
    """Add the windows of *drive* to those of its net, and return their number."""
    source = f"{_SOURCE} ({drive.source.name})"
    table = road.pieces(options.view)
    builder = builders.setdefault(road.path, WindowFileBuilder(table, road.name, source))
    old_count = len(builder.windows)
    builder.windows += log_windows(drive, road, options, focal)
    return len(builder.windows) - old_count


def log_windows(
    drive: LogScene,
    road: RoadMap,
    options: BuildOptions,
    focal: Sequence[tuple[int, str]] | None = None,
) -> Iterator[WindowArrays]:
    """Yield the windows of *drive* on *road* with all of their future inside the drive.

    Args:
        drive: at any spacing; resampled to 0.5 s if necessary.
        road: the net on which it was driven.
        options: the stride, and whether agents other than the ego are focal.
        focal: use only these (instant, agent) pairs; their windows may extend beyond the end of the drive.
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
        for rows in crops(tracks.xy_m[:, now], order, _MAX_FOCAL):
            yield window_arrays(tracks, now, rows, drive.parked, table, {}, drive.name)


def _focal_order(tracks: Tracks, now: int, drive: LogScene, others: bool) -> IntArray:
    """Return the ego, if present, then other vehicles that move and are visible long enough."""
    past_count = tracks.valid[:, now - PAST + 1 : now + 1].sum(axis=1)
    future_count = tracks.valid[:, now + 1 : now + 1 + FUTURE].sum(axis=1)
    is_moving = _displacement_m(tracks.xy_m[:, now : now + 1 + FUTURE]) > _MOVING_M
    is_vehicle = tracks.classes != AgentClass.PEDESTRIAN
    is_usable: BoolArray = (
        (past_count >= _MIN_INSTANTS)
        & (future_count >= _MIN_INSTANTS)
        & is_moving
        & is_vehicle
        & ~drive.parked
    )
    is_usable = is_usable & tracks.valid[:, now] & others
    is_usable[drive.ego] = False
    first = [drive.ego] if tracks.valid[drive.ego, now] else []
    return np.concatenate((first, np.flatnonzero(is_usable))).astype(np.int64)


def _displacement_m(xy_m: FloatArray) -> FloatArray:
    """Return (A,) the largest distance of each agent from its first position, for positions (A, L, 2)."""
    distance = np.linalg.norm(xy_m - xy_m[:, :1], axis=-1)
    return np.asarray(np.nan_to_num(distance).max(axis=1))


def _drives(
    path: Path, reader: LogReader, options: BuildOptions
) -> Iterator[tuple[LogScene, list[tuple[int, str]] | None]]:
    """Yield the drives of the split, each with the challenge's (instant, agent) pairs if these are requested."""
    if not isinstance(reader, NuScenesReader):
        if options.split or options.challenge:
            option = "--challenge" if options.challenge else f"--split {options.split}"
            raise ConfigError(f"{option} goes with the tables of nuScenes only, and {path} is another log")
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
            focal = _challenge_instants(reader.instants(name), wanted_windows[name], name, path)
        yield reader.read(name), focal


def _challenge_instants(
    instants: Mapping[str, int], wanted: Sequence[tuple[str, str]], name: str, path: Path
) -> list[tuple[int, str]]:
    """Return (instant, agent) pairs of the *wanted* (agent, sample) pairs."""
    unknown = next((sample for _, sample in wanted if sample not in instants), None)
    if unknown is not None:
        problem = f"the prediction challenge names sample {unknown}, which {name} does not have"
        raise LogError(path, problem, "use tables and map expansion of one release")
    return [(instants[sample], instance) for instance, sample in wanted]


def _with_paths(out: Path, files: Mapping[str, WindowFile]) -> Iterator[tuple[Path, WindowFile]]:
    """Yield (path, windows) of the files to write: *out* itself, or one file for each net in the folder *out*."""
    if out.suffix == SUFFIX:
        if len(files) > 1:
            raise ConfigError(
                f"--out {out}: the drives are on {len(files)} nets ({', '.join(sorted(files))}) and a file holds "
                "one; name a folder"
            )
        make_folder(out.parent)
        yield out, next(iter(files.values()))
        return
    make_folder(out)
    yield from ((out / f"{name}{SUFFIX}", files[name]) for name in sorted(files))


def _why_none(logs: Sequence[tuple[Path, LogReader]], nets: LogNets, built: Built) -> str:
    """Return why there are no windows at all, as a sentence."""
    first = logs[0][0]
    if not built.drives and not nets.given and nets.converted is None:
        return f"{first}: no net was given for its drives; name one with --net, or add --convert"
    reasons = Counter(skipped.reason for skipped in built.skipped)
    listed = "; ".join(f"{count} of {reasons.total()}: {reason}" for reason, count in reasons.most_common(3))
    return f"{first}: none of the {reasons.total()} drives gives a window ({listed})"
