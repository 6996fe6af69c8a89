"""Recognises map files and folders that were given as a net, and names the command that converts them."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

from advdiff_sumo.core.errors import NetError
from advdiff_sumo.core.gzipped import DAMAGED_GZIP, unpacked

_ROOT = re.compile(rb"<([A-Za-z]\w*)")
_HEAD_BYTES = 1 << 16  # the root element is sought in these
_LANELET = re.compile(rb"""v\s*=\s*["']lanelet["']""")
_JSON_MAPS = (
    (b'"lane_segments"', "an Argoverse 2 map"),
    (b'"arcline_path_3"', "a nuScenes map"),
    (b'"lane_connector"', "a nuScenes map"),
)
_XML_MAPS = {b"OpenDRIVE": "an OpenDRIVE map", b"commonRoad": "a CommonRoad scenario"}
_ENDINGS = (".gz", ".xml", ".json", ".pkl", ".osm", ".xodr", ".gpkg")
EXTRACT = "an OpenStreetMap extract"
"""The kind of OpenStreetMap files, as used in messages."""
_BY_ENDING = {".pkl": "a ScenarioNet record", ".gpkg": "a nuPlan map"}


def map_error(path: Path) -> NetError | None:
    """Return the error for an HD map or OpenStreetMap extract that was given as a net; None for other files.

    Args:
        path: a file that is not a SUMO net.
    """
    kind = _kind(path)
    if kind is None:
        return None
    command = extract_command(path) if kind == EXTRACT else f"advdiff-sumo convert {_given_and_net(path)}"
    return NetError(path, f"is {kind}, not a SUMO net", f"make a net of it: {command}")


def extract_command(path: Path) -> str:
    """Return the command that converts an OpenStreetMap extract into a net."""
    return f"netconvert --osm-files {_given_and_net(path)}"


def _given_and_net(path: Path) -> str:
    return f"{shlex.quote(str(path))} -o {shlex.quote(f'{map_name(path)}.net.xml')}"


def folder_error(path: Path) -> NetError:
    """Return the error for a folder that was given as a net."""
    if any(path.glob("maps/expansion/*.json")):
        command = f"advdiff-sumo convert --all {shlex.quote(str(path))} -o networks"
        return NetError(
            path, "is the root of nuScenes' maps, not a SUMO net", f"make nets of them: {command}"
        )
    return NetError(path, "is no file", "give a .net.xml file")


def _kind(path: Path) -> str | None:
    """Return the kind of map that *path* holds, by its ending or its content; None if it is no known map."""
    ending = Path(path.name.removesuffix(".gz")).suffix
    if ending in _BY_ENDING:
        return _BY_ENDING[ending]
    try:
        with unpacked(path) as file:
            content = file.read()
    except (OSError, *DAMAGED_GZIP):
        return None
    if ending == ".json":
        return next((kind for mark, kind in _JSON_MAPS if mark in content), None)
    root = _ROOT.search(content[:_HEAD_BYTES])
    if root is not None and root[1] == b"osm":
        return "a Lanelet2 map" if _LANELET.search(content) else EXTRACT
    return None if root is None else _XML_MAPS.get(root[1])


def map_name(path: Path) -> str:
    """Return the name of a map's file without known endings; other dots are kept, as in names of Waymo records."""
    name = path.name
    for ending in _ENDINGS:
        name = name.removesuffix(ending)
    return name
