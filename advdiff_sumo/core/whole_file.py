"""Write files atomically: to a temporary file that is flushed to the disk and then renamed."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

from advdiff_sumo.core.errors import FileError, os_reason

A = TypeVar("A")
T = TypeVar("T")

#: Part of the name of every temporary file.
ASIDE = ".aside"


@contextlib.contextmanager
def whole_file(path: Path, ending: str = "") -> Iterator[Path]:
    """Yield the path of a temporary file that replaces *path* if the block succeeds; otherwise *path* is unchanged.

    Args:
        path: the file; its folder must exist.
        ending: extension of the temporary file, for writers that depend on it.

    Raises:
        OSError: raised by the block, or by flushing or renaming.
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
    """Make the folder *path*, given by an option, and its parents, unless they exist.

    Args:
        path: path of the folder.
        remedy: what to do if it cannot be made.

    Raises:
        FileError: it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(path, f"cannot be made ({os_reason(error)})", remedy) from None


def is_free(path: Path) -> bool:
    """Return whether *path* does not exist, or is an empty folder."""
    return not path.exists() or (path.is_dir() and not any(path.iterdir()))


def check_writable(path: Path) -> None:
    """Check that the file *path*, given by ``--out``, can be written, before work that takes minutes.

    Raises:
        FileError: it is a folder, or its folder cannot be used or written into.
    """
    if path.is_dir():
        raise FileError(path, "is a folder", "name a file in --out")
    try:
        os.scandir(path.parent).close()
    except OSError as error:
        raise FileError(path, f"cannot be written ({os_reason(error)})", "choose another --out") from None
    if not os.access(path.parent, os.W_OK):
        raise FileError(path, "cannot be written (its folder is read-only)", "choose another --out")


def arrow_path(path: Path) -> Path:
    """Return *path* for pyarrow, which takes a relative path with a colon for a URI."""
    return path.absolute()


def aside_of(path: Path, ending: str = "") -> Path:
    """Return the path of the temporary file of this process for *path*."""
    return path.with_name(f"{path.name}.{os.getpid()}{ASIDE}{ending}")


def settle(aside: Path, path: Path) -> None:
    """Flush the temporary file *aside* to the disk, rename it to *path*, and flush the folder."""
    with aside.open("rb+") as file:
        os.fsync(file.fileno())
    aside.replace(path)
    if os.name == "posix":
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def sha256_of(path: Path) -> str:
    """Return the SHA-256 digest of a file's content, in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def file_state(path: str | Path) -> tuple[int, int]:
    """Return the modification time in ns and the size of *path*, which show a change; zeros if it is missing."""
    try:
        status = Path(path).stat()
    except OSError:
        return 0, 0
    return status.st_mtime_ns, status.st_size


def kept_while_same(most: int) -> Callable[[Callable[[str, A], T]], Callable[[str, A], T]]:
    """Return a decorator that caches the result of a function that reads a file, until the file changes.

    Args:
        most: greatest number of cached results.
    """

    def decorate(read: Callable[[str, A], T]) -> Callable[[str, A], T]:
        @lru_cache(maxsize=most)
        def cached(_state: tuple[int, int], path: str, option: A) -> T:
            return read(path, option)

        def reader(path: str, option: A, /) -> T:
            return cached(file_state(path), path, option)

        return reader

    return decorate
