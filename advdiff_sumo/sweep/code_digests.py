"""Digests of the code of planners and policies, to tell whether it has changed since a folder was begun."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from advdiff_sumo.core.whole_file import sha256_of

#: Prefixes of plug-in names that denote a server, not a module.
_SERVERS = ("exec", "grpc")


def code_digests(names: Iterable[str]) -> dict[str, str]:
    """Return "package.module:Class" → digest of the module's file, for each of *names* that has such a file.

    Built-ins and servers have none. Modules that the file imports are not included.
    """
    files = {name: _file_of(name.partition(":")[0]) for name in sorted(set(names)) if ":" in name}
    return {name: sha256_of(file)[:16] for name, file in files.items() if file}


def changed_code(now: Mapping[str, Any], before: Mapping[str, Any]) -> list[str]:
    """Return the planners and policies whose code has different digests in *now* and *before*."""
    earlier = {**before, **before.get("begun_with", {})}
    return [name for name in now if ":" in name and earlier.get(name, now[name]) != now[name]]


def _file_of(module: str) -> Path | None:
    if module in _SERVERS:
        return None
    loaded = sys.modules.get(module)
    try:
        spec = None if loaded else importlib.util.find_spec(module)
    except (ImportError, ValueError, AttributeError):
        return None
    name = getattr(loaded, "__file__", None) or (spec and spec.origin)
    return Path(name) if name and Path(name).is_file() else None
