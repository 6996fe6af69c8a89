"""Compute keys from content: equal net, scene, target, background, options and seed give equal keys anywhere."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from fnmatch import fnmatch
from functools import lru_cache
from pathlib import Path
from typing import Any

from advdiff_sumo.data.argoverse2_log import SCENARIOS
from advdiff_sumo.data.commonroad_log import is_scenario
from advdiff_sumo.maps.shipped_nets import find_net
from advdiff_sumo.maps.sidecar import sidecar_of
from advdiff_sumo.models.shipped_weights import WEIGHTS
from advdiff_sumo.sim.demand_files import DemandFiles
from advdiff_sumo.sim.run_episodes import RunOptions

#: Digits of a key; 96 bits, so that even a billion episodes have different keys.
KEY_DIGITS = 24
#: Options ``sim`` that seed scenes depend on.
_SCENE_SIM = ("step_s", "model_step_s", "history_s", "lateral_resolution_m", "record_radius_m")
_LOG_SUFFIXES = (".json", ".pkl")
_SENSORS = {"samples", "sweeps"}  # folders of sensor data in driving logs


def canonical_json(value: Any) -> str:
    """Return a plain value as JSON in a unique form: sorted keys, no blanks."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False, default=str)


def digest(value: Any) -> str:
    """Return the digest of a plain value, independent of the order of keys."""
    return hashlib.sha256(canonical_json(value).encode()).hexdigest()[:KEY_DIGITS]


def file_digest(*paths: Path) -> str:
    """Return the digest of the contents of *paths*."""
    total = hashlib.sha256()
    for path in paths:
        with path.open("rb") as file:
            total.update(hashlib.file_digest(file, "sha256").digest())
    return total.hexdigest()[:KEY_DIGITS]


def net_files(net: str) -> tuple[Path, ...]:
    """Return the file of a net and, if there is one, that of its drivable area.

    Raises:
        NetError: there is no such net.
    """
    path = find_net(net)
    sidecar = sidecar_of(path)
    return (path,) if sidecar is None else (path, sidecar)


def source_digest(options: RunOptions, demand: DemandFiles | None) -> str:
    """Return the digest of all that seed scenes depend on, except their number.

    Args:
        options: options of the run.
        demand: files of ``options.demand``; None if it is empty.
    """
    files = net_files(options.net)
    dumped = options.model_dump(mode="json")
    return digest(
        {
            "net": [files[0].name, _cached(files)],
            "demand": []
            if demand is None
            else [demand.begin_s, *(_cached((path,)) for path in demand.files)],
            "log": _log_digest(options.scenes) if options.scenes else "",
            "scene": dumped["scene"],
            "sim": {name: dumped["sim"][name] for name in _SCENE_SIM},
            "horizon_s": options.horizon_s,
            "seed": options.seed,
        }
    )


def cell_digest(options: RunOptions, source: str) -> str:
    """Return the digest of a run's options, except its number of episodes; *source*: digest of its scenes.

    Files named in the options, such as weights, count by their content.
    """
    dumped = options.model_dump(mode="json")
    names = ("target", "target_options", "background", "background_options", "sim", "horizon_s", "seed")
    content = {"source": source, **{name: dumped[name] for name in names}}
    files = [
        _cached((p,)) for own in (options.target_options, options.background_options) for p in files_of(own)
    ]
    return digest({**content, "files": files} if files else content)


def files_of(options: Mapping[str, Any]) -> tuple[Path, ...]:
    """Return the files named in *options*; for a folder of a training, its file of networks."""
    texts = (value for _, value in sorted(options.items()) if isinstance(value, str))
    return tuple(file for text in texts for file in _file_named(text))


def _file_named(text: str) -> Iterator[Path]:
    """Yield the file that *text* names, if it names one."""
    if os.path.isfile(text):  # noqa: PTH113 - Path.is_file raises for long texts
        yield Path(text)
    elif os.path.isdir(text) and (weights := Path(text) / WEIGHTS).is_file():  # noqa: PTH112 - as above
        yield weights


def _cached(files: tuple[Path, ...]) -> str:
    """Return the digest of *files*, cached until one of them changes."""
    return _digest_of(files, tuple((stat.st_mtime_ns, stat.st_size) for stat in map(Path.stat, files)))


@lru_cache(maxsize=256)
def _digest_of(files: tuple[Path, ...], states: tuple[tuple[int, int], ...]) -> str:  # noqa: ARG001 - part of the cache's key
    return file_digest(*files)


@lru_cache(maxsize=16)
def _log_digest(root: str) -> str:
    """Return the digest of a driving log: names and sizes of its files, as their contents are large."""
    return digest([[name, size] for name, size in sorted(_log_files(Path(root)))])


def _log_files(root: Path) -> Iterator[tuple[str, int]]:
    """Yield name and size of each file of a driving log that readers use."""
    if root.is_file():
        yield root.name, root.stat().st_size
    for folder, subfolders, names in os.walk(root):
        subfolders[:] = [name for name in subfolders if name not in _SENSORS]
        for path in (Path(folder, name) for name in names):
            if path.name.endswith(_LOG_SUFFIXES) or fnmatch(path.name, SCENARIOS) or _is_log(root, path):
                yield path.relative_to(root).as_posix(), path.stat().st_size


def _is_log(root: Path, path: Path) -> bool:
    """Return whether *path* is a log because it lies directly in *root*: a scenario, or the states of a run."""
    return path.parent == root and (path.name == "states.parquet" or is_scenario(path))
