"""The request of a bench, and the file in which its folder stores it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

from pydantic import Field

from advdiff_sumo.config import Options, OwnOptions, Seed
from advdiff_sumo.core.errors import ConfigError, FileError, MissingExtraError, WeightsError
from advdiff_sumo.core.whole_file import is_free, make_folder
from advdiff_sumo.models.shipped_weights import shipped_weights
from advdiff_sumo.plugins import Registry, fold
from advdiff_sumo.sim.run_episodes import versions
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sweep.fingerprint import digest, file_digest
from advdiff_sumo.sweep.sweep_files import write_whole
from advdiff_sumo.traffic.licence import LicenceName

BenchName: TypeAlias = Literal["traffic", "adversarial", "transfer", "fewshot", "defects"]
_FILE = "bench.json"
_OMIT_IF_EMPTY = ("nets", "options")
"""Later options, which do not change the digest of a request unless they are set."""
_BENCHES_WITH_TRACES = ("adversarial", "transfer")
_TRACE_VERSION = 4
"""Version of the traces' contents and computation; traces and tables of another version are made again."""


class EpisodeOptions(Options):
    """Options of a bench's episodes for ``--set``, named as for ``run --set``.

    Attributes:
        seed: root of the random numbers.
        demand: route file or SUMO configuration; empty: that of a net's configuration, or traffic is generated.
        sim: steps and radii.
        scene: how seed scenes are found.
        background_options: of every background.
        target_options: of every target, except the additional careful driver.
    """

    seed: Seed = 0
    demand: str = ""
    sim: SimOptions = SimOptions()
    scene: SceneOptions = SceneOptions()
    background_options: OwnOptions = Field(default_factory=dict)
    target_options: OwnOptions = Field(default_factory=dict)


class Request(Options):
    """Options of a bench; an empty list of names means all available ones.

    Attributes:
        bench: its verb.
        scenes: number of scenes of the shipped list, the file of a list, or a driving log; windows of ``traffic``.
        horizon_s: longest duration of an episode.
        targets: tested planners.
        policies: rows.
        seeds: number of random seeds: of samples (traffic) or warm-ups (transfer, fewshot).
        steps: plans of a warm-up; of ``fewshot`` the last of its steps (transfer, fewshot).
        data: window files of ``traffic``; empty: they are generated.
        samples: joint samples of a scene (traffic).
        defects: planted defects, as ``NAME`` or ``NAME:SEVERITY`` (defects).
        severity: of defects without one.
        licence: of all attackers; None: the paper's, for ``defects`` the default one.
        nets: on which seed scenes are found, instead of a list; ``scenes`` is their number then.
        options: of the episodes, those of :class:`EpisodeOptions` that are given.
    """

    bench: BenchName
    scenes: str = "60"
    horizon_s: float = Field(10.0, gt=0.0, le=600.0)
    targets: tuple[str, ...] = ()
    policies: tuple[str, ...] = ()
    seeds: int = Field(1, ge=1, le=100)
    steps: int = Field(90, ge=1, le=10_000)
    data: tuple[str, ...] = ()
    samples: int = Field(10, ge=2, le=100)
    defects: tuple[str, ...] = ()
    severity: Literal["weak", "middle", "strong"] = "strong"
    licence: LicenceName | None = None
    nets: tuple[str, ...] = ()
    options: OwnOptions = Field(default_factory=dict)

    @property
    def episode(self) -> EpisodeOptions:
        """The options of the episodes.

        Raises:
            ConfigError: one is unknown or impossible.
        """
        return EpisodeOptions.parse(self.options, "--set")


@dataclass(frozen=True)
class Folder:
    """A bench's folder.

    Attributes:
        path: of the folder.
        request: the present one.
        revisions: of the package that have written to it.
    """

    path: Path
    request: Request
    revisions: tuple[str, ...] = ()

    @property
    def sweep(self) -> Path:
        """Folder of its sweep."""
        return self.path / "sweep"

    @property
    def traces(self) -> Path:
        """Folder of the traces of its episodes' backgrounds."""
        return self.path / f"traces-{_TRACE_VERSION}"

    @property
    def request_digest(self) -> str:
        """Digest of the request and of the version of the computation."""
        dumped = self.request.model_dump(mode="json")
        if self.request.bench in _BENCHES_WITH_TRACES:
            dumped["traces"] = _TRACE_VERSION
        return digest({name: value for name, value in dumped.items() if name not in _OMIT_IF_EMPTY or value})


def open_bench(path: Path, request: Request) -> Folder:
    """Create the folder of a bench, or continue in it; the request may have changed, but not the weights.

    Raises:
        FileError: the folder holds something else, or cannot be written.
        ConfigError: it belongs to another bench, or weights have changed since it was begun.
    """
    previous = stored_content(path)
    weights = weights_digests()
    if previous is not None:
        if previous["request"]["bench"] != request.bench:
            raise ConfigError(
                f"{path}: belongs to bench {previous['request']['bench']}; choose another --out"
            )
        changed = [name for name, old in previous["weights"].items() if weights.get(name, "") != old]
        if changed:
            raise ConfigError(
                f"{path}: {changed[0]} is not what it was when that bench was begun; choose a new --out"
            )
        weights |= previous["weights"]
    elif not is_free(path):
        raise FileError(path, "is there already and no folder of a bench", "choose a new --out")
    made_by = versions()
    earlier_revisions = tuple(previous["revisions"]) if previous is not None else ()
    revisions = tuple(dict.fromkeys((*earlier_revisions, made_by["revision"])))
    content = {
        "request": request.model_dump(mode="json"),
        "weights": weights,
        "revisions": list(revisions),
        "made_by": made_by,
    }
    make_folder(path)
    write_whole(path / _FILE, (json.dumps(content, indent=1, sort_keys=True) + "\n").encode())
    return Folder(path, request, revisions)


def stored_content(path: Path) -> dict[str, Any] | None:
    """Return the stored content of a bench's folder; None if it is no bench's folder.

    Raises:
        FileError: its file is damaged.
    """
    file = path / _FILE
    if not file.is_file():
        return None
    try:
        content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        if not {"request", "weights", "revisions"} <= content.keys():
            raise ValueError("keys are missing")
    except (OSError, ValueError, AttributeError) as error:
        raise FileError(file, f"is damaged ({error})", "choose a new --out") from None
    return content


def request_of(
    bench: BenchName, path: Path, defaults: Mapping[str, Any], given: Mapping[str, Any]
) -> Request:
    """Return the request: *given* options, else those that the folder stores, else *defaults* for a new folder.

    Raises:
        InputError: an option is impossible, or the folder belongs to another bench.
    """
    previous = stored_content(path)
    if previous is not None and previous["request"].get("bench") != bench:
        raise ConfigError(
            f"{path}: belongs to bench {previous['request'].get('bench')}; choose another --out"
        )
    base = defaults if previous is None else previous["request"]
    values = {**base, **{key: value for key, value in given.items() if value is not None}, "bench": bench}
    return Request.parse(values, f"bench {bench}")


def weights_digests() -> dict[str, str]:
    """Return the digests of the shipped weights by file name."""
    return {path.name: file_digest(path) for path in sorted(shipped_weights().parent.glob("*.safetensors"))}


def chosen_names(
    requested: Sequence[str],
    defaults: Mapping[str, str],
    registry: Registry,
    option: str,
    make: Callable[[str], object],
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of the rows or targets that take part, and the defaults that this installation lacks.

    Args:
        requested: names given by the user; empty: all available defaults.
        defaults: name in the table → name in the registry.
        registry: of targets or backgrounds.
        option: its name, for messages.
        make: makes the target or policy of a name in the table. A default whose weights are missing is not available.

    Raises:
        InputError: a requested name is not registered or cannot be made.
    """
    registered = {fold(name) for name in registry.names()}
    available = {name for name, registered_name in defaults.items() if fold(registered_name) in registered}
    if not requested:
        available = {name for name in available if _has_weights(make, name)}
        return tuple(n for n in defaults if n in available), tuple(n for n in defaults if n not in available)
    by_fold = {fold(name): name for name in defaults}
    names = []
    for name in dict.fromkeys(requested):
        canonical = by_fold.get(fold(name))
        if canonical is None:
            canonical = registry.canonical(name)  # its error suggests a similar name
        elif canonical not in available:
            raise ConfigError(
                f"{option} {name}: this installation has no {registry.kind} '{defaults[canonical]}' yet; leave it out"
            )
        make(canonical)
        names.append(canonical)
    return tuple(names), ()


def _has_weights(make: Callable[[str], object], name: str) -> bool:
    try:
        make(name)
    except (WeightsError, MissingExtraError):
        return False
    return True
