"""Base class of log readers for formats with one scene per file."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from itertools import starmap
from pathlib import Path
from typing import ClassVar

from advdiff_sumo.core.distinct_names import distinct_names
from advdiff_sumo.core.errors import LogError, MapError, UnknownNameError
from advdiff_sumo.data.log_reader import LogScene


class SceneFiles(ABC):
    """Reads one file or those of a folder; every file holds one scene.

    Attributes:
        path: the file or the folder.
        kind: word for the content of a file, for messages.
        remedy: remedy for a damaged file, for messages.
    """

    kind: ClassVar[str]
    remedy: ClassVar[str]

    def __init__(self, path: str | Path) -> None:
        """Create the reader of a file, or of a folder of such files."""
        self.path = Path(path)

    @abstractmethod
    def paths(self) -> dict[Path, str]:
        """Return file → name of every scene; names may repeat between folders.

        Raises:
            LogError: there is none.
        """

    def files(self) -> dict[str, Path]:
        """Return name → file of every scene; folder names are added to names that repeat.

        Raises:
            LogError: there is none.
        """
        return {name: path for path, name in distinct_names(self.paths()).items()}

    @abstractmethod
    def read_file(self, name: str, path: Path) -> LogScene:
        """Return the scene *name* in *path*; KeyError, TypeError, ValueError and IndexError mean damaged content."""

    def names(self) -> list[str]:
        """Return the names of the scenes, sorted.

        Raises:
            LogError: there is none.
        """
        return sorted(self.files())

    def read(self, name: str) -> LogScene:
        """Return one scene.

        Raises:
            UnknownNameError: there is no such scene.
            LogError: the file is damaged.
        """
        files = self.files()
        if name not in files:
            raise UnknownNameError(self.kind, name, files)
        return self._read(name, files[name])

    def scenes(self) -> Iterator[LogScene]:
        """Yield all scenes, sorted by name."""
        return starmap(self._read, sorted(self.files().items()))

    def _read(self, name: str, path: Path) -> LogScene:
        try:
            return self.read_file(name, path)
        except MapError as error:  # from functions that maps and logs share
            raise LogError(path, error.problem, error.remedy) from None
        except (KeyError, TypeError, ValueError, IndexError) as error:
            problem = f"cannot be used ({type(error).__name__}: {error})"
            raise LogError(path, problem, self.remedy) from None
