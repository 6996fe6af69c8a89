"""Nets, demand and logs for the soak: shipped, from OpenStreetMap files, from a data folder, converted, generated."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from advdiff_sumo.core.errors import AdvdiffError
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps.shipped_nets import SHIPPED_NETS
from advdiff_sumo.sim.training_windows.random_nets import write_random_net
from soak_src.osm_maps import OSM_MAPS, write_osm_net

KINDS = ("grid", "spider", "rand")
SIDES = ("righthand", "lefthand")
LIGHTS = ("map", "guess")


@dataclass(frozen=True)
class Place:
    """A source of seed scenes.

    Attributes:
        name: name of the results folder.
        net: file, or name of a shipped net.
        demand: route file; "": generated traffic.
        scenes: driving log; "": SUMO traffic.
        problem: why there is no net; "" if there is one.
    """

    name: str
    net: str
    demand: str = ""
    scenes: str = ""
    problem: str = ""


def places(folder: Path, data: Path | None, seeds: int) -> Iterator[Place]:
    """Yield all places.

    Args:
        folder: receives the nets that are made; existing ones are used.
        data: folder that may contain ``sumo``, ``nuscenes-mini``, ``commonroad``, ``scenarionet`` and ``argoverse2``;
            None: none of them.
        seeds: number of nets of each random kind.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name in SHIPPED_NETS:
        yield Place(name, name)
    for name in OSM_MAPS:
        yield _osm(folder, name)
    if data is not None:
        yield from _of_data(folder, data)
    for seed, kind in product(range(seeds), KINDS):
        yield _generated(folder, kind, seed)


def _of_data(folder: Path, data: Path) -> Iterator[Place]:
    for net in sorted((data / "sumo").glob("*/*.net.xml")):
        yield Place(f"{net.parent.name}-made-up", str(net))
        demand = net.with_name("run.sumocfg")
        demand = demand if demand.exists() else net.with_name(net.name.replace(".net.", ".rou."))
        if demand.exists():
            yield Place(net.parent.name, str(net), str(demand))
    root = data / "nuscenes-mini"
    for source, lights, side in product(sorted((root / "maps/expansion").glob("*.json")), LIGHTS, SIDES):
        place = _converted(folder, source, lights, side)
        yield place
        own_side = "righthand" if source.stem.startswith("boston") else "lefthand"
        if not place.problem and side == own_side:
            yield Place(f"{place.name}-log", place.net, scenes=str(root))
    others = [*(data / "commonroad").glob("*.xml.gz"), *(data / "scenarionet").glob("*.pkl")]
    for source in sorted([*others, *(data / "argoverse2").glob("*.json")]):
        yield _converted(folder, source, "map", "righthand")


def _converted(folder: Path, source: Path, lights: str, side: str) -> Place:
    stem = Path(source.name.removesuffix(".gz")).stem
    name = f"{stem}-{lights}-{side}"
    net = folder / f"{name}.net.xml"
    if net.exists():
        return Place(name, str(net))
    words = [sys.executable, "-m", "advdiff_sumo", "convert", str(source), "-o", str(net)]
    done = subprocess.run(
        [*words, "--tls", lights, f"--{side}"], capture_output=True, text=True, timeout=600, check=False
    )
    problem = "" if done.returncode == 0 else " ".join((done.stderr or done.stdout).split())[-300:]
    return Place(name, str(net), problem=problem)


def _osm(folder: Path, name: str) -> Place:
    net = folder / f"{name}.net.xml"
    try:
        if not net.exists():
            write_osm_net(name, net)
    except subprocess.CalledProcessError as error:
        return Place(name, str(net), problem=" ".join(error.stderr.split())[-300:])
    return Place(name, str(net))


def _generated(folder: Path, kind: str, seed: int) -> Place:
    name = f"{kind}-{seed}"
    net = folder / f"{name}.net.xml"
    try:
        if not net.exists():
            write_random_net(kind, SeedTree(seed), net)
    except AdvdiffError as error:
        return Place(name, str(net), problem=str(error))
    return Place(name, str(net))
