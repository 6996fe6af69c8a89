"""What a bench was asked for, as its folder remembers it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

from pydantic import Field

from advdiff_sumo.config import Options, OwnOptions, Seed
from advdiff_sumo.core.errors import ConfigError, FileError, MissingExtraError, WeightsError
from advdiff_sumo.core.whole_file import make_folder
from advdiff_sumo.models.shipped_weights import shipped_weights
from advdiff_sumo.plugins import Registry, fold
from advdiff_sumo.sim.run_episodes import versions
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sweep.fingerprint import digest, file_digest
from advdiff_sumo.sweep.sweep_files import write_whole
from advdiff_sumo.traffic.licence import LicenceName

BenchName: TypeAlias = Literal["traffic", "adversarial", "transfer", "fewshot", "defects"]
_FILE = "bench.json"
_LATER = ("nets", "options")
_TRACED = ("adversarial", "transfer")
_TRACES = 4
"""Version of what traces hold and how it is computed; those of another one, and tables of them, are made anew."""


class EpisodeOptions(Options):
    """What ``--set`` can say of a bench's episodes, by the names that ``run --set`` has.

    Attributes:
        seed: root of the random numbers.
        demand: route file or SUMO configuration; empty: that of a net's configuration, or traffic is generated.
        sim: steps and radii.
        scene: how seed scenes are found.
        background_options: of every background.
        target_options: of every target, the careful driver beside them apart.
    """

    seed: Seed = 0
    demand: str = ""
    sim: SimOptions = SimOptions()
    scene: SceneOptions = SceneOptions()
    background_options: OwnOptions = Field(default_factory=dict)
    target_options: OwnOptions = Field(default_factory=dict)


class Request(Options):
    """Options of a bench; an empty list of names means all that there are.

    Attributes:
        bench: its verb.
        scenes: how many of the shipped list's first, a list's file, or a driving log; windows of ``traffic``.
        horizon_s: longest duration of an episode.
        targets: what is attacked.
        policies: rows.
        seeds: random seeds: of samples (traffic) or warm-ups (transfer, fewshot).
        steps: of a warm-up, the last of the ladder (transfer, fewshot).
        data: window files of ``traffic``; empty: made for it.
        samples: joint samples of a scene (traffic).
        defects: what is planted, as ``NAME`` or ``NAME:SEVERITY`` (defects).
        severity: of those that have none.
        licence: of all that attack; None: the paper's, and of ``defects`` the default one.
        nets: where seed scenes are found, in place of a list; ``scenes`` is their number then.
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
        path: where it is.
        request: what is asked for now.
        revisions: of the package that worked in it.
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
        """Folder of what the background did in its episodes."""
        return self.path / f"traces-{_TRACES}"

    @property
    def asked(self) -> str:
        """Digest of what is asked for, and of how it is computed."""
        dumped = self.request.model_dump(mode="json")
        if self.request.bench in _TRACED:
            dumped["traces"] = _TRACES
        return digest({name: value for name, value in dumped.items() if name not in _LATER or value})


def open_bench(path: Path, request: Request) -> Folder:
    """Make the folder, or go on in it; what is asked may have changed, what weights it used may not.

    Raises:
        FileError: it holds something else, or cannot be written.
        ConfigError: it belongs to another bench, or weights have changed since it was begun.
    """
    known = stored(path)
    weights = weights_digests()
    if known is not None:
        if known["request"]["bench"] != request.bench:
            raise ConfigError(f"{path}: belongs to bench {known['request']['bench']}; choose another --out")
        changed = [name for name, old in known["weights"].items() if weights.get(name, "") != old]
        if changed:
            raise ConfigError(
                f"{path}: {changed[0]} is not what it was when that bench was begun; choose a new --out"
            )
        weights |= known["weights"]
    elif path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise FileError(path, "is there already and no folder of a bench", "choose a new --out")
    made_by = versions()
    before = tuple(known["revisions"]) if known is not None else ()
    revisions = tuple(dict.fromkeys((*before, made_by["revision"])))
    content = {
        "request": request.model_dump(mode="json"),
        "weights": weights,
        "revisions": list(revisions),
        "made_by": made_by,
    }
    make_folder(path)
    write_whole(path / _FILE, (json.dumps(content, indent=1, sort_keys=True) + "\n").encode())
    return Folder(path, request, revisions)


def stored(path: Path) -> dict[str, Any] | None:
    """Return what the folder remembers; None where there is no bench in it.

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
    """Return what is asked: what the folder remembers, else *defaults*; what is *given* wins over both.

    Raises:
        InputError: an option is impossible, or the folder belongs to another bench.
    """
    known = stored(path)
    if known is not None and known["request"].get("bench") != bench:
        raise ConfigError(f"{path}: belongs to bench {known['request'].get('bench')}; choose another --out")
    base = defaults if known is None else known["request"]
    values = {**base, **{key: value for key, value in given.items() if value is not None}, "bench": bench}
    return Request.parse(values, f"bench {bench}")


def weights_digests() -> dict[str, str]:
    """Return the digests of the shipped weights by file name."""
    return {path.name: file_digest(path) for path in sorted(shipped_weights().parent.glob("*.safetensors"))}


def chosen(
    asked: Sequence[str],
    usual: Mapping[str, str],
    registry: Registry,
    option: str,
    make: Callable[[str], object],
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return which rows or targets take part, and which of the usual ones this installation does not have.

    Args:
        asked: what the user named; empty: all of the usual ones that are there.
        usual: name in the table → name in the registry.
        registry: of targets or backgrounds.
        option: for the message.
        make: makes the target or policy of a name in the table; one whose weights are missing counts as not there,
            unless the user named it.

    Raises:
        InputError: a name was asked for that is not registered or cannot be made.
    """
    registered = {fold(name) for name in registry.names()}
    there = {name for name, behind in usual.items() if fold(behind) in registered}
    if not asked:
        there = {name for name in there if _has_weights(make, name)}
        return tuple(n for n in usual if n in there), tuple(n for n in usual if n not in there)
    by_fold = {fold(name): name for name in usual}
    picked = []
    for name in dict.fromkeys(asked):
        known = by_fold.get(fold(name))
        if known is None:
            known = registry.canonical(name)  # says what is near
        elif known not in there:
            raise ConfigError(
                f"{option} {name}: this installation has no {registry.kind} '{usual[known]}' yet; leave it out"
            )
        make(known)
        picked.append(known)
    return tuple(picked), ()


def _has_weights(make: Callable[[str], object], name: str) -> bool:
    try:
        make(name)
    except (WeightsError, MissingExtraError):
        return False
    return True
