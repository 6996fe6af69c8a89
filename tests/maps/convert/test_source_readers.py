"""Nets agree with third-party readers of the maps: geometry within 2 cm, the same topology, all names."""

from __future__ import annotations

import itertools
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
import small_sources
from defusedxml import ElementTree
from source_readers import read_outside
from source_writers import write_lanelet2, write_nuplan

from advdiff_sumo.maps.convert import convert_source
from advdiff_sumo.maps.convert.sources.read_map import read_map

NEAR_M = 0.02
NONE: dict[str, list[Any]] = {"lanes": [], "apart": [], "links": []}
FILES = [
    ("av2", "argoverse2/log_map_archive_0a1e6f0a-1817-4a98-b02e-db8c9327d151.json"),
    ("commonroad", "commonroad/HRV_Pula-27_3_T-1.xml.gz"),
    ("commonroad", "commonroad/USA_Lanker-1_3_T-1.xml.gz"),
    *(
        pytest.param(*further, marks=pytest.mark.nightly)
        for further in (
            ("av2", "argoverse2/log_map_archive_3b3570b4-7b0b-3268-a571-b0889dbf40b6____MIA_city_47894.json"),
            ("av2", "argoverse2/log_map_archive_adcf7d18-0510-35b0-a2fa-b4cea13a6d76____PIT_city_57819.json"),
            ("commonroad", "commonroad/DEU_Moabit-4_1_T-1.xml.gz"),
            ("commonroad", "commonroad/ZAM_Tjunction-1_97_T-1.xml.gz"),
        )
    ),
]


def drawn(net: Path) -> tuple[dict[str, list[shapely.LineString]], set[tuple[str, str]]]:
    """Return the lines of *net* for each lane of the source, and the links from lane to lane by its connections."""
    root = ElementTree.fromstring(net.read_bytes())
    source, shape = {}, {}
    for row in root.iter("lane"):
        points = [tuple(map(float, point.split(",")[:2])) for point in row.attrib["shape"].split()]
        shape[row.attrib["id"]] = shapely.LineString(points)
        names = [p.attrib["value"] for p in row.findall("param") if p.attrib["key"] == "source"]
        source[row.attrib["id"]] = [name.rsplit(":", 2)[0] for value in names for name in value.split()]
    lines: dict[str, list[shapely.LineString]] = defaultdict(list)
    for lane, names in source.items():
        for name in names:
            lines[name].append(shape[lane])
    links: set[tuple[str, str]] = set()
    for row in root.iter("connection"):
        if row.attrib["from"].startswith(":"):
            continue
        values = [p.attrib["value"] for p in row.findall("param") if p.attrib["key"] == "source"]
        inner = [name.rsplit(":", 2)[0] for value in values for name in value.split()]
        before = source[f"{row.attrib['from']}_{row.attrib['fromLane']}"]
        after = source[f"{row.attrib['to']}_{row.attrib['toLane']}"]
        chain = [name for name, _ in itertools.groupby([*before, *inner, *after])]
        links |= set(itertools.pairwise(chain))
        for name in inner:
            lines[name].append(shape[row.attrib["via"]])
    return lines, links


def differences(
    net: Path, truth: dict[str, Any], offset_m: tuple[float, float] = (0.0, 0.0)
) -> dict[str, list[Any]]:
    """Return lanes and links that only *net* or only *truth* has, and lanes farther apart than ``NEAR_M``.

    Those of *truth* are moved by *offset_m*.
    """
    lines, links = drawn(net)
    alone = set(lines) ^ set(truth["lanes"])
    away_m = {
        token: shapely.distance(shapely.union_all(lines[token]), shapely.points(np.array(points) + offset_m))
        for token, points in truth["lanes"].items()
        if token not in alone
    }
    return {
        "lanes": sorted(alone),
        "apart": [token for token, away in away_m.items() if not away.max() <= NEAR_M],
        "links": sorted(links ^ set(map(tuple, truth["links"]))),
    }


@pytest.mark.data
@pytest.mark.parametrize(("reader", "name"), FILES)
def test_net_holds_what_the_outside_reader_sees(
    reader: str, name: str, adv_data: Path, tmp_path: Path
) -> None:
    truth = read_outside(reader, adv_data / name)
    convert_source(read_map(adv_data / name), tmp_path / "n.net.xml")
    assert differences(tmp_path / "n.net.xml", truth) == NONE


def test_net_holds_what_lanelet2_sees(tmp_path: Path) -> None:
    """Lanelet2's origin is its own, ours is the corner of the full kilometre; lane 1 begins at UTM_M in both."""
    path = tmp_path / "m.osm"
    path.write_text(small_sources.lanelet2(in_degrees=True), encoding="utf-8")
    truth = read_outside("lanelet2", path)
    convert_source(read_map(path), tmp_path / "n.net.xml")
    corner = np.floor((np.array(small_sources.UTM_M) - [0.0, 1.75]) / 1000.0) * 1000.0
    offset = np.array(small_sources.UTM_M) - corner - truth["lanes"]["1"][0]
    assert differences(tmp_path / "n.net.xml", truth, (float(offset[0]), float(offset[1]))) == NONE


@pytest.mark.data
@pytest.mark.parametrize("uneven", [False, True])
def test_net_holds_what_lanelet2_sees_of_a_city(uneven: bool, adv_data: Path, tmp_path: Path) -> None:
    source = read_map(adv_data / "nuscenes-mini/maps/expansion/singapore-onenorth.json")
    write_lanelet2(source, path := tmp_path / "m.osm", uneven=uneven)
    truth = read_outside("lanelet2", path)
    result = convert_source(read_map(path), tmp_path / "n.net.xml")
    first = result.given.lanes[0]
    offset = first.centre_m[0] - truth["lanes"][first.token][0]
    assert differences(tmp_path / "n.net.xml", truth, (float(offset[0]), float(offset[1]))) == NONE


def test_net_holds_what_gdal_sees_of_a_nuplan_map(tmp_path: Path) -> None:
    path = small_sources.write("nuplan", tmp_path)
    check_nuplan(path, tmp_path / "n.net.xml")


@pytest.mark.data
def test_net_holds_what_gdal_sees_of_a_city_as_a_nuplan_map(adv_data: Path, tmp_path: Path) -> None:
    source = read_map(adv_data / "nuscenes-mini/maps/expansion/singapore-onenorth.json")
    write_nuplan(source, tmp_path / "map.gpkg")
    check_nuplan(tmp_path / "map.gpkg", tmp_path / "n.net.xml")


def check_nuplan(path: Path, net: Path) -> None:
    """GDAL's coordinates are relative to the origin of the zone, as ours are."""
    truth = read_outside("nuplan", path)
    convert_source(read_map(path), net)
    assert differences(net, truth) == NONE


def test_net_holds_what_pyxodr_sees_of_an_opendrive_file(tmp_path: Path) -> None:
    check_opendrive(small_sources.write("argoverse2", tmp_path), tmp_path)


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.data
def test_net_holds_what_pyxodr_sees_of_a_city_as_opendrive(adv_data: Path, tmp_path: Path) -> None:
    check_opendrive(adv_data / "nuscenes-mini/maps/expansion/singapore-hollandvillage.json", tmp_path)


def check_opendrive(path: Path, folder: Path) -> None:
    """Write the map at *path* as OpenDRIVE, and read the result."""
    convert_source(read_map(path), folder / "m.net.xml", opendrive=True)
    truth = read_outside("opendrive", folder / "m.xodr")
    convert_source(read_map(folder / "m.xodr"), folder / "n.net.xml")
    assert differences(folder / "n.net.xml", truth) == NONE
