"""``bench traffic``: the paper's first table, in open loop, on windows that were not used in training."""

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
from advdiff_sumo.experiments.bench.open_loop import MODELS, WindowCounts, count
from advdiff_sumo.experiments.bench.reporter import ProgressReporter
from advdiff_sumo.experiments.bench.table import Head, RowSamples, Table, gaps_of, lines_of, paper_table
from advdiff_sumo.sim.training_windows.simulate import ShardResult, SimulateOptions, plan, simulate
from advdiff_sumo.sweep.fingerprint import digest
from advdiff_sumo.sweep.sweep_files import read_checked, write_checked
from advdiff_sumo.training.dataset import WindowSet, read_window_set

WINDOWS, WINDOWS_SEED, MADE_UP_SHARE = 1800, 9001, 0.5
"""Options of ``data simulate`` for the windows if none are given; half of them are on random nets."""
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


def run_traffic(folder: Folder, workers: int, reporter: ProgressReporter) -> Table:
    """Evaluate the windows that are not evaluated yet, and return the table.

    Raises:
        InputError: a row is unknown, or a window file cannot be used.
    """
    names = chosen_models(folder.request, reporter)
    counted: dict[str, WindowCounts] = {}
    for view in VIEWS:
        view_models = tuple(
            name for name in names if MODELS[name].view == view or (name == LOG and not counted)
        )
        if {*view_models} <= {LOG} and len(names) > 1:
            continue
        window_files = _window_files(folder, workers, reporter, view)
        windows = read_window_set(window_files)
        rows = spread_rows(len(windows), _requested_count(folder.request.scenes, len(windows)))
        counted |= _counted(folder, view_models, windows, rows, window_files, workers, reporter)
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


def check_traffic(request: Request, reporter: ProgressReporter) -> None:
    """Check the request before anything is run.

    Raises:
        InputError: a row is unknown, a number is impossible, or a window file cannot be used.
    """
    chosen_models(request, reporter)
    _requested_count(request.scenes, 1)


def chosen_models(request: Request, reporter: ProgressReporter) -> tuple[str, ...]:
    """Return the rows: the requested ones, or all whose weights are installed; the log is always included.

    Rows whose networks need another view of the map than the given windows contain are left out.

    Raises:
        ConfigError: a row is unknown, or has no weights.
        FileError: a window file cannot be used.
    """
    requested = request.policies
    given_view = read_window_set([Path(path) for path in request.data]).map_view if request.data else None
    for name in requested:
        if name not in MODELS:
            raise ConfigError(
                f"--policies {name}: bench traffic has no such row; {did_you_mean(name, MODELS)}"
            )
        if not MODELS[name].is_installed:
            raise ConfigError(
                f"--policies {name}: this installation has no {MODELS[name].weights} yet; leave it out"
            )
    for name, model in MODELS.items():
        if not requested and not model.is_installed:
            reporter.say(f"row {name} is left out: this installation has no {model.weights} yet")
    rows = {LOG, *(requested or MODELS)}
    names = [name for name, model in MODELS.items() if name in rows and model.is_installed]
    other_view = [name for name in names if given_view and name != LOG and MODELS[name].view != given_view]
    if other_view:
        reporter.say(
            f"left out: {', '.join(other_view)}, whose networks see more or less of the map than the windows show"
        )
    return tuple(name for name in names if name not in other_view)


def spread_rows(total: int, wanted: int) -> IntArray:
    """Return the rows of *wanted* of *total* windows, spread over all; a smaller selection is part of a larger one.

    Their order is that of the bit-reversed numbers (van der Corput), which fills gaps evenly.
    """
    bits = max(1, (total - 1).bit_length())
    order = [int(f"{k:0{bits}b}"[::-1], 2) for k in range(1 << bits)]
    return np.array([k for k in order if k < total][:wanted], dtype=np.int64)


def _requested_count(requested: str, total: int) -> int:
    if not requested.isdigit() or int(requested) < 1:
        raise ConfigError(
            f"--scenes {requested}: give the number of windows, above 0; name their files with --data"
        )
    return min(int(requested), total)


def _window_files(folder: Folder, workers: int, reporter: ProgressReporter, view: MapView) -> list[Path]:
    """Return the given window files, or generate windows with the map's *view* in the folder and return its path."""
    if folder.request.data:
        return [Path(path) for path in folder.request.data]
    folder_path = folder.path / ("windows" if view == "near" else f"windows-{view}")
    options = SimulateOptions(windows=WINDOWS, seed=WINDOWS_SEED, random_share=MADE_UP_SHARE, view=view)
    shards = plan(options)
    folder_path.mkdir(parents=True, exist_ok=True)
    reporter.begin("files of windows", len(shards))

    def on_shard(_: ShardResult) -> None:
        reporter.step()

    simulate(shards, folder_path, workers, on_shard)
    return [folder_path]


def _counted(
    folder: Folder,
    names: tuple[str, ...],
    windows: WindowSet,
    rows: IntArray,
    window_files: list[Path],
    workers: int,
    reporter: ProgressReporter,
) -> dict[str, WindowCounts]:
    """Return the counts of each row, joined over the seeds; chunks of windows that the folder has are not repeated."""
    request, cache = folder.request, folder.path / "counted"
    cache.mkdir(parents=True, exist_ok=True)
    files = tuple(str(path) for path in window_files)
    chunks = [tuple(rows[k : k + CHUNK].tolist()) for k in range(0, len(rows), CHUNK)]
    chunk_by_key = {
        digest([windows.digest, name, chunk, request.samples, seed]): (name, chunk, seed)
        for name in names
        for seed in range(request.seeds)
        for chunk in chunks
    }
    cached = {key for key in chunk_by_key if read_checked(cache / key) is not None}
    reporter.begin("parts of the windows", len(chunk_by_key), len(cached))
    tasks = {
        key: (count_chunk, files, name, chunk, request.samples, seed)
        for key, (name, chunk, seed) in chunk_by_key.items()
        if key not in cached
    }
    for key, content in in_processes(tasks, workers):
        write_checked(cache / key, content)
        reporter.step()
    counts_by_seed: dict[str, list[WindowCounts]] = {name: [] for name in names}
    for name in names:
        for seed in range(request.seeds):
            keys = [digest([windows.digest, name, chunk, request.samples, seed]) for chunk in chunks]
            chunk_counts = [_counts_from_bytes(read_checked(cache / key) or b"") for key in keys]
            counts_by_seed[name].append(_concatenated(chunk_counts))
    return {name: _over_seeds(parts) for name, parts in counts_by_seed.items()}


def count_chunk(files: tuple[str, ...], name: str, chunk: tuple[int, ...], samples: int, seed: int) -> bytes:
    """Return the counts of the windows of *chunk* as bytes; runs in a worker."""
    batch = _read(files).batch(np.array(chunk, dtype=np.int64))
    counted = count(name, batch, samples, int(digest([chunk, seed]), 16) % 2**31)
    sink = io.BytesIO()
    np.savez_compressed(sink, **vars(counted))
    return sink.getvalue()


@lru_cache(maxsize=1)
def _read(files: tuple[str, ...]) -> WindowSet:
    return read_window_set([Path(file) for file in files])


def _counts_from_bytes(content: bytes) -> WindowCounts:
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        return WindowCounts(**{field.name: arrays[field.name] for field in fields(WindowCounts)})


def _concatenated(parts: list[WindowCounts]) -> WindowCounts:
    return WindowCounts(
        **{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(WindowCounts)}
    )


def _over_seeds(parts: list[WindowCounts]) -> WindowCounts:
    """Join the counts of several seeds: the mean of errors and numbers of vehicles, the sum of the others."""
    means = {"sfde_m", "fdd_m", "vehicles"}
    counts: dict[str, FloatArray] = {}
    for field in fields(WindowCounts):
        stacked = np.stack([getattr(part, field.name) for part in parts])
        counts[field.name] = stacked.mean(0) if field.name in means else stacked.sum(0)
    return WindowCounts(**counts)


def _samples(
    name: str, counted: Mapping[str, WindowCounts], scenes: tuple[str, ...], seeds: int
) -> RowSamples:
    counts, log_counts = counted[name], counted[LOG]
    has_vehicles = (counts.vehicles > 0.0).astype(np.float64)
    samples: dict[str, Sample] = {
        "env_rate": Ratio(scenes, counts.off_road, counts.trials, rate=True),
        "veh_rate": Ratio(scenes, counts.hit, counts.trials, rate=True),
    }
    if name != LOG:
        samples |= {
            "min_sfde_m": Ratio(scenes, counts.sfde_m * has_vehicles, has_vehicles),
            "jsd_speed": Divergence(scenes, (counts.speed,), (log_counts.speed,)),
            "jsd_accel": Divergence(scenes, (counts.accel,), (log_counts.accel,)),
            "jsd_ttc": Divergence(scenes, (counts.ttc,), (log_counts.ttc,)),
        }
        if counts.trials.sum() > seeds * counts.vehicles.sum():
            samples["fdd_m"] = Ratio(scenes, counts.fdd_m, counts.vehicles)
    return RowSamples(name, "", MODELS[name].title, samples, name == LOG, name == OURS)
