"""Make distinct names for files of the same name in several folders."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path


def distinct_names(names: Mapping[Path, str]) -> dict[Path, str]:
    """Return *names* of files, each preceded by as many of the file's folders as make it unique.

    If both are named "boston", ``a/boston.net.xml`` and ``b/boston.net.xml`` become "a-boston" and "b-boston". A unique
    name does not change. Files in one folder get their full file name.
    """
    result = dict(names)
    for depth in range(1, max((len(path.parts) for path in _ambiguous(result)), default=0)):
        for path in _ambiguous(result):
            folders = (part.strip("/") for part in path.parent.parts[-depth:])
            result[path] = "-".join((*filter(None, folders), names[path]))
    return result | {path: "-".join((*path.parent.parts[-1:], path.name)) for path in _ambiguous(result)}


def _ambiguous(names: Mapping[Path, str]) -> list[Path]:
    """Return the files whose name occurs more than once."""
    counts = Counter(names.values())
    return [path for path, name in names.items() if counts[name] > 1]
