"""Repeat one episode of a sweep or a run exactly."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pyarrow as pa

from advdiff_sumo.core.errors import ConfigError, FileError, InputError, SceneError
from advdiff_sumo.data.run_tables import SWEEP_SETTINGS
from advdiff_sumo.sim.episode import Episode
from advdiff_sumo.sim.run_episodes import Run
from advdiff_sumo.sim.scene_file import scene_from_bytes
from advdiff_sumo.sim.seed_scene import SeedScene
from advdiff_sumo.sweep.fingerprint import file_digest, net_files
from advdiff_sumo.sweep.job_plan import Job, SweepPlan, plan_run, plan_sweep
from advdiff_sumo.sweep.rounds import stored_plan
from advdiff_sumo.sweep.run_engine import stored_run
from advdiff_sumo.sweep.run_folder import RunFolder
from advdiff_sumo.sweep.stored_episode import StoredEpisode
from advdiff_sumo.sweep.sweep_store import Store
from advdiff_sumo.sweep.work import run_of, stored_form

_SHORTEST_KEY = 6
_BY_SEARCH = ("solvable", "unavoidable", "verdict")  # columns that the clairvoyant search writes
_COMPARED_TABLES = ("episodes", "collisions", "states", "plans", "unattacked")


@dataclass(frozen=True)
class Before:
    """A stored episode of a sweep or a run, to be repeated.

    Attributes:
        store: store that may hold its seed scene.
        plan: plan that it belongs to.
        job: the episode.
        part: its stored result; None if there is none.
        name: its name, for files and folders.
    """

    store: Store
    plan: SweepPlan
    job: Job
    part: StoredEpisode | None
    name: str


@dataclass(frozen=True)
class Repeated:
    """A repeated episode.

    Attributes:
        run: the run that it belongs to.
        part: its result.
        same: whether all values equal the stored ones; None if nothing was stored.
    """

    run: Run
    part: StoredEpisode
    same: bool | None


def of_sweep(key: str, folder: Path | None, among: Path) -> Before:
    """Return the episode *key* of a sweep.

    Args:
        key: key of the episode, or its beginning; with *folder* also its number.
        folder: folder of the sweep; None to search the folders in *among*.
        among: folder that holds sweeps.

    Raises:
        InputError: no sweep has the episode.
    """
    if folder is not None and key.isdecimal() and len(key) < _SHORTEST_KEY:
        return _numbered(int(key), folder)
    if len(key) < _SHORTEST_KEY:
        raise ConfigError(
            f"'{key}' is too short for the key of an episode; give {_SHORTEST_KEY} digits or more"
        )
    if folder is not None:
        store = Store.open(folder)
        plan = plan_sweep(store.spec())
        store.must_match(plan.keys)
        return _stored(store, plan, plan.find(key))
    errors = list[InputError]()
    for settings_path in sorted(among.glob(f"*/{SWEEP_SETTINGS}")):
        store = Store(settings_path.parent)
        try:
            plan = plan_sweep(store.spec())
        except InputError as error:  # such as for a missing net; the episode may belong to another sweep
            errors.append(error)
            continue
        if any(job.key.startswith(key) for job in plan.jobs):
            return _stored(store, plan, plan.find(key))
    passed_over = f" (passed over: {'; '.join(map(str, errors))})" if errors else ""
    raise ConfigError(
        f"no sweep in {among} has an episode '{key}'{passed_over}; name its folder with --sweep"
    )


def _numbered(number: int, folder: Path) -> Before:
    """Return the episode that has this *number* in the tables of a sweep."""
    store = Store.open(folder)
    plan = stored_plan(store, drives=True)
    if number >= len(plan.jobs):
        raise ConfigError(
            f"'{number}' is no episode of {folder}; give a number from 0 to {len(plan.jobs) - 1}, or a key"
        )
    return _stored(store, plan, plan.jobs[number])


def _stored(store: Store, plan: SweepPlan, job: Job) -> Before:
    """Return the stored episode *job*."""
    return Before(store, plan, job, store.read(job.key), job.key)


def of_run(number: str, folder: Path) -> Before:
    """Return episode *number* of the run in *folder*, which is treated as a sweep of one cell.

    Raises:
        InputError: the folder holds no run, or the run has no such episode.
    """
    plan = plan_run(stored_run(folder))
    if not (number.isdecimal() and int(number) < len(plan.jobs)):
        raise ConfigError(
            f"'{number}' is no episode of {folder}; give a number from 0 to {len(plan.jobs) - 1}"
        )
    stored, job = RunFolder(folder), plan.jobs[int(number)]
    return Before(stored.store, plan, job, stored.part(job.number), f"{folder.resolve().name}-{job.number}")


def repeat(before: Before, gui: bool = False) -> Repeated:
    """Run an episode again in this process.

    Args:
        before: the stored episode.
        gui: whether to show it in sumo-gui.

    Raises:
        InputError: its seed scene cannot be made again.
    """
    run, episode = episode_again(before.store, before.plan, before.job, gui)
    record, timing = episode.run()
    part = stored_form(run, record, timing)
    return Repeated(run, part, _is_same(before.part, part))


def episode_again(store: Store, plan: SweepPlan, job: Job, gui: bool = False) -> tuple[Run, Episode]:
    """Return the run and the episode of *job*, ready to be run; errors as in :func:`repeat`."""
    options = plan.options(job)
    run = replace(run_of(options, file_digest(*net_files(options.net))), gui=gui)
    return run, run.episode(job.number, _scene(store, plan, run, job))


def settings_for(job: Job, run: Run) -> dict[str, Any]:
    """Return the ``run.toml`` of a folder that holds only *job*."""
    settings = run.settings
    return {
        "run": {**settings["run"], "repeats": job.number},
        "options": {**settings["options"], "episodes": job.number + 1},
    }


def _scene(store: Store, plan: SweepPlan, run: Run, job: Job) -> SeedScene:
    """Return the seed scene: the stored one if it still exists, else it is made again."""
    stored = store.read_scenes(job.batch)
    if stored is not None and job.scene_index < len(stored):
        return scene_from_bytes(stored[job.scene_index], run.road.path)
    scenes = run.scene_batch(plan.batches[job.batch].number, job.scene_index + 1)
    if job.scene_index >= len(scenes):
        raise SceneError(f"{run.options.scenes}: has no seed scene number {job.scene_index + 1}")
    return scenes[job.scene_index]


def _is_same(stored: StoredEpisode | None, repeated: StoredEpisode) -> bool | None:
    """Return whether all stored values were repeated; None if nothing was stored."""
    if stored is None or not stored.tables:
        return None
    try:
        names = (*_COMPARED_TABLES, *({"signals"} & stored.tables.keys()))  # not in early versions
        pairs = [(stored.tables[name], repeated.tables[name]) for name in names]
    except KeyError as table:
        raise FileError(Path("episode"), f"lacks the table {table}", "resume the sweep") from None
    if _has_search(stored):
        pairs = [(_without_search(before), _without_search(after)) for before, after in pairs]
    return all(before.equals(after.select(before.column_names)) for before, after in pairs)


def _has_search(stored: StoredEpisode) -> bool:
    """Return whether ``verdict --search`` has added columns, which a repetition does not compute."""
    table = stored.tables["episodes"]
    return "solvable" in table.column_names and table["solvable"].null_count < table.num_rows


def _without_search(table: pa.Table) -> pa.Table:
    return table.drop_columns([name for name in table.column_names if name in _BY_SEARCH])
