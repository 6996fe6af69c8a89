"""Fixed lists of seed scenes for the benches, so that all rows of a table are paired."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from advdiff_sumo.config import Options
from advdiff_sumo.core.errors import ConfigError, FileError, os_reason
from advdiff_sumo.maps.shipped_nets import SHIPPED_NETS, net_name
from advdiff_sumo.sim.sim_options import SceneOptions
from advdiff_sumo.sweep.fingerprint import file_digest, net_files
from advdiff_sumo.sweep.sweep_files import write_whole

FORMAT: Literal["advdiff-scenes-1"] = "advdiff-scenes-1"
TABLE_LIST, TUNING_LIST = "scenes-300", "scenes-tuning"
DEFECTS_LIST, RED_LIGHTS_LIST, JUNCTIONS_LIST = "scenes-defects", "scenes-red-lights", "scenes-junctions"
TABLE_SEED, TUNING_SEED, DEFECTS_SEED, RED_LIGHTS_SEED, JUNCTIONS_SEED = 3001, 7001, 9201, 9301, 9401
_ADDED = {"situation": "any", "pedestrians_per_km": 0.0, "stratum": "", "strata": {}, "log": "", "demand": ""}
"""Fields added to lists later, with their defaults; they are written only if they differ from these."""
HORIZON_S, DEFECTS_HORIZON_S = 10.0, 30.0


class ListedScene(Options):
    """One seed scene; net, seed, stratum and number reproduce it with the same version of SUMO.

    Attributes:
        net: a shipped net or a path.
        seed: root of the random numbers, as of ``run --seed``.
        number: of the scene on that net with that seed in that stratum.
        stratum: key of its options in the list's ``strata``; "": the list's ``scene``.
    """

    net: str
    seed: int = Field(ge=0)
    number: int = Field(ge=0)
    stratum: str = ""

    @property
    def place(self) -> tuple[str, int, str, int]:
        """Net, seed, stratum and number."""
        return self.net, self.seed, self.stratum, self.number

    @model_serializer(mode="wrap")
    def _as_written(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return _without_added(write(self))


class Stratum(Options):
    """A part of a list: seed scenes that are found with the same options.

    Attributes:
        nets: on which they are found.
        scene: how they are found.
    """

    nets: tuple[str, ...]
    scene: SceneOptions


class SceneList(Options):
    """A list of seed scenes, such that its first n are a stratified sample for every n.

    Attributes:
        format: of the file.
        about: its purpose.
        nets: net → digest of its files when the list was made.
        sumo: version of SUMO for which it is made; with another one, the same seeds may give other traffic.
        horizon_s: duration of the episodes for which it is made. Traffic is generated until their end, so with another
            duration the same seeds give other traffic, too.
        scene: how scenes without stratum are found.
        strata: how scenes of each stratum are found.
        scenes: strata and nets in turn, by increasing number.
        log: root of the driving log; "": scenes of SUMO traffic.
        demand: route file or SUMO configuration of the traffic; "": that of a net's configuration, or generated.
        sha256: of all other fields, as canonical JSON.
    """

    format: Literal["advdiff-scenes-1"] = FORMAT
    about: str = ""
    nets: dict[str, str]
    sumo: str
    horizon_s: float = HORIZON_S
    scene: SceneOptions = SceneOptions()
    strata: dict[str, SceneOptions] = Field(default_factory=dict)
    scenes: tuple[ListedScene, ...]
    log: str = ""
    demand: str = ""
    sha256: str = ""

    @model_serializer(mode="wrap")
    def _as_written(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        written = write(self)
        written["scene"] = _without_added(written["scene"])
        written["strata"] = {name: _without_added(scene) for name, scene in written["strata"].items()}
        return _without_added(written)

    @property
    def content_digest(self) -> str:
        """SHA-256 of the list without ``sha256``."""
        text = json.dumps(
            self.model_dump(mode="json", exclude={"sha256"}), sort_keys=True, separators=(",", ":")
        )
        return hashlib.sha256(text.encode()).hexdigest()

    def first(self, count: int) -> SceneList:
        """Return the list of the first *count* scenes; a shorter list is part of a longer one.

        Raises:
            ConfigError: the list has fewer scenes.
        """
        if count > len(self.scenes):
            raise ConfigError(f"--scenes {count}: the list has {len(self.scenes)}; ask for at most so many")
        return self.model_copy(update={"scenes": self.scenes[:count]}).sealed()

    def sealed(self) -> SceneList:
        """Return the list with the digest of its content as ``sha256``."""
        return self.model_copy(update={"sha256": self.content_digest})

    def counts(self) -> dict[tuple[str, int, str], int]:
        """Return the number of scenes of each net, seed and stratum, in the list's order."""
        return dict(Counter(scene.place[:3] for scene in self.scenes))


def read_scene_list(path: Path) -> SceneList:
    """Read a list and check its digest and those of its nets.

    Raises:
        FileError: the file is missing, is no such list or was changed by hand, or its nets have changed.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FileError(path, f"cannot be read ({os_reason(error)})", "give a list of seed scenes") from None
    except ValueError as error:
        raise FileError(path, f"is no JSON ({error})", "give a list of seed scenes") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise FileError(path, "is no list of seed scenes", "make one with tools/make_bench_scenes.py")
    scene_list = SceneList.parse(content, str(path))
    if scene_list.sha256 != scene_list.content_digest:
        raise FileError(path, "is not what its sha256 says", "restore it, or make a list of your own")
    _check_order(scene_list, path)
    for net, net_digest in scene_list.nets.items():
        if file_digest(*net_files(net)) != net_digest:
            raise FileError(path, f"was made on another net '{net}'", "restore that net, or make a new list")
    return scene_list


def shipped_list(name: str = TABLE_LIST) -> Path:
    """Return the file of a list that ships with the project.

    Raises:
        FileError: the installation lacks it.
    """
    package = Path(__file__).resolve().parents[2]
    for folder in (package / "scenarios", package.parent / "scenarios"):
        path = folder / "benches" / f"{name}.json"
        if path.is_file():
            return path
    raise FileError(
        f"{name}.json", "the shipped list of seed scenes is missing", "give one with --scenes FILE"
    )


def choose_scenes(requested: str, name: str = TABLE_LIST) -> SceneList:
    """Return the scenes of ``--scenes``: the first ones of the shipped list *name*, or those of the file of a list.

    Raises:
        InputError: there is no such file, or the number is impossible.
    """
    if requested.isdigit() and int(requested) > 0:
        return read_scene_list(shipped_list(name)).first(int(requested))
    if requested.lstrip("+-").isdigit():
        raise ConfigError(f"--scenes {requested}: give a number above 0, or the file of a list")
    return read_scene_list(Path(requested))


def make_list(
    per_net: int,
    seed: int,
    about: str,
    nets: Sequence[str] = SHIPPED_NETS,
    scene: SceneOptions | None = None,
    horizon_s: float = HORIZON_S,
    strata: Mapping[str, Stratum] | None = None,
) -> SceneList:
    """Return a new list; the same arguments give the same list.

    Args:
        per_net: number of scenes on each net, with strata for each stratum.
        seed: of all scenes; the k-th stratum has *seed* + k, from k = 0.
        about: its purpose.
        nets: of the list; strata have their own.
        scene: how scenes are found; None: as by ``run``.
        horizon_s: duration of the episodes for which it is made.
        strata: parts of the list with their own options; None: all scenes are found with *scene*.

    Raises:
        InputError: there is no such net.
    """
    scene_options = scene if scene is not None else SceneOptions()
    parts = strata or {"": Stratum(nets=tuple(nets), scene=scene_options)}
    groups = [
        (net_name(net), seed + k, name)
        for k, (name, stratum) in enumerate(parts.items())
        for net in stratum.nets
    ]
    scenes = tuple(
        ListedScene(net=net, seed=group_seed, number=number, stratum=name)
        for number in range(per_net)
        for net, group_seed, name in groups
    )
    return SceneList(
        about=about,
        nets={net: file_digest(*net_files(net)) for net, _, _ in groups},
        sumo=version("libsumo"),
        horizon_s=horizon_s,
        scene=scene_options,
        strata={name: stratum.scene for name, stratum in parts.items() if name},
        scenes=scenes,
    ).sealed()


def write_scene_list(path: Path, scenes: SceneList) -> None:
    """Write a list, one scene per line.

    Raises:
        FileError: it cannot be written.
    """
    dumped = scenes.model_dump(mode="json")
    rows = ",\n  ".join(json.dumps(row, sort_keys=True) for row in dumped.pop("scenes"))
    head = json.dumps(dumped, sort_keys=True, indent=1)
    write_whole(path, f'{head[:-2]},\n "scenes": [\n  {rows}\n ]\n}}\n'.encode())


def _without_added(written: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields without those added later that have their defaults."""
    return {name: value for name, value in written.items() if name not in _ADDED or _ADDED[name] != value}


def _check_order(scenes: SceneList, path: Path) -> None:
    """Refuse unknown strata, and scenes not numbered 0, 1, 2, … for each net, seed and stratum, as sweeps do."""
    counts: Counter[tuple[str, int, str]] = Counter()
    for scene in scenes.scenes:
        if scene.stratum and scene.stratum not in scenes.strata:
            raise FileError(path, f"has no stratum '{scene.stratum}'", "name one of its strata")
        if scene.number != counts[scene.place[:3]]:
            raise FileError(
                path,
                f"scene {scene.number} of {scene.net}, seed {scene.seed} is out of order",
                "number them from 0",
            )
        counts[scene.place[:3]] += 1
    if not scenes.scenes:
        raise FileError(path, "holds no scene", "make a list with some")
