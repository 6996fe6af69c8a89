"""Make window files from natural SUMO traffic on many nets: plan them, let workers make them, keep complete ones."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from pebble import ProcessExpired
from pydantic import Field

from advdiff_sumo.config import Options
from advdiff_sumo.core.errors import AdvdiffError, FileError, NetError, SimulationError
from advdiff_sumo.core.map_view import MapView
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.core.whole_file import make_folder
from advdiff_sumo.core.worker_pool import futures_of
from advdiff_sumo.data.window_arrays import WindowFileBuilder
from advdiff_sumo.data.window_files import DRIVEN, SUFFIX, read_windows, write_windows
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.read_net import base_name
from advdiff_sumo.maps.shipped_nets import NETS_BY_NAME, SHIPPED_NETS, find_net
from advdiff_sumo.maps.sidecar import sidecar_of
from advdiff_sumo.sim.training_windows.handback import DrivingModel, record_handbacks
from advdiff_sumo.sim.training_windows.random_nets import KINDS, write_random_net
from advdiff_sumo.sim.training_windows.simulation_run import Recording, cut, record

SHARD_WINDOWS = 300  # average number in a file
RUN_WINDOWS = 200  # largest number from one simulation
_MAX_RUNS = 8  # simulations for one file
_MAX_NET_ATTEMPTS = 5
_NETS = "nets"


class SimulateOptions(Options):
    """What to simulate.

    Attributes:
        windows: total number of windows.
        nets: nets given by path or shipped name.
        random_share: share of the windows that come from random nets.
        view: how much of the map the windows contain.
        driven_by: weights, by path or shipped name, of a model that drives before SUMO's drivers take over; "": SUMO
            drives all the time.
        seed: the same seed gives the same bytes.
    """

    windows: int = Field(24_000, ge=1)
    nets: tuple[str, ...] = SHIPPED_NETS
    random_share: float = Field(0.5, ge=0.0, le=1.0)
    view: MapView = "near"
    driven_by: str = ""
    seed: int = 0


@dataclass(frozen=True)
class Shard:
    """One file to be made: windows of one net.

    Attributes:
        name: of the file, without suffix.
        net: file of the net; None: a random one is made.
        kind: of the random net; "" for a given one.
        seed: the shard's node of the seed tree.
        windows: how many.
        view: how much of the map they contain.
        model: drives before SUMO's drivers take over; None: SUMO drives all the time.
    """

    name: str
    net: Path | None
    kind: str
    seed: SeedTree
    windows: int
    view: MapView = "near"
    model: DrivingModel | None = None

    @property
    def recipe(self) -> str:
        """Everything on which the file's bytes depend, as text in its header."""
        net = "random" if self.net is None else _identity(self.net)
        view = [] if self.view == "near" else [self.view]
        driver = [] if self.model is None else [f"driven by {self.model.digest}"]
        return json.dumps([self.name, net, self.seed.root, *self.seed.path, self.windows, *view, *driver])

    def stretches(self, road: RoadMap, run: int) -> Iterator[Recording]:
        """Yield recordings of simulation *run* on *road*."""
        seed = self.seed.child("run", run)
        if self.model is None:
            yield record(road, seed)
        else:
            yield from record_handbacks(road, seed, self.model)


@dataclass(frozen=True)
class ShardResult:
    """Result of a shard: the number of its windows, or why it failed."""

    shard: Shard
    windows: int
    problem: str = ""


def plan(options: SimulateOptions) -> list[Shard]:
    """Return the shards of *options*, on given and random nets in turn.

    Raises:
        NetError: a net does not exist or cannot be used.
        WeightsError: there are no such weights, or their model cannot drive.
    """
    model = DrivingModel.read(options.driven_by) if options.driven_by else None
    nets = [find_net(shard_net) for shard_net in options.nets] if options.random_share < 1.0 else []
    for net in nets:
        RoadMap.read(net)
    if not nets and options.random_share < 1.0:
        raise NetError(Path("--net"), "no net was given", "name one, or ask for made-up nets alone")
    count = max(1, round(options.windows / SHARD_WINDOWS))
    sizes = [options.windows * (k + 1) // count - options.windows * k // count for k in range(count)]
    seed, shards = SeedTree(options.seed).child("simulate"), list[Shard]()
    for number, size in enumerate(sizes):
        random_before, random_after = (int(n * options.random_share + 1e-9) for n in (number, number + 1))
        shard_net = None if random_after > random_before else nets[(number - random_before) % len(nets)]
        kind = KINDS[random_before % len(KINDS)] if shard_net is None else ""
        name = f"{kind if shard_net is None else base_name(shard_net)}-{options.seed}-{number:04d}"
        shards.append(Shard(name, shard_net, kind, seed.child(number), size, options.view, model))
    return shards


def simulate(
    shards: Sequence[Shard], out: Path, workers: int, on_shard: Callable[[ShardResult], None]
) -> list[ShardResult]:
    """Make those of *shards* that *out* lacks.

    Args:
        shards: see :func:`plan`.
        out: folder of the files; random nets are kept in its sub-folder ``nets``.
        workers: number of processes; the files do not depend on it.
        on_shard: called with each shard when it is finished or was found complete.

    Returns:
        All shards in their order.

    Raises:
        InputError: *out* cannot be made, or contains files made with other options.
        SimulationError: shards failed; the others are complete.
    """
    done = {
        shard.name: ShardResult(shard, count) for shard in shards if (count := _complete_windows(shard, out))
    }
    make_folder(out / _NETS)
    for result in done.values():
        on_shard(result)
    for result in _make_shards([s for s in shards if s.name not in done], out, workers):
        done[result.shard.name] = result
        on_shard(result)
    results = [done[shard.name] for shard in shards]
    failed = [result for result in results if result.problem]
    if failed:
        raise SimulationError(
            f"{len(failed)} of {len(results)} files could not be made, the first because: {failed[0].problem}"
        )
    return results


def _make_shards(shards: list[Shard], out: Path, workers: int) -> Iterator[ShardResult]:
    """Make *shards* on worker processes and yield the results as they finish."""
    for shard, done in futures_of(((shard, (make_shard, shard, out)) for shard in shards), workers):
        try:
            yield ShardResult(shard, done.result())
        except (AdvdiffError, ProcessExpired) as error:
            yield ShardResult(shard, 0, f"{shard.name}: {error}")


def make_shard(shard: Shard, out: Path) -> int:
    """Simulate *shard*, write its file into *out* and return its number of windows.

    Raises:
        SimulationError: SUMO stopped, or the net never has traffic.
        NetError: the net cannot be used.
    """
    road = _road(_make_random_net(shard, out) if shard.net is None else shard.net)
    table = road.pieces(shard.view)
    extra = {"recipe": shard.recipe, "net": _net_text(shard)}
    if shard.model is not None:
        extra[DRIVEN] = shard.model.digest
    builder = WindowFileBuilder(table, road.name, "advdiff-sumo data simulate", extra)
    run_windows = min(RUN_WINDOWS, -(-shard.windows // 2))
    for run in range(_MAX_RUNS):
        seed = shard.seed.child("run", run)
        windows = [
            window
            for number, recording in enumerate(shard.stretches(road, run))
            for window in cut(recording, table, seed.child(number) if number else seed, f"{shard.name}-{run}")
        ]
        window_count = min(run_windows, shard.windows - len(builder.windows))
        rng = seed.child("choice").generator()
        picked = sorted(rng.permutation(len(windows))[:window_count].tolist())
        builder.windows += [windows[k] for k in picked]
        if len(builder.windows) == shard.windows:
            break
    if not builder.windows:
        raise SimulationError(f"{road.path}: {_MAX_RUNS} simulations brought no window with moving traffic")
    write_windows(out / f"{shard.name}{SUFFIX}", builder.build())
    return len(builder.windows)


@lru_cache(maxsize=64)
def _identity(net: Path) -> str:
    """Return text that identifies *net*: the name of a shipped net, else the file's name and a digest of it."""
    if any(net == find_net(name) for name in NETS_BY_NAME):
        return net.name
    sidecar = sidecar_of(net)
    content = net.read_bytes() + (b"" if sidecar is None else sidecar.read_bytes())
    return f"{net.name} {hashlib.sha256(content).hexdigest()[:16]}"


def _net_text(shard: Shard) -> str:
    """Return the net's name in the header of the shard's file."""
    return shard.net.name if shard.net is not None else f"{_NETS}/{shard.name}.net.xml"


def _make_random_net(shard: Shard, out: Path) -> Path:
    """Write the random net of *shard* and return its path; repeat the draw while traffic could not circulate on it."""
    path = out / _NETS / f"{shard.name}.net.xml"
    for attempt in range(_MAX_NET_ATTEMPTS):
        seed = shard.seed.child("net", *((attempt,) if attempt else ()))
        try:
            road = RoadMap.read(write_random_net(shard.kind, seed, path))
        except NetError:
            continue
        if len(road.edge_graph().strongly_connected()) > 1 or shard.kind == "motorway":
            return path
    raise NetError(path, "no usable net could be made up", "take another --seed")


@lru_cache(maxsize=4)
def _road(path: Path) -> RoadMap:
    return RoadMap.read(path)


def _complete_windows(shard: Shard, out: Path) -> int:
    """Return the number of windows in the shard's file; 0 if it is still to be made."""
    path = out / f"{shard.name}{SUFFIX}"
    if not path.exists():
        return 0
    window_file = read_windows(path)
    if window_file.extra.get("recipe") != shard.recipe:
        raise FileError(path, "was made with other options", "choose another --out, or delete it")
    return window_file.windows
