"""Read a map of any supported format; file name and content determine the format."""

from __future__ import annotations

from pathlib import Path

from advdiff_sumo.core.errors import MapError
from advdiff_sumo.core.map_files import load_json, load_xml
from advdiff_sumo.maps.convert.sources.argoverse2_map import argoverse2_map
from advdiff_sumo.maps.convert.sources.commonroad_map import commonroad_map
from advdiff_sumo.maps.convert.sources.lanelet2_map import lanelet2_map
from advdiff_sumo.maps.convert.sources.nuplan_map import nuplan_map
from advdiff_sumo.maps.convert.sources.nuscenes_map import nuscenes_map
from advdiff_sumo.maps.convert.sources.opendrive_map import opendrive_map
from advdiff_sumo.maps.convert.sources.source_map import SourceMap

FORMATS = (
    "a nuScenes map expansion or an Argoverse 2 log_map_archive (.json), a ScenarioNet record (.pkl), "
    "a CommonRoad scenario (.xml, .xml.gz), a Lanelet2 map (.osm), an OpenDRIVE file (.xodr), a nuPlan map (.gpkg)"
)

_ENDINGS = {"OpenDRIVE": ".xodr", "osm": ".osm"}


def read_map(path: Path) -> SourceMap:
    """Return the map in *path*, of any supported format.

    Raises:
        MapError: the file cannot be read, is of no known format, or holds nothing usable.
    """
    name = path.name.removesuffix(".gz")
    if name.endswith(".json"):
        data = load_json(path, f"give {FORMATS}")
        is_argoverse = isinstance(data, dict) and "lane_segments" in data
        return argoverse2_map(data, path) if is_argoverse else nuscenes_map(data, path)
    if name.endswith(".xml"):
        root = load_xml(path)
        _check_root(root.tag, path)
        return commonroad_map(root, path)
    if name.endswith(".osm"):
        return lanelet2_map(load_xml(path), path)
    if name.endswith(".xodr"):
        return opendrive_map(load_xml(path), path)
    if name.endswith(".gpkg"):
        return nuplan_map(path)
    if name.endswith(".pkl"):
        raise MapError(path, "is a gzipped record", "unpack it first, with gunzip")
    if path.is_dir():
        raise MapError(
            path, "is a folder", "give one map in it, or all maps of a nuScenes data set with --all"
        )
    raise MapError(path, "is of no known map format", f"give {FORMATS}")


def _check_root(tag: str, path: Path) -> None:
    """Raise a MapError unless *tag*, the root element of a file that ends with .xml, is CommonRoad's."""
    if tag == "net":
        raise MapError(path, "is a SUMO net already", "give it as it is, with --net")
    if tag in _ENDINGS:
        raise MapError(
            path, f"begins with <{tag}> but ends with .xml", f"let its name end with {_ENDINGS[tag]}"
        )
    if tag != "commonRoad":
        raise MapError(path, f"begins with <{tag}>, so it is no map of a known format", f"give {FORMATS}")
