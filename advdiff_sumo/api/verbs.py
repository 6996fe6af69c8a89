"""Run, sweep and convert from a script or notebook."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from multiprocessing import current_process
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from advdiff_sumo.api.notebook_progress import NotebookProgress
from advdiff_sumo.api.result_tables import Results
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.planners.defects import parse_defects, plant
from advdiff_sumo.planners.planner_protocol import Planner

if TYPE_CHECKING:
    from advdiff_sumo.sim.measured_conversion import MeasuredConversion

_TIMEOUT_S, _RETRIES = 300.0, 2  # of a sweep's episodes


def run(
    net: str | Path = "downtown",
    target: str | Planner = "IDM",
    background: str = "sumo",
    episodes: int = 10,
    *,
    horizon_s: float = 20.0,
    seed: int = 0,
    out: str | Path | None = None,
    progress: bool = True,
    **options: Any,
) -> Results:
    """Run episodes in this process and return their results.

    Args:
        net: a SUMO net, or the name of a shipped one.
        target: what drives the tested vehicle: a name as for ``--target``, or a planner object. Results name an object
            by its class; of its ``target_options``, only ``defects`` can be given.
        background: what moves the background vehicles, as for ``--background``.
        episodes: how many.
        horizon_s: longest duration of an episode.
        seed: root of all random numbers.
        out: a new folder for the results; by default one in ``runs``, named after the run.
        progress: whether to show the progress.
        **options: any other field of :class:`~advdiff_sumo.sim.run_episodes.RunOptions`: ``target_options``,
            ``background_options``, ``demand``, ``scenes``, ``sim``, ``scene``.

    Raises:
        InputError: one of its kinds; the message names the culprit.
    """
    from advdiff_sumo.sim.free_folder import free_folder, run_words
    from advdiff_sumo.sim.run_episodes import Run, RunOptions
    from advdiff_sumo.sweep.executors import SerialExecutor
    from advdiff_sumo.sweep.run_engine import run_into, run_settings
    from advdiff_sumo.sweep.run_folder import RunFolder
    from advdiff_sumo.sweep.sole_writer import sole_writer

    planner = None if isinstance(target, str) else _checked(target)
    name = target if isinstance(target, str) else f"{type(target).__module__}:{type(target).__qualname__}"
    given = {"net": str(net), "target": name, "background": background, "episodes": episodes}
    run_options = RunOptions.parse({**given, "horizon_s": horizon_s, "seed": seed, **options}, "ads.run")
    if planner is not None:
        planner = _with_options(planner, run_options.target_options, name)
    prepared = Run.prepare(run_options, planner=planner)
    words = run_words(prepared.settings["options"]["net"], *prepared.names, seed)
    path = Path(out) if out is not None else free_folder(*words)
    folder = RunFolder.create(path, run_settings(prepared), False, "give a new out")
    with sole_writer(folder.path), NotebookProgress(episodes, progress) as bar:
        run_into(prepared, folder, SerialExecutor(prepared), bar.on_episode)
    return Results(folder.path)


def _checked(planner: object) -> Planner:
    """Return *planner* if it is a planner object; errors as in :func:`run`."""
    if isinstance(planner, type):
        raise ConfigError(
            f"target is the class {planner.__qualname__}; give an object of it: {planner.__qualname__}()"
        )
    for method in ("start", "plan"):
        if not callable(getattr(planner, method, None)):
            raise ConfigError(
                f"target {type(planner).__qualname__} has no method '{method}' (docs/planners.md)"
            )
    return cast("Planner", planner)


def _with_options(planner: Planner, options: Mapping[str, Any], name: str) -> Planner:
    """Return *planner* with the defects of *options*; other options are refused, as the planner is made already."""
    for key in options:
        if key != "defects":
            class_name = type(planner).__qualname__
            raise ConfigError(
                f"ads.run: target_options['{key}'] comes too late for a planner that is given as an object; "
                f"make it with that, as in target={class_name}({key}=...), or give its class by name: target='{name}'"
            )
    return cast("Planner", plant(planner, parse_defects(options.get("defects", ())), name))


def sweep(
    spec: str | Path | Mapping[str, Any],
    *,
    targets: Sequence[str] = (),
    out: str | Path | None = None,
    workers: int | None = None,
    progress: bool = True,
) -> Results:
    """Run a sweep on processes of this machine and return its results.

    A script must call this below ``if __name__ == "__main__":``, since the worker processes import the script.

    Args:
        spec: a sweep file, or its content as a mapping.
        targets: names of targets in place of those in *spec*, with default options; (): those in *spec*.
        out: a new folder for the results; by default one in ``runs``.
        workers: number of processes; by default one per core.
        progress: whether to show the progress.

    Raises:
        InputError: one of its kinds; the message names the culprit.
    """
    from advdiff_sumo.cli.worker_flags import cores, limits_of
    from advdiff_sumo.sim.free_folder import free_folder
    from advdiff_sumo.sweep.executors import ProcessExecutor
    from advdiff_sumo.sweep.job_plan import plan_sweep
    from advdiff_sumo.sweep.spec import SweepSpec
    from advdiff_sumo.sweep.sweep_runner import RemainingJobs, open_store, run_sweep

    if getattr(current_process(), "_inheriting", False):  # multiprocessing sets it while a worker imports
        raise ConfigError(
            "ads.sweep was called by a worker of another sweep, which imports the script anew; "
            'call it below if __name__ == "__main__":'
        )
    sweep_spec = SweepSpec.of(spec, "ads.sweep") if isinstance(spec, Mapping) else SweepSpec.read(Path(spec))
    plan = plan_sweep(sweep_spec.with_targets(targets) if targets else sweep_spec, places=True)
    name = "sweep" if isinstance(spec, Mapping) else Path(spec).stem
    worker_count = workers or cores()
    with ExitStack() as stack:
        executor = ProcessExecutor(worker_count, limits_of(stack, _TIMEOUT_S))
        store = open_store(
            Path(out) if out is not None else free_folder(name), plan, worker_count, resume=False
        )
        bar = stack.enter_context(NotebookProgress(plan.episode_count, progress))
        run_sweep(plan, store, RemainingJobs.of(plan, store), executor, _RETRIES, bar.on_episode)
    return Results(store.path)


def convert(map_file: str | Path, net: str | Path, **options: Any) -> MeasuredConversion:
    """Convert an HD map of any kind that ``advdiff-sumo convert`` accepts to a SUMO net, and measure how exact it is.

    Args:
        map_file: the map.
        net: the net to be written, ``NAME.net.xml``; drivable area and ``NAME.fidelity.json`` are written beside it.
        **options: any field of :class:`~advdiff_sumo.sim.measured_conversion.ConvertOptions`, which are the options of
            the command: ``lefthand``, ``tls``, ``tls_cycle``, ``crossings``, ``opendrive``, ``close_rim``, ``osm``,
            ``dataroot``, ``report``, ``drive``, ``drive_at_once``, ``seed``.

    Returns:
        the net, the figures of ``NAME.fidelity.json``, and all that the conversion made.

    Raises:
        InputError: one of its kinds; the message names the culprit.
    """
    from advdiff_sumo.sim.measured_conversion import ConvertOptions, convert_and_measure

    return convert_and_measure(Path(map_file), net, ConvertOptions.parse(options, "ads.convert"))
