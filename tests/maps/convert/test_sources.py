"""Maps of other formats, read through one interface: values computed by hand, then real files."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest
import shapely
import small_sources
import sumolib

from advdiff_sumo.core.errors import MapError
from advdiff_sumo.maps.convert import convert_source
from advdiff_sumo.maps.convert.fidelity import measure
from advdiff_sumo.maps.convert.sources.bounded_lanes import midline, midline_by_length
from advdiff_sumo.maps.convert.sources.read_map import read_map
from tests.e2e.commands import advdiff

KINDS = tuple(small_sources.NAMES)
GENUINE = (
    "argoverse2/log_map_archive_0a1e6f0a-1817-4a98-b02e-db8c9327d151.json",
    "argoverse2/log_map_archive_3b3570b4-7b0b-3268-a571-b0889dbf40b6____MIA_city_47894.json",
    "argoverse2/log_map_archive_adcf7d18-0510-35b0-a2fa-b4cea13a6d76____PIT_city_57819.json",
    "commonroad/DEU_Moabit-4_1_T-1.xml.gz",
    "commonroad/HRV_Pula-27_3_T-1.xml.gz",
    "commonroad/USA_Lanker-1_3_T-1.xml.gz",
    "commonroad/ZAM_Tjunction-1_97_T-1.xml.gz",
)


def test_a_folder_is_no_map(tmp_path: Path) -> None:
    with pytest.raises(
        MapError, match=r"is a folder; give one map in it, or all maps of a nuScenes data set"
    ):
        read_map(tmp_path)
    with pytest.raises(
        MapError, match=r"town\.txt: is of no known map format; give a nuScenes map expansion"
    ):
        read_map(tmp_path / "town.txt")


def test_midline_by_length_in_space() -> None:
    left = np.array([[0.0, 2.0, 0.0], [3.0, 2.0, 4.0], [8.0, 2.0, 4.0]])  # 5 m up a ramp, then 5 m
    right = np.array([[0.0, 0.0, 0.0], [8.0, 0.0, 0.0]])
    assert midline_by_length(left, right).tolist() == [[0.0, 1.0], [3.5, 1.0], [8.0, 1.0]]


def test_midline_of_unequal_boundaries() -> None:
    left = np.array([[0.0, 2.0], [10.0, 2.0]])
    right = np.array([[0.0, 0.0], [4.0, 0.0], [10.0, 0.0]])
    assert midline(left, right).tolist() == [[0.0, 1.0], [4.0, 1.0], [10.0, 1.0]]


@pytest.mark.parametrize("kind", KINDS)
def test_small_road(kind: str, tmp_path: Path) -> None:
    source = read_map(small_sources.write(kind, tmp_path))
    names = [lane.token.rpartition("_")[2] for lane in source.lanes]
    assert sorted(names) == ["1", "2", "3", "4"]
    assert {name: lane.is_connector for name, lane in zip(names, source.lanes, strict=True)}["3"]
    assert sorted((a.rpartition("_")[2], b.rpartition("_")[2]) for a, b in source.links) == [
        ("2", "3"),
        ("3", "4"),
    ]
    origin = np.array([5e5, 4e6]) if kind == "nuplan" else np.zeros(2)
    line = source.lanes[names.index("1")].centre_m - origin
    assert line[[0, -1]] == pytest.approx(np.array([[0.0, 0.0], [50.0, 0.0]]), abs=1e-6)
    assert np.abs(line[:, 1]).max() < 1e-6
    result = convert_source(source, tmp_path / "n.net.xml", crossings="none")
    figures = measure(result).as_dict()
    assert figures["lanes"]["held"] == figures["lanes"]["given"] == 4
    assert figures["connections"]["kept"] == figures["connections"]["given"] == 2
    if kind != "nuplan":  # whose markings are not read
        pairs = figures["lane_changes"]
        assert pairs["dashed_pairs"] == pairs["neighbours_in_one_edge"] == 1
    assert all(error["max"] <= 0.001 for error in figures["centre_line_error_m"].values())
    net = sumolib.net.readNet(str(result.net))
    assert sorted(edge.getLaneNumber() for edge in net.getEdges()) == [1, 2]
    widths = [lane.getWidth() for edge in net.getEdges() for lane in edge.getLanes()]
    assert widths == pytest.approx([3.5] * 3, abs=0.01)


def test_lanelet2_limits_and_lights(tmp_path: Path) -> None:
    source = read_map(small_sources.write("lanelet2", tmp_path))
    assert [lane.speed_mps for lane in source.lanes] == pytest.approx([10.0] * 4)
    assert [(light.token, light.lanes) for light in source.signals] == [("900", ("2",))]


@pytest.mark.parametrize("line", [True, False])
def test_lanelet2_light_of_connectors_stops_before_them(
    line: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The light belongs to connectors 3 and 5, both after lane 2; the map ends at the end of 5, 20 m farther."""
    lanes = {**small_sources.LANES, "5": ([(50.0, 3.5, 0.0), (70.0, 3.5, 0.0)], [], True)}
    monkeypatch.setattr(small_sources, "LANES", lanes)
    rule = '<member type="relation" ref="900" role="regulatory_element"/>'
    text = small_sources.lanelet2().replace(rule, "")
    for name in "35":
        text = text.replace(f'<relation id="{name}">', f'<relation id="{name}">{rule}')
    if line:
        tags = '<tag k="local_x" v="49"/><tag k="local_y" v="{}"/>'
        nodes = "".join(f'<node id="9{n}">{tags.format(y)}</node>' for n, y in enumerate((-1.5, 5.0)))
        text = text.replace("<way", f'{nodes}<way id="99"><nd ref="90"/><nd ref="91"/></way><way', 1)
        member = '<member type="way" ref="99" role="ref_line"/>'
        text = text.replace('<relation id="900">', f'<relation id="900">{member}')
    path = tmp_path / "m.osm"
    path.write_text(text, encoding="utf-8")
    source = read_map(path)
    assert [(light.lanes, light.at is not None) for light in source.signals] == [(("3", "5"), line)]
    plan = convert_source(source, tmp_path / "n.net.xml").plan
    assert plan.idle_signals == ()
    (light,) = [junction.id for junction in plan.junctions if junction.kind == "traffic_light"]
    (road,) = [edge for edge in plan.edges if edge.target == light]
    assert [lane.source.split(":")[0] for lane in road.lanes] == ["1", "2"]


@pytest.mark.parametrize(
    ("text", "limit_mps"),
    [
        ("36", 10.0),
        ("36.0 km/h", 10.0),
        ("36kmh", 10.0),
        ("30mph", 13.4112),
        ("30 mph", 13.4112),
        ("10m/s", 10.0),
        (" 13.9mps ", 13.9),
        ("10 M/S", 10.0),
        ("walk", None),
        ("1.2.3 mph", None),
        ("36 knots", None),
        ("0", None),
        ("9" * 400, None),
    ],
)
def test_lanelet2_units_of_limits(text: str, limit_mps: float | None, tmp_path: Path) -> None:
    """A mile is 1609.344 m. All four lanelets state the limit; limits not understood are ignored and counted."""
    path = tmp_path / "m.osm"
    path.write_text(small_sources.lanelet2().replace("36 km/h", text), encoding="utf-8")
    source = read_map(path)
    limits = [lane.speed_mps for lane in source.lanes]
    assert limits == ([None] * 4 if limit_mps is None else pytest.approx([limit_mps] * 4))
    assert source.notes["speed limits that are not understood"] == (4 if limit_mps is None else 0)


@pytest.mark.parametrize(
    ("tags", "dashed", "solid"),
    [
        ({"type": "line_thin", "subtype": "dashed"}, True, False),
        ({"type": "line_thick", "subtype": "solid"}, False, True),
        ({"type": "line_thin", "subtype": "solid_dashed"}, True, False),
        ({"type": "line_thin", "subtype": "solid", "lane_change": "yes"}, True, False),
        ({"type": "line_thin", "subtype": "dashed", "lane_change": "no"}, False, True),
        ({"type": "curbstone", "lane_change:left": "yes", "lane_change:right": "no"}, True, False),
        ({"type": "virtual", "lane_change:left": "no", "lane_change:right": "no"}, False, True),
        ({"type": "curbstone", "subtype": "low"}, False, True),
        ({"type": "guard_rail"}, False, True),
        ({"type": "wall"}, False, True),
        ({"type": "fence"}, False, True),
        ({"type": "road_border"}, False, True),
        ({"type": "bike_marking"}, False, True),
        ({}, False, False),  # not told
    ],
)
def test_lanelet2_lines_that_may_be_crossed(
    tags: dict[str, str], dashed: bool, solid: bool, tmp_path: Path
) -> None:
    """The line between lanes 1 and 2, by the table in Lanelet2's LinestringTagging.md."""
    given = '<tag k="type" v="line_thin"/><tag k="subtype" v="dashed"/>'
    text = small_sources.lanelet2()
    assert text.count(given) == 1
    path = tmp_path / "m.osm"
    rows = "".join(f'<tag k="{key}" v="{value}"/>' for key, value in tags.items())
    path.write_text(text.replace(given, rows), encoding="utf-8")
    source = read_map(path)
    right, left = (next(lane for lane in source.lanes if lane.token == name) for name in "12")
    assert (bool(right.left_dashed), bool(left.right_dashed)) == (dashed, dashed)
    assert (right.left_solid, left.right_solid) == (solid, solid)


def test_lanelet2_in_degrees(tmp_path: Path) -> None:
    """One lanelet of 111 m eastwards on the equator; in the middle of a zone, UTM scales it by 0.9996."""
    nodes = [(9.0, 0.00002), (9.001, 0.00002), (9.0, 0.0), (9.001, 0.0)]
    rows = "".join(f'<node id="{n}" lon="{lon}" lat="{lat}"/>' for n, (lon, lat) in enumerate(nodes, 1))
    rows += '<way id="10"><nd ref="1"/><nd ref="2"/></way><way id="11"><nd ref="3"/><nd ref="4"/></way>'
    rows += '<relation id="20"><member type="way" ref="10" role="left"/><member type="way" ref="11" role="right"/>'
    path = tmp_path / "m.osm"
    path.write_text(f'<osm>{rows}<tag k="type" v="lanelet"/></relation></osm>', encoding="utf-8")
    (lane,) = read_map(path).lanes
    assert np.hypot(*(lane.centre_m[-1] - lane.centre_m[0])) == pytest.approx(111.3195 * 0.9996, abs=0.01)


def test_nuplan_limits_and_areas(tmp_path: Path) -> None:
    source = read_map(small_sources.write("nuplan", tmp_path))
    assert {lane.token: lane.speed_mps for lane in source.lanes}["connector_3"] == 6.7
    lanes = shapely.union_all([lane.polygon for lane in source.lanes if lane.polygon is not None])
    assert source.drivable.area > lanes.area > 300.0  # the connector has no polygon, yet an area


def test_opendrive(tmp_path: Path) -> None:
    """The road written as OpenDRIVE by our own exporter has the same geometry."""
    first = convert_source(
        read_map(small_sources.write("argoverse2", tmp_path)), tmp_path / "n.net.xml", opendrive=True
    )
    result = convert_source(read_map(tmp_path / "n.xodr"), tmp_path / "again.net.xml")
    figures = measure(result).as_dict()
    assert figures["lanes"]["lost"] == figures["connections"]["lost"] == []
    assert all(error["max"] <= 0.02 for error in figures["centre_line_error_m"].values())
    old, new = (
        shapely.union_all([shapely.LineString(lane.centre_m) for lane in source.lanes])
        for source in (first.source, result.source)
    )
    assert shapely.hausdorff_distance(old, new, densify=0.05) <= 0.02
    assert result.sidecar.exists()


def test_argoverse2_areas(tmp_path: Path) -> None:
    source = read_map(small_sources.write("argoverse2", tmp_path))
    assert source.drivable.area == pytest.approx(62.0 * 62.0)
    (crossing,) = source.crossings
    assert crossing.area == pytest.approx(3.0 * 8.0)


def test_commonroad_signs_and_lights(tmp_path: Path) -> None:
    source = read_map(small_sources.write("commonroad", tmp_path))
    assert [lane.speed_mps for lane in source.lanes] == [10.0, None, None, None]
    assert [(line.token, line.kind) for line in source.stop_lines] == [("2", "STOP_SIGN")]
    assert [(light.token, light.lanes) for light in source.signals] == [("30", ("2",))]
    plan = convert_source(source, tmp_path / "n.net.xml").plan
    assert plan.idle_signals == ()
    assert "traffic_light" in {junction.kind for junction in plan.junctions}


@pytest.mark.parametrize("left", [True, False])
def test_argoverse2_neighbour_of_the_other_direction_is_none(left: bool, tmp_path: Path) -> None:
    data = small_sources.argoverse2()
    if left:  # lane 2 runs against lane 1
        row = data["lane_segments"]["2"]
        sides = row["left_lane_boundary"], row["right_lane_boundary"]
        row["left_lane_boundary"], row["right_lane_boundary"] = sides[1][::-1], sides[0][::-1]
        row["successors"] = []
        data["lane_segments"]["3"]["predecessors"] = []
    path = tmp_path / "m.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    assert bool(read_map(path).lanes[0].left_dashed) == (not left)


@pytest.mark.parametrize("name", ["m.txt", "m.xml", "m.json"])
def test_unknown_formats(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text("<net/>" if name.endswith("xml") else "{}", encoding="utf-8")
    with pytest.raises(MapError, match=name):
        read_map(path)


@pytest.mark.parametrize(
    ("tag", "words"),
    [
        (
            '<tag k="highway" v="residential"/>',
            ("an OpenStreetMap extract", "netconvert --osm-files", "--osm beside"),
        ),
        (
            '<tag k="type" v="line_thin"/>',
            ("holds no relation of type lanelet", "give an unchanged Lanelet2 map"),
        ),
    ],
)
def test_an_extract_of_openstreetmap_is_no_map_with_lanes(
    tag: str, words: tuple[str, ...], tmp_path: Path
) -> None:
    nodes = '<node id="1" lat="42.35" lon="-71.05"/><node id="2" lat="42.351" lon="-71.05"/>'
    path = tmp_path / "my town.osm"
    path.write_text(f'<osm>{nodes}<way id="3"><nd ref="1"/><nd ref="2"/>{tag}</way></osm>', encoding="utf-8")
    with pytest.raises(MapError, match=".*".join(("my town.osm", *words))):
        read_map(path)


@pytest.mark.data
@pytest.mark.parametrize("name", GENUINE)
def test_genuine_files_are_exact_and_complete(name: str, adv_data: Path, tmp_path: Path) -> None:
    figures = measure(convert_source(read_map(adv_data / name), tmp_path / "n.net.xml")).as_dict()
    assert all(error["max"] <= 0.02 for error in figures["centre_line_error_m"].values())
    assert figures["lanes"]["held"] == figures["lanes"]["given"]
    assert figures["lanes"]["lost"] == figures["connections"]["lost"] == []
    assert figures["connections"]["kept"] == figures["connections"]["given"]
    assert figures["connections"]["invented"] == figures["routes_no_lane_follows"] == []
    assert figures["signals"]["that_stop_nobody"] == []
    assert all(row["meaning"] != "not explained" for row in figures["netconvert_warnings"])


@pytest.mark.parametrize("kind", KINDS)
def test_command_converts(kind: str, tmp_path: Path) -> None:
    path = small_sources.write(kind, tmp_path)
    done = advdiff("convert", path, "-o", tmp_path / "n.net.xml", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "hold 4 of 4 lanes and connectors of the file and 2 of its 2 links" in done.out
    figures = json.loads((tmp_path / "n.fidelity.json").read_text("utf-8"))
    assert figures["centre_line_error_m"]["net_to_source"]["median"] == pytest.approx(0.0, abs=1e-3)


def test_command_tells_that_a_record_states_no_links(tmp_path: Path) -> None:
    line = np.array([[0.0, 0.0, 0.0], [50.0, 0.0, 0.0]])
    lanes = {
        name: {"type": "LANE_FREEWAY", "polyline": line + np.array([start, 0.0, 0.0])}
        for name, start in (("1", 0.0), ("2", 50.0))
    }
    path = tmp_path / "sd_r.pkl"
    path.write_bytes(pickle.dumps({"map_features": lanes}))
    done = advdiff("convert", path, "-o", tmp_path / "n.net.xml", cwd=tmp_path)
    assert done.code == 0, done.err
    assert (
        "hold 2 of 2 lanes and connectors of the file and 1 link where lanes meet (it states none),"
        in done.out
    )
