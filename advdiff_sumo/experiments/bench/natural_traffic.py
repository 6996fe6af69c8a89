"""``bench traffic``: the paper's first table, open loop on windows that no weights were trained on."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import fields
from functools import lru_cache
from pathlib import Path

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.errors import ConfigError, did_you_mean
from advdiff_sumo.core.map_view import MapView
from advdiff_sumo.core.worker_pool import in_processes
from advdiff_sumo.experiments.bench.bench_config import Folder, Request
from advdiff_sumo.experiments.bench.intervals import Divergence, Ratio, Sample
from advdiff_sumo.experiments.bench.open_loop import MODELS, Counted, count
from advdiff_sumo.experiments.bench.reporter import ProgressReporter
from advdiff_sumo.experiments.bench.table import Head, RowSamples, Table, gaps_of, lines_of, paper_table
from advdiff_sumo.sim.training_windows.simulate import ShardResult, SimulateOptions, plan, simulate
from advdiff_sumo.sweep.fingerprint import digest
from advdiff_sumo.sweep.sweep_files import read_checked, write_checked
from advdiff_sumo.training.dataset import WindowSet, read_window_set

WINDOWS, WINDOWS_SEED, MADE_UP_SHARE = 1800, 9001, 0.5
"""The windows that are made where none are given: ``data simulate`` with these, half of them on made-up nets."""
VIEWS: tuple[MapView, ...] = ("near", "far")
CHUNK = 6
OURS, LOG = "diffusion", "log"
HEADS = (
    Head("min_sfde_m", "minSFDE", "m", digits=2, better="low"),
    Head("fdd_m", "FDD", "m", digits=2, better="high"),
    Head("jsd_speed", "JSD vel.", "10⁻²", 100.0, 2, "low"),
    Head("jsd_accel", "JSD acc.", "10⁻²", 100.0, 2, "low"),
    Head("jsd_ttc", "JSD TTC", "10⁻²", 100.0, 2, "low"),
    Head("env_rate", "env. coll.", "%", 100.0, 2, "low"),
    Head("veh_rate", "veh. coll.", "%", 100.0, 2, "low"),
)
NOTES = (
    "Columns as in the paper's Sec. IV, Metrics; docs/benches.md defines each. The paper's rows AdvSim and Strive are "
    "their generative baselines SimNet and TrafficSim. Intervals: Wilson for rates, of vehicles and samples; bootstrap "
    "over windows for the rest; 95 %. JSD is against the log, base 2.",
)


def run_traffic(folder: Folder, workers: int, teller: ProgressReporter) -> Table:
    """Count what is missing and return the table.

    Raises:
        InputError: a row is unknown, or a window file cannot be used.
    """
    names = chosen_models(folder.request, teller)
    counted: dict[str, Counted] = {}
    for view in VIEWS:
        seeing = tuple(name for name in names if MODELS[name].view == view or (name == LOG and not counted))
        if {*seeing} <= {LOG} and len(names) > 1:
            continue
        places = _windows(folder, workers, teller, view)
        windows = read_window_set(places)
        rows = spread_rows(len(windows), _wanted(folder.request.scenes, len(windows)))
        counted |= _counted(folder, seeing, windows, rows, places, workers, teller)
    scenes = tuple(str(row) for row in rows.tolist())
    samples = [_samples(name, counted, scenes, folder.request.seeds) for name in names]
    lines = lines_of(HEADS, samples, paper_table("traffic"))
    request = folder.request
    title = f"Natural traffic, open loop: {len(rows)} windows, {request.samples} samples each"
    source = (
        "given with --data" if request.data else f"data simulate --windows {WINDOWS} --seed {WINDOWS_SEED}"
    )
    revisions = ", ".join(revision[:10] for revision in folder.revisions)
    windows_note = f"Windows: {source}, sha256 {windows.digest[:16]}. Revision: {revisions}."
    return Table("traffic", title, HEADS, lines, gaps_of(HEADS, samples), (*NOTES, windows_note))


def check_traffic(request: Request, teller: ProgressReporter) -> None:
    """Look at what is asked before anything is made.

    Raises:
        InputError: a row or number makes no sense, or a window file cannot be used.
    """
    chosen_models(request, teller)
    _wanted(request.scenes, 1)


def chosen_models(request: Request, teller: ProgressReporter) -> tuple[str, ...]:
    """Return the rows: those asked for, or all whose weights ship; the log is always one of them.

    Rows whose networks see another view of the map than given windows show are left out.

    Raises:
        ConfigError: a row is unknown, or has no weights.
        FileError: a window file cannot be used.
    """
    asked = request.policies
    given = read_window_set([Path(place) for place in request.data]).map_view if request.data else None
    for name in asked:
        if name not in MODELS:
            raise ConfigError(
                f"--policies {name}: bench traffic has no such row; {did_you_mean(name, MODELS)}"
            )
        if not MODELS[name].there:
            raise ConfigError(
                f"--policies {name}: this installation has no {MODELS[name].weights} yet; leave it out"
            )
    for name, model in MODELS.items():
        if not asked and not model.there:
            teller.say(f"row {name} is left out: this installation has no {model.weights} yet")
    wanted = {LOG, *(asked or MODELS)}
    names = [name for name, model in MODELS.items() if name in wanted and model.there]
    blind = [name for name in names if given and name != LOG and MODELS[name].view != given]
    if blind:
        teller.say(
            f"left out: {', '.join(blind)}, whose networks see more or less of the map than the windows show"
        )
    return tuple(name for name in names if name not in blind)


def spread_rows(total: int, wanted: int) -> IntArray:
    """Return *wanted* of *total* windows, spread over all; fewer are contained in more.

    The order is that of the bit-reversed numbers (van der Corput), which fills gaps evenly.
    """
    bits = max(1, (total - 1).bit_length())
    order = [int(f"{k:0{bits}b}"[::-1], 2) for k in range(1 << bits)]
    return np.array([k for k in order if k < total][:wanted], dtype=np.int64)


def _wanted(asked: str, total: int) -> int:
    if not asked.isdigit() or int(asked) < 1:
        raise ConfigError(
            f"--scenes {asked}: give the number of windows, above 0; name their files with --data"
        )
    return min(int(asked), total)


def _windows(folder: Folder, workers: int, teller: ProgressReporter, view: MapView) -> list[Path]:
    """Return the window files: those given, or the ones of the map's *view* that this makes in the folder."""
    if folder.request.data:
        return [Path(place) for place in folder.request.data]
    default = folder.path / ("windows" if view == "near" else f"windows-{view}")
    made_up = SimulateOptions(windows=WINDOWS, seed=WINDOWS_SEED, random_share=MADE_UP_SHARE, view=view)
    shards = plan(made_up)
    default.mkdir(parents=True, exist_ok=True)
    teller.begin("files of windows", len(shards))

    def tell(_: ShardResult) -> None:
        teller.step()

    simulate(shards, default, workers, tell)
    return [default]


def _counted(
    folder: Folder,
    names: tuple[str, ...],
    windows: WindowSet,
    rows: IntArray,
    places: list[Path],
    workers: int,
    teller: ProgressReporter,
) -> dict[str, Counted]:
    """Return what is counted of each row, over the seeds; chunks of windows that the folder has are not repeated."""
    request, cache = folder.request, folder.path / "counted"
    cache.mkdir(parents=True, exist_ok=True)
    files = tuple(str(place) for place in places)
    chunks = [tuple(rows[k : k + CHUNK].tolist()) for k in range(0, len(rows), CHUNK)]
    wanted = {
        digest([windows.digest, name, chunk, request.samples, seed]): (name, chunk, seed)
        for name in names
        for seed in range(request.seeds)
        for chunk in chunks
    }
    there = {key for key in wanted if read_checked(cache / key) is not None}
    teller.begin("parts of the windows", len(wanted), len(there))
    tasks = {
        key: (count_chunk, files, name, chunk, request.samples, seed)
        for key, (name, chunk, seed) in wanted.items()
        if key not in there
    }
    for key, content in in_processes(tasks, workers):
        write_checked(cache / key, content)
        teller.step()
    by_seed: dict[str, list[Counted]] = {name: [] for name in names}
    for name in names:
        for seed in range(request.seeds):
            keys = [digest([windows.digest, name, chunk, request.samples, seed]) for chunk in chunks]
            by_seed[name].append(_joined([_unpacked(read_checked(cache / key) or b"") for key in keys]))
    return {name: _over_seeds(parts) for name, parts in by_seed.items()}


def count_chunk(files: tuple[str, ...], name: str, chunk: tuple[int, ...], samples: int, seed: int) -> bytes:
    """Return what is counted of the windows of *chunk*, as bytes; for a worker."""
    batch = _read(files).batch(np.array(chunk, dtype=np.int64))
    counted = count(name, batch, samples, int(digest([chunk, seed]), 16) % 2**31)
    sink = io.BytesIO()
    np.savez_compressed(sink, **vars(counted))
    return sink.getvalue()


@lru_cache(maxsize=1)
def _read(files: tuple[str, ...]) -> WindowSet:
    return read_window_set([Path(file) for file in files])


def _unpacked(content: bytes) -> Counted:
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        return Counted(**{one.name: arrays[one.name] for one in fields(Counted)})


def _joined(parts: list[Counted]) -> Counted:
    return Counted(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Counted)})


def _over_seeds(parts: list[Counted]) -> Counted:
    """Return one row of several seeds: errors as their mean, counts as their sum."""
    means = {"sfde_m", "fdd_m", "vehicles"}
    counts: dict[str, FloatArray] = {}
    for one in fields(Counted):
        stacked = np.stack([getattr(part, one.name) for part in parts])
        counts[one.name] = stacked.mean(0) if one.name in means else stacked.sum(0)
    return Counted(**counts)


def _samples(name: str, counted: Mapping[str, Counted], scenes: tuple[str, ...], seeds: int) -> RowSamples:
    own, log = counted[name], counted[LOG]
    some = (own.vehicles > 0.0).astype(np.float64)
    samples: dict[str, Sample] = {
        "env_rate": Ratio(scenes, own.off_road, own.trials, rate=True),
        "veh_rate": Ratio(scenes, own.hit, own.trials, rate=True),
    }
    if name != LOG:
        samples |= {
            "min_sfde_m": Ratio(scenes, own.sfde_m * some, some),
            "jsd_speed": Divergence(scenes, (own.speed,), (log.speed,)),
            "jsd_accel": Divergence(scenes, (own.accel,), (log.accel,)),
            "jsd_ttc": Divergence(scenes, (own.ttc,), (log.ttc,)),
        }
        if own.trials.sum() > seeds * own.vehicles.sum():
            samples["fdd_m"] = Ratio(scenes, own.fdd_m, own.vehicles)
    return RowSamples(name, "", MODELS[name].title, samples, name == LOG, name == OURS)
