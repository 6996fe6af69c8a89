"""Files that are whole or as they were before: written aside, flushed to the disk, and renamed."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

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
