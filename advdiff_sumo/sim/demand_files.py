"""Demand that the user brings: a route file, or a SUMO configuration that names several."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import iterparse

from advdiff_sumo.core.errors import FileError, SceneError
from advdiff_sumo.maps import RoadMap

_ROUTES_LOOKED_AT = 500
_GZIP = b"\x1f\x8b"
_WRITES_OUTPUT = {
    "e1Detector",
    "inductionLoop",
    "e2Detector",
    "laneAreaDetector",
    "e3Detector",
    "entryExitDetector",
}
_WRITES_OUTPUT |= {"instantInductionLoop", "edgeData", "laneData", "routeProbe", "timedEvent"}


@dataclass(frozen=True)
class DemandFiles:
    """Files that SUMO reads to make traffic.

    Attributes:
        routes: route files.
        additional: vehicle types, signals and stops that they need.
        begin_s: earliest departure.
        ignored: additional files that hold nothing but detectors and outputs, which SUMO is not given.
    """

    routes: tuple[Path, ...]
    additional: tuple[Path, ...]
    begin_s: float
    ignored: tuple[Path, ...] = ()


def read_demand(path: Path, road: RoadMap) -> DemandFiles:
    """Find the files behind *path* and check that they belong to *road*.

    Args:
        path: ``.rou.xml``, ``.trips.xml`` (each gzipped or not) or ``.sumocfg``.
        road: the net that they will run on.

    Raises:
        FileError: a file is missing, truncated, or no demand.
        SceneError: the routes are of another net.
    """
    _must_be_file(path, "give a .rou.xml, .trips.xml or .sumocfg")
    routes, additional = _of_configuration(path) if path.suffix == ".sumocfg" else ((path,), ())
    begin = min(_check(file, road) for file in routes)
    kept = tuple(file for file in additional if not _only_output(file))
    ignored = tuple(file for file in additional if file not in kept)
    return DemandFiles(tuple(f.resolve() for f in routes), tuple(f.resolve() for f in kept), begin, ignored)


def net_of_configuration(path: Path) -> Path:
    """Return the net that a SUMO configuration names.

    Raises:
        FileError: it is missing, truncated, or names none.
    """
    _must_be_file(path, "give a .net.xml or a .sumocfg")
    for element in _elements(path):
        if element.tag == "net-file" and element.get("value"):
            return path.parent / element.get("value", "")
    raise FileError(path, "names no net-file", "give the .net.xml and the demand one by one")


def _of_configuration(path: Path) -> tuple[tuple[Path, ...], tuple[Path, ...]]:
    files: dict[str, tuple[Path, ...]] = {}
    for element in _elements(path):
        if element.tag in {"route-files", "additional-files"}:
            names = element.get("value", "").replace(",", " ").split()
            files[element.tag] = tuple(path.parent / name for name in names)
    if not files.get("route-files"):
        raise FileError(path, "names no route-files", "give a .rou.xml or a configuration that has them")
    for name in (name for names in files.values() for name in names):
        _must_be_file(name, f"{path.name} names it: put it there or correct the name")
    return files["route-files"], files.get("additional-files", ())


def opened(path: Path) -> gzip.GzipFile | BufferedReader:
    """Open a demand file for reading, gzipped or not, whatever its name says."""
    with path.open("rb") as file:
        zipped = file.read(2) == _GZIP
    return gzip.open(path) if zipped else path.open("rb")


def _must_be_file(path: Path, remedy: str) -> None:
    if not path.is_file():
        raise FileError(path, "is no file" if path.exists() else "no such demand file", remedy)


def _check(path: Path, road: RoadMap) -> float:
    begin, routes, foreign, example = float("inf"), 0, 0, ""
    for element in _elements(path):
        if element.tag in {"vehicle", "trip", "flow", "person"}:
            begin = min(begin, _seconds(element.get("depart") or element.get("begin") or "0"))
        edges = (element.get("edges") or f"{element.get('from') or ''} {element.get('to') or ''}").split()
        if edges:
            routes += 1
            unknown = next((e for e in edges if e not in road.edges and e not in road.beyond_rim), None)
            foreign += unknown is not None
            example = example or unknown or ""
        if routes >= _ROUTES_LOOKED_AT:
            break
    if not routes:
        raise FileError(path, "holds no vehicle, trip or flow with a route", "give demand made for the net")
    if foreign > routes // 2:
        raise SceneError(
            f"{path}: {foreign} of its first {routes} routes use edges that {road.path.name} does not have "
            f"(such as '{example}'); it is the demand of another net, give that net or other demand"
        )
    return begin if begin < float("inf") else 0.0


def _only_output(path: Path) -> bool:
    """Return whether *path* holds detectors only, which would write files beside it."""
    tags = {element.tag for element in _elements(path)} - {
        "additional",
        "add",
        "param",
        "detEntry",
        "detExit",
    }
    return bool(tags) and tags <= _WRITES_OUTPUT


def _elements(path: Path) -> Iterator[Element]:
    try:
        with opened(path) as file:
            yield from (element for _, element in iterparse(file, events=("end",)))
    except (EOFError, zlib.error, gzip.BadGzipFile):
        raise FileError(path, "is a truncated gzip file", "export it again") from None
    except (ParseError, DefusedXmlException) as error:
        raise FileError(
            path, f"not well-formed XML ({error})", "it may be truncated: export it again"
        ) from None
    except OSError as error:
        raise FileError(path, f"cannot be read ({error.strerror})") from None


def _seconds(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return 0.0  # "triggered", "now", hh:mm:ss: SUMO knows; for us the beginning will do
