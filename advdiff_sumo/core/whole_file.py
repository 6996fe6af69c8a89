"""Files that are whole or as they were before: written aside, flushed to the disk, and renamed."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

from advdiff_sumo.core.errors import FileError, os_reason

A = TypeVar("A")
T = TypeVar("T")

#: In the name of every file that is being written.
ASIDE = ".aside"


@contextlib.contextmanager
def whole_file(path: Path, ending: str = "") -> Iterator[Path]:
    """Yield where to write what becomes *path* when the block ends well; otherwise *path* stays as it was.

    Args:
        path: the file; its folder must be there.
        ending: of the name to write to, for writers that go by it.

    Raises:
        OSError: of the block, or of flushing and renaming.
    """
    aside = aside_of(path, ending)
    try:
        yield aside
        settle(aside, path)
    except BaseException:
        with contextlib.suppress(OSError):
            aside.unlink()
        raise


def make_folder(path: Path, remedy: str = "choose another --out") -> None:
    """Make the folder *path*, which an option names, and those above it, unless they are there.

    Args:
        path: of the folder.
        remedy: what to do where it cannot be made.

    Raises:
        FileError: it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(path, f"cannot be made ({os_reason(error)})", remedy) from None


def aside_of(path: Path, ending: str = "") -> Path:
    """Return where this process writes *path* before it gets its name."""
    return path.with_name(f"{path.name}.{os.getpid()}{ASIDE}{ending}")


def settle(aside: Path, path: Path) -> None:
    """Flush a finished file to the disk, give it its name, and let the folder remember it."""
    with aside.open("rb+") as file:
        os.fsync(file.fileno())
    aside.replace(path)
    if os.name == "posix":
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def file_state(path: str | Path) -> tuple[int, int]:
    """Return what changes when *path* is written anew: its time and size; zeros where it is missing."""
    try:
        about = Path(path).stat()
    except OSError:
        return 0, 0
    return about.st_mtime_ns, about.st_size


def kept_while_same(most: int) -> Callable[[Callable[[str, A], T]], Callable[[str, A], T]]:
    """Return a decorator that keeps what a reader of a file made of it, until the file changes.

    Args:
        most: how many of its results are kept.
    """

    def decorate(read: Callable[[str, A], T]) -> Callable[[str, A], T]:
        @lru_cache(maxsize=most)
        def kept(_state: tuple[int, int], path: str, how: A) -> T:
            return read(path, how)

        def reader(path: str, how: A, /) -> T:
            return kept(file_state(path), path, how)

        return reader

    return decorate
