"""A pool of worker processes for tasks that cannot hang: bench figures, verdicts, simulated windows.

Episodes run in other executors (``sweep.executors``), with time and memory limits.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from itertools import islice
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from pebble import ProcessPool

from advdiff_sumo.core.threads import one_thread_for_good
from advdiff_sumo.core.worker_start import ignore_interrupts, keep_temporary_files_in, worker_context

Key = TypeVar("Key")
Task: TypeAlias = tuple[Callable[..., Any], *tuple[Any, ...]]
"""A function and its arguments."""
_QUEUED_PER_WORKER = 4
"""Tasks that are scheduled at a time for each worker."""


def in_processes(tasks: Mapping[Key, Task], workers: int) -> Iterator[tuple[Key, Any]]:
    """Yield the keys of *tasks* with the results of their functions, as they finish; Ctrl-C ends the workers."""
    for key, future in futures_of(tasks.items(), workers):
        yield key, future.result()


def futures_of(
    tasks: Iterable[tuple[Key, Task]], workers: int, prepare: Callable[[], None] | None = None
) -> Iterator[tuple[Key, Future[Any]]]:
    """Yield the keys of *tasks* with their completed futures, as they finish; Ctrl-C ends the workers.

    If a worker is killed, only its own task is lost: its result raises ``pebble.ProcessExpired``.

    Args:
        tasks: pairs of key and task; read as workers become free.
        workers: number of processes; each computes on one thread.
        prepare: function that each worker calls first.
    """
    source = iter(tasks)
    first = list(islice(source, workers))
    if not first:
        return
    modules = {function.__module__ for _, (function, *_) in first}
    context = worker_context(sorted(modules if prepare is None else modules | {prepare.__module__}))
    with (
        tempfile.TemporaryDirectory(prefix="advdiff-", ignore_cleanup_errors=True) as folder,
        ProcessPool(len(first), initializer=_begin, initargs=(prepare, folder), context=context) as pool,
    ):
        try:
            pending: dict[Future[Any], Key] = {
                pool.schedule(function, args=args): key for key, (function, *args) in first
            }
            while pending:
                for key, (function, *args) in islice(source, _QUEUED_PER_WORKER * workers - len(pending)):
                    pending[pool.schedule(function, args=args)] = key
                done, _ = wait(pending, return_when=FIRST_COMPLETED)
                yield from ((pending.pop(future), future) for future in done)
        except BaseException:
            pool.stop()  # type: ignore[no-untyped-call] # pebble leaves it without types
            raise


def _begin(prepare: Callable[[], None] | None, folder: str) -> None:
    ignore_interrupts()
    keep_temporary_files_in(Path(folder))
    one_thread_for_good()
    if prepare is not None:
        prepare()
