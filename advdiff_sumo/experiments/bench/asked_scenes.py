"""The seed scenes that a bench is asked for: of a list, of the user's own nets, or out of a driving log.

Of a log it is the paper's own setting, a window a second of every drive; of nets what ``advdiff-sumo run`` finds there.
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
from advdiff_sumo.sim.logs import LoggedTraffic
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sim.training_windows.log_nets import LogNets, NoNetError
from advdiff_sumo.sweep.fingerprint import file_digest, net_files

LOG_HORIZON_S = 6.0
"""Future of a window: with 2 s of history the paper's segments of 8 s (Sec. IV)."""
LOG_STRIDE_S = 1.0
NETS = "nets"
"""Folder of converted nets within a bench's folder."""
_TOLD = 3  # drives in a message
_LOG_FILES = (".pkl", ".parquet", ".xml", ".gz")
_OF_A_LIST = ("background_options", "target_options")
"""Options that do not decide where a list's scenes begin."""


def is_log(asked: str) -> bool:
    """Return whether ``--scenes`` names a driving log: a folder, or a file of a kind that logs have."""
    path = Path(asked)
    return path.is_dir() or (path.is_file() and path.suffix in _LOG_FILES)


def bench_scenes(asked: str, name: str, folder: Path | None) -> SceneList:
    """Return the seed scenes that ``--scenes`` asks for, of a list or of a driving log.

    Args:
        asked: a number, the file of a list, or the root of a log.
        name: shipped list that a number is of.
        folder: of the bench, where nets are kept; None: of a log it is only looked at whether it can be opened.

    Raises:
        InputError: there is no such list, number or log, or no drive of the log can be used.
    """
    if not is_log(asked):
        return choose_scenes(asked, name)
    log = Path(asked).resolve()
    reader = open_log(log)
    if folder is None:
        return SceneList(nets={}, sumo=version("libsumo"), scenes=(), log=str(log))
    return scenes_of_log(log, reader, folder / NETS)


def scenes_of_log(log: Path, reader: LogReader, folder: Path) -> SceneList:
    """Return a scene a second of every drive, drives and then nets in turn, on nets converted from the log's maps.

    Args:
        log: root of the log.
        reader: of it.
        folder: where the nets are, or are put.

    Raises:
        InputError: a map cannot be converted, or no drive is on its net.
    """
    options = SceneOptions(stride_s=LOG_STRIDE_S)
    roads, left_out = _roads(reader, folder)
    by_net = {net: _usable(road, reader, options) for net, road in roads.items()}
    if not by_net:
        raise SceneError(
            f"{log}: none of its drives is on a net of its own map ({'; '.join(left_out[:_TOLD])})"
        )
    if not any(by_net.values()):
        raise SceneError(f"{log}: its ego never drives along a lane with 1.5 s to come; give other drives")
    turns = max(by_net.values())
    scenes = tuple(
        ListedScene(net=net, seed=0, number=number)
        for number in range(turns)
        for net, count in by_net.items()
        if number < count
    )
    whole = SceneList(
        about="; ".join(("a window a second of a driving log", *left_out)),
        nets={net: file_digest(*net_files(net)) for net in by_net},
        sumo=version("libsumo"),
        horizon_s=LOG_HORIZON_S,
        scene=options,
        scenes=scenes,
        log=str(log),
    )
    return whole.model_copy(update={"sha256": whole.content_digest})


def _roads(reader: LogReader, folder: Path) -> tuple[dict[str, RoadMap], list[str]]:
    """Return the nets of all drives, by path and in its order, and which drives are left out and why."""
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
    """Return how many episodes can begin on *road* with the whole window to come, or what a short log has of it."""
    traffic = LoggedTraffic(road, reader, options, SimOptions(), SeedTree(0), late=False)
    return sum(1 for _ in traffic.scenes())


def asked_scenes(request: Request, name: str, folder: Path | None) -> SceneList:
    """Return the seed scenes that the request asks for: of nets, of a list, or of a driving log.

    Args:
        request: what is asked.
        name: shipped list that a number without nets is of.
        folder: of the bench, as :func:`bench_scenes` takes it.

    Raises:
        InputError: there is no such net, list or log, both nets and a list are given, or an option is impossible.
    """
    own = request.episode
    if request.nets:
        return _scenes_of_nets(request)
    others = sorted(own.model_fields_set - {*_OF_A_LIST})
    if others:
        raise ConfigError(f"--set {others[0]}: a list has its own; add --net, or leave it out")
    return bench_scenes(request.scenes, name, folder)


def _scenes_of_nets(request: Request) -> SceneList:
    """Return the first ``request.scenes`` of the nets in turn; of one net scenes 0, 1, … of a run with that seed."""
    if not request.scenes.isdigit():
        raise ConfigError(
            f"--scenes {request.scenes}: has its own nets; give the number of scenes on --net, or leave --net out "
            "(a folder goes on with what it was begun with; another --out begins anew)"
        )
    count = int(request.scenes)
    if count < 1:
        raise ConfigError(f"--scenes {count}: give a number above 0")
    nets = tuple(dict.fromkeys(net_name(net) for net in request.nets))
    own = request.episode
    each = -(-count // len(nets))
    whole = make_list(each, own.seed, "the first seed scenes of own nets", nets, own.scene, request.horizon_s)
    return whole.model_copy(update={"demand": own.demand}).first(count)
