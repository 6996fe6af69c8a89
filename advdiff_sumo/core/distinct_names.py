"""Names that tell files of one name in several folders apart."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path


def distinct_names(names: Mapping[Path, str]) -> dict[Path, str]:
    """Return *names* of files, each after as many of the file's folders as tell it from the others.

    Where both are "boston", ``a/boston.net.xml`` and ``b/boston.net.xml`` become "a-boston" and "b-boston"; a name that
    is there once stays. Files of one folder are told apart by all of their file name.
    """
    out = dict(names)
    for depth in range(1, max((len(path.parts) for path in _alike(out)), default=0)):
        for path in _alike(out):
            folders = (part.strip("/") for part in path.parent.parts[-depth:])
            out[path] = "-".join((*filter(None, folders), names[path]))
    return out | {path: "-".join((*path.parent.parts[-1:], path.name)) for path in _alike(out)}


def _alike(names: Mapping[Path, str]) -> list[Path]:
    counts = Counter(names.values())
    return [path for path, name in names.items() if counts[name] > 1]
