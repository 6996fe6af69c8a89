"""Projections of maps of other formats: as SUMO's tools read them, and with streets around the maps."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pyproj
import pytest
import small_sources
import sumolib
from osm_extracts import OsmExtract
from test_bad_formats import text_of, write

from advdiff_sumo.maps.convert import convert_source
from advdiff_sumo.maps.convert.projection import projection_from
from advdiff_sumo.maps.convert.sources.georeference import PlanarTransform, stated_projection
from advdiff_sumo.maps.convert.sources.map_faults import MapFaults
from advdiff_sumo.maps.convert.sources.read_map import read_map
from advdiff_sumo.maps.convert.sources.source_map import SourceMap

UTM_32 = "+proj=utm +zone=32 +ellps=WGS84 +units=m +no_defs"
CARLA = (
    "+proj=tmerc +lat_0=4.9000000000000000e+1 +lon_0=8.0000000000000000e+0 +k=1 +x_0=0 +y_0=0 +datum=WGS84 "
    "+units=m +geoidgrids=egm96_15.gtx +vunits=m +no_defs"
)
EAST_M, NORTH_M = small_sources.UTM_M


def opendrive(folder: Path, system: str, offset: str = "") -> SourceMap:
    """Return the small road as OpenDRIVE with a *system* and an *offset*."""
    path, text = text_of("opendrive", folder)
    first, last = text.index("<geoReference>"), text.index("</geoReference>") + len("</geoReference>")
    write(path, text[:first] + f"<geoReference><![CDATA[{system}]]></geoReference>{offset}" + text[last:])
    return read_map(path)


def commonroad(folder: Path, inside: str) -> SourceMap:
    """Return the small road as a CommonRoad scenario with a *location*."""
    path = small_sources.write("commonroad", folder)
    text = gzip.decompress(path.read_bytes()).decode()
    head = text.index("<lanelet ")
    write(path, f"{text[:head]}<location><geoNameId>-999</geoNameId>{inside}</location>{text[head:]}")
    return read_map(path)


def transformation(system: str, **values: object) -> str:
    """Return CommonRoad's element for a *system* with additional *values*."""
    rows = "".join(f"<{key}>{value}</{key}>" for key, value in values.items())
    more = f"<additionalTransformation>{rows}</additionalTransformation>" if rows else ""
    return f"<geoTransformation><geoReference>{system}</geoReference>{more}</geoTransformation>"


def place_deg(source: SourceMap, xy_m: tuple[float, float], folder: Path) -> tuple[float, float]:
    """Return longitude and latitude of a point of the net made from *source*, by sumolib."""
    net = convert_source(source, folder / "placed.net.xml", crossings="none").net
    return sumolib.net.readNet(str(net)).convertXY2LonLat(*xy_m)


def test_systems_worked_by_hand() -> None:
    """The origin of a Mercator of 49° north, 8° east; 500 km east is the middle of a UTM zone; the equator is at 0."""
    assert pyproj.Proj(projection_from(CARLA))(0.0, 0.0, inverse=True) == pytest.approx((8.0, 49.0), abs=1e-9)
    shifted = pyproj.Proj(projection_from(CARLA, (100.0, -200.0)))
    assert shifted(-100.0, 200.0, inverse=True) == pytest.approx((8.0, 49.0), abs=1e-9)
    zone_32 = pyproj.Proj(projection_from("EPSG:32632", (499_000.0, 0.0)))
    assert zone_32(1000.0, 0.0, inverse=True) == pytest.approx((9.0, 0.0), abs=1e-9)
    south = pyproj.Proj(projection_from("+proj=utm +zone=56 +south +datum=WGS84", (0.0, 9_999_000.0)))
    assert south(500_000.0, 1000.0, inverse=True) == pytest.approx((153.0, 0.0), abs=1e-9)


@pytest.mark.parametrize("offset_m", [(0.0, 0.0), (334_000.0, 6_252_000.0)])
@pytest.mark.parametrize(
    "system", ["EPSG:32756", "EPSG:25832", CARLA, "EPSG:3035", "+proj=stere +lat_0=52 +lon_0=5"]
)
def test_systems_as_pyproj_has_them(system: str, offset_m: tuple[float, float]) -> None:
    """In any projection, points differ by the offset alone (EPSG:3035 is Lambert's equal-area projection)."""
    plane = pyproj.Transformer.from_crs(pyproj.CRS(system).geodetic_crs, system, always_xy=True)
    assert plane.source_crs is not None
    area = pyproj.CRS(system).area_of_use
    lon, lat = (0.5 * (area.west + area.east), 0.5 * (area.south + area.north)) if area else (8.1, 49.1)
    ours = pyproj.Proj(projection_from(system, offset_m))(lon, lat)
    assert np.add(ours, offset_m) == pytest.approx(plane.transform(lon, lat), abs=1e-3)


@pytest.mark.parametrize(
    ("system", "problem"),
    [
        ("", "knows"),
        ("somewhere", "knows"),
        ("+proj=utm", "knows"),
        ("EPSG:4326", "no projected"),
        ("+proj=longlat +datum=WGS84", "no projected"),
        ("EPSG:4978", "no projected"),
        ("EPSG:2263", "in metres"),
        ("x" * 10_000, "knows"),
    ],
)
def test_systems_that_cannot_be_used(system: str, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        projection_from(system)


def test_opendrive(tmp_path: Path) -> None:
    offset = f'<offset x="{EAST_M}" y="{NORTH_M}" z="0" hdg="0"/>'
    source = opendrive(tmp_path, UTM_32, offset)
    expected = pyproj.Proj(UTM_32)(EAST_M + 50.0, NORTH_M + 3.5, inverse=True)
    assert place_deg(source, (50.0, 3.5), tmp_path) == pytest.approx(expected, abs=1e-8)
    assert place_deg(opendrive(tmp_path, CARLA), (0.0, 0.0), tmp_path) == pytest.approx((8.0, 49.0), abs=1e-9)


def test_opendrive_of_our_own_keeps_its_place(tmp_path: Path) -> None:
    source = read_map(small_sources.write("lanelet2", tmp_path))
    convert_source(source, tmp_path / "n.net.xml", opendrive=True)
    again = read_map(tmp_path / "n.xodr")
    assert source.projection is not None
    assert again.projection is not None
    places = [pyproj.Proj(text)(60.0, 60.0, inverse=True) for text in (source.projection, again.projection)]
    assert places[0] == pytest.approx(places[1], abs=1e-9)


def test_commonroad(tmp_path: Path) -> None:
    row = transformation(UTM_32, xTranslation=EAST_M, yTranslation=NORTH_M, zRotation=0.0, scaling=1.0)
    expected = pyproj.Proj(UTM_32)(EAST_M + 50.0, NORTH_M, inverse=True)
    assert place_deg(commonroad(tmp_path, row), (50.0, 0.0), tmp_path) == pytest.approx(expected, abs=1e-8)
    assert commonroad(tmp_path, transformation("EPSG:32632")).projection == projection_from("EPSG:32632")
    alone = "<gpsLatitude>49.0</gpsLatitude><gpsLongitude>8.4</gpsLongitude>"
    assert commonroad(tmp_path, alone).projection is None


def test_nuplan(tmp_path: Path) -> None:
    """The road begins at 500 km east, 4000 km north in zone 11: on the meridian 117° west."""
    source = read_map(small_sources.write("nuplan", tmp_path))
    lon, lat = place_deg(source, (500_000.0, 4_000_000.0), tmp_path)
    east, north = pyproj.Proj("EPSG:32611")(lon, lat)
    assert (lon, east, north) == pytest.approx((-117.0, 500_000.0, 4_000_000.0), abs=1e-3)


def test_nuplan_keeps_left_in_singapore(tmp_path: Path) -> None:
    (folder := tmp_path / "sg-one-north" / "9.17.1964").mkdir(parents=True)
    net = convert_source(read_map(small_sources.write("nuplan", folder)), tmp_path / "n.net.xml").net
    assert 'lefthand="true"' in net.read_text("utf-8")


BAD = {
    "+proj=longlat +datum=WGS84": "is no projected coordinate system",
    "EPSG:2263": "is no coordinate system in metres",
    "placeholder": "is no coordinate system that PROJ knows",
}


@pytest.mark.parametrize("system", BAD)
@pytest.mark.parametrize("kind", ["opendrive", "commonroad"])
def test_a_bad_system_is_one_sentence_and_the_map_is_converted(
    kind: str, system: str, tmp_path: Path
) -> None:
    row = transformation(system)
    source = opendrive(tmp_path, system) if kind == "opendrive" else commonroad(tmp_path, row)
    (sentence,) = source.warnings
    assert sentence.startswith(source.path.name)
    assert f"its geoReference '{system}' {BAD[system]}; the net has no place on earth" in sentence
    assert source.projection is None
    net = sumolib.net.readNet(str(convert_source(source, tmp_path / "n.net.xml").net))
    assert not net.hasGeoProj()


@pytest.mark.parametrize(
    ("moved", "problem"),
    [
        (PlanarTransform(turned_rad=0.1), "turned or scaled"),
        (PlanarTransform(scale=2.0), "turned or scaled"),
        (PlanarTransform(x_m=float("nan")), "no number"),
    ],
)
def test_offsets_that_cannot_be_used(moved: PlanarTransform, problem: str) -> None:
    faults = MapFaults(Path("m.xodr"))
    assert stated_projection(UTM_32, moved, faults) is None
    (sentence,) = faults.sentences()
    assert problem in sentence
    assert stated_projection(None, moved, faults) is stated_projection(" \n", moved, faults) is None
    assert len(faults.sentences()) == 1


@pytest.mark.parametrize("value", ["x", "inf"])
def test_an_offset_that_is_no_number_is_told(value: str, tmp_path: Path) -> None:
    for source in (
        opendrive(tmp_path, UTM_32, f'<offset x="{value}" y="0"/>'),
        commonroad(tmp_path, transformation(UTM_32, xTranslation=value)),
    ):
        assert "offset that is no number" in source.warnings[0]


@pytest.mark.parametrize("kind", ["opendrive", "commonroad", "nuplan"])
def test_streets_lead_on_where_the_map_ends(kind: str, tmp_path: Path) -> None:
    """Lanes lead eastwards and, on the left, north out of the map; streets lead from their ends to their beginnings."""
    if kind == "opendrive":
        source = opendrive(tmp_path, UTM_32, f'<offset x="{EAST_M}" y="{NORTH_M}"/>')
    elif kind == "commonroad":
        row = transformation(UTM_32, xTranslation=EAST_M, yTranslation=NORTH_M)
        source = commonroad(tmp_path, row)
    else:
        source = read_map(small_sources.write("nuplan", tmp_path))
    osm = OsmExtract(source.projection)
    corner = np.array([5e5, 4e6]) if kind == "nuplan" else np.zeros(2)
    ring = np.array([(61.0, 30.0), (61.0, 130.0), (-80.0, 130.0), (-80.0, 1.5), (30.0, 1.5)]) + corner
    osm.way(*map(tuple, ring.tolist()))
    result = convert_source(source, tmp_path / "n.net.xml", osm=osm.write(tmp_path / "around.osm.xml"))
    assert result.streets is not None
    assert (result.streets.left, result.streets.entered) == (1, 1)


@pytest.mark.data
def test_genuine_scenarios_state_a_town_and_no_frame(adv_data: Path) -> None:
    """The four CommonRoad scenarios have no geoTransformation, so there is no projection and no warning."""
    for path in sorted((adv_data / "commonroad").glob("*.xml.gz")):
        source = read_map(path)
        assert source.projection is None
        assert not [text for text in source.warnings if "geoReference" in text]


@pytest.mark.data
def test_a_genuine_map_keeps_its_place_through_opendrive(adv_data: Path, tmp_path: Path) -> None:
    source = read_map(adv_data / "nuscenes-mini" / "maps" / "expansion" / "singapore-onenorth.json")
    net = sumolib.net.readNet(str(convert_source(source, tmp_path / "n.net.xml", opendrive=True).net))
    again = sumolib.net.readNet(
        str(convert_source(read_map(tmp_path / "n.xodr"), tmp_path / "o.net.xml").net)
    )
    for place_m in ((0.0, 0.0), (1000.0, 1500.0)):
        assert again.convertXY2LonLat(*place_m) == pytest.approx(net.convertXY2LonLat(*place_m), abs=1e-8)
