"""One pool of workers for work that cannot hang: bench figures, verdicts, simulated windows.

Episodes have executors of their own (``sweep.executors``), with time and memory limits.
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
_AHEAD = 4
"""Tasks a worker that are taken in before one of them is done."""


def in_processes(tasks: Mapping[Key, Task], workers: int) -> Iterator[tuple[Key, Any]]:
    """Yield the keys of *tasks* with what their functions return, as they finish; Ctrl-C ends the workers."""
    for key, future in futures_of(tasks.items(), workers):
        yield key, future.result()


def futures_of(
    tasks: Iterable[tuple[Key, Task]], workers: int, prepare: Callable[[], None] | None = None
) -> Iterator[tuple[Key, Future[Any]]]:
    """Yield the keys of *tasks* with what became of them, as they finish; Ctrl-C ends the workers.

    A worker that is killed loses its own task alone: its result raises ``pebble.ProcessExpired``.

    Args:
        tasks: by their keys; taken in as workers get free.
        workers: processes at a time; each computes on one thread.
        prepare: what a worker does first.
    """
    source = iter(tasks)
    first = list(islice(source, workers))
    if not first:
        return
    needed = {function.__module__ for _, (function, *_) in first}
    context = worker_context(sorted(needed if prepare is None else needed | {prepare.__module__}))
    with (
        tempfile.TemporaryDirectory(prefix="advdiff-", ignore_cleanup_errors=True) as folder,
        ProcessPool(len(first), initializer=_begin, initargs=(prepare, folder), context=context) as pool,
    ):
        try:
            waiting: dict[Future[Any], Key] = {
                pool.schedule(function, args=given): key for key, (function, *given) in first
            }
            while waiting:
                for key, (function, *given) in islice(source, _AHEAD * workers - len(waiting)):
                    waiting[pool.schedule(function, args=given)] = key
                done, _ = wait(waiting, return_when=FIRST_COMPLETED)
                yield from ((waiting.pop(future), future) for future in done)
        except BaseException:
            pool.stop()  # type: ignore[no-untyped-call] # pebble leaves it without types
            raise


def _begin(prepare: Callable[[], None] | None, folder: str) -> None:
    ignore_interrupts()
    keep_temporary_files_in(Path(folder))
    one_thread_for_good()
    if prepare is not None:
        prepare()
