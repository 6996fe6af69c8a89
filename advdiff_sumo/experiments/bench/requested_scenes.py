"""Finds the seed scenes of a bench: of a list, of the user's own nets, or of a driving log.

A log gives one scene for each second of every drive, as in the paper. Nets give the scenes of ``advdiff-sumo run``.
"""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

from advdiff_sumo.core.errors import ConfigError, SceneError
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.data import open_log
from advdiff_sumo.data.log_reader import LogReader
from advdiff_sumo.experiments.bench.bench_config import Request
from advdiff_sumo.experiments.bench.scene_list import ListedScene, SceneList, choose_scenes, make_list
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.shipped_nets import net_name
from advdiff_sumo.sim.demand_files import read_demand
from advdiff_sumo.sim.logs import LoggedTraffic
from advdiff_sumo.sim.run_episodes import RunOptions, read_road
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sim.training_windows.log_nets import LogNets, NoNetError
from advdiff_sumo.sweep.fingerprint import file_digest, net_files

LOG_HORIZON_S = 6.0
"""Future of a window: with 2 s of history the paper's segments of 8 s (Sec. IV)."""
LOG_STRIDE_S = 1.0
NETS = "nets"
"""Folder of converted nets within a bench's folder."""
_MAX_NAMED_DRIVES = 3  # in a message
_LOG_FILES = (".pkl", ".parquet", ".xml", ".gz")
_ALLOWED_WITH_LIST = ("background_options", "target_options")
"""Options that may be set with a list, as they do not change its scenes."""


def is_log(requested: str) -> bool:
    """Return whether ``--scenes`` names a driving log: a folder, or a file with the suffix of a log."""
    path = Path(requested)
    return path.is_dir() or (path.is_file() and path.suffix in _LOG_FILES)


def bench_scenes(requested: str, name: str, folder: Path | None) -> SceneList:
    """Return the seed scenes of ``--scenes``, of a list or of a driving log.

    Args:
        requested: a number, the file of a list, or the root of a log.
        name: the shipped list, if *requested* is a number.
        folder: of the bench, where nets are stored. None: a log is only opened, and the returned list is empty.

    Raises:
        InputError: there is no such list, number or log, or no drive of the log can be used.
    """
    if not is_log(requested):
        return choose_scenes(requested, name)
    log = Path(requested).resolve()
    reader = open_log(log)
    if folder is None:
        return SceneList(nets={}, sumo=version("libsumo"), scenes=(), log=str(log))
    return scenes_of_log(log, reader, folder / NETS)


def scenes_of_log(log: Path, reader: LogReader, folder: Path) -> SceneList:
    """Return one scene for each second of every drive, the nets in turn, on nets converted from the log's maps.

    Args:
        log: root of the log.
        reader: of it.
        folder: of the nets; missing ones are converted.

    Raises:
        InputError: a map cannot be converted, or no drive is on its net.
    """
    options = SceneOptions(stride_s=LOG_STRIDE_S)
    roads, left_out = _roads(reader, folder)
    by_net = {net: _usable(road, reader, options) for net, road in roads.items()}
    if not by_net:
        raise SceneError(
            f"{log}: none of its drives is on a net of its own map ({'; '.join(left_out[:_MAX_NAMED_DRIVES])})"
        )
    if not any(by_net.values()):
        raise SceneError(f"{log}: its ego never drives along a lane with 1.5 s to come; give other drives")
    most_scenes = max(by_net.values())
    scenes = tuple(
        ListedScene(net=net, seed=0, number=number)
        for number in range(most_scenes)
        for net, count in by_net.items()
        if number < count
    )
    return SceneList(
        about="; ".join(("a window a second of a driving log", *left_out)),
        nets={net: file_digest(*net_files(net)) for net in by_net},
        sumo=version("libsumo"),
        horizon_s=LOG_HORIZON_S,
        scene=options,
        scenes=scenes,
        log=str(log),
    ).sealed()


def _roads(reader: LogReader, folder: Path) -> tuple[dict[str, RoadMap], list[str]]:
    """Return the nets of all drives by path, sorted, and for each excluded drive the reason."""
    nets, roads, left_out = LogNets((), folder), dict[str, RoadMap](), list[str]()
    for drive in reader.scenes():
        try:
            road = nets.of(drive, reader)
        except NoNetError as error:
            left_out.append(f"without {drive.name}: {error}")
        else:
            roads[str(road.path)] = road
    return dict(sorted(roads.items())), left_out


def _usable(road: RoadMap, reader: LogReader, options: SceneOptions) -> int:
    """Return how many seed scenes the log has on *road* with a full window ahead, or the rest of a shorter log."""
    traffic = LoggedTraffic(road, reader, options, SimOptions(), SeedTree(0), late=False)
    return sum(1 for _ in traffic.scenes())


def requested_scenes(request: Request, name: str, folder: Path | None) -> SceneList:
    """Return the seed scenes of the request: of nets, of a list, or of a driving log.

    Args:
        request: of the bench.
        name: the shipped list, if the request gives a number without nets.
        folder: of the bench, as in :func:`bench_scenes`.

    Raises:
        InputError: there is no such net, list or log, both nets and a list are given, or an option is impossible.
    """
    episode_options = request.episode
    if request.nets:
        return _scenes_of_nets(request)
    forbidden = sorted(episode_options.model_fields_set - {*_ALLOWED_WITH_LIST})
    if forbidden:
        raise ConfigError(f"--set {forbidden[0]}: a list has its own; add --net, or leave it out")
    return bench_scenes(request.scenes, name, folder)


def _scenes_of_nets(request: Request) -> SceneList:
    """Return the first ``request.scenes`` scenes, nets in turn; on each net scenes 0, 1, … of a run with that seed."""
    try:
        count = int(request.scenes)
    except ValueError:
        raise ConfigError(
            f"--scenes {request.scenes}: has its own nets; give the number of scenes on --net, or leave --net out "
            "(a folder goes on with what it was begun with; another --out begins anew)"
        ) from None
    if count < 1:
        raise ConfigError(f"--scenes {count}: give a number above 0")
    nets = tuple(dict.fromkeys(net_name(net) for net in request.nets))
    episode_options = request.episode
    for net in nets:
        _check_demand(net, episode_options.demand)
    per_net = -(-count // len(nets))
    scene_list = make_list(
        per_net,
        episode_options.seed,
        "the first seed scenes of own nets",
        nets,
        episode_options.scene,
        request.horizon_s,
    )
    return scene_list.model_copy(update={"demand": episode_options.demand}).first(count)


def _check_demand(net: str, demand: str) -> None:
    """Check the demand of *net*, its configuration's if *demand* is empty, as a folder that is begun keeps its options.

    Raises:
        InputError: the demand is missing, damaged, or of another net.
    """
    options = RunOptions.parse({"net": net, "demand": demand})
    if options.demand:
        read_demand(Path(options.demand), read_road(options.net))
