"""Reading nets: hand-worked crossings, the same facts as sumolib, one clear sentence for each bad file."""

from __future__ import annotations

import gzip
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import shapely
import sumolib

from advdiff_sumo.core.errors import NetError
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.read_net import BEYOND_TYPE
from advdiff_sumo.maps.sidecar import read_sidecar

REAL = (
    "bologna-acosta/acosta_buslanes.net.xml",
    "drivearena-boston-seaport/osm.net.xml",
    "drivearena-singapore-onenorth/osm.net.xml",
)


def test_cross_lanes(cross):
    road = RoadMap.read(cross)
    assert (road.name, road.lefthand) == ("cross", False)
    assert road.edges["WC"].lane_ids == ("WC_0", "WC_1")
    assert set(road.edges["WC"].successors) == {"CS", "CE", "CN"}
    lane = road.lanes["WC_0"]
    np.testing.assert_allclose(lane.centre_xy_m, [[-100.0, -4.8], [-7.2, -4.8]])
    assert (lane.width_m, lane.speed_mps) == (3.2, 14.0)
    assert lane.length_m == pytest.approx(92.8)
    assert (lane.left_id, lane.right_id) == ("WC_1", None)
    assert (road.lanes["WC_1"].left_id, road.lanes["WC_1"].right_id) == (None, "WC_0")


def test_the_docstring_names_every_attribute(cross):
    names = [name for name in vars(RoadMap.read(cross)) if not name.startswith("_")]
    assert {"lanes", "links", "pedestrian_shapes"} <= set(names)
    assert [name for name in names if f"\n        {name}: " not in RoadMap.__doc__] == []


@pytest.mark.parametrize("edge", ["CN", "NC", "CE"])
def test_what_leads_beyond_the_rim_counts_in_the_right_of_way(cross, tmp_path: Path, edge: str) -> None:
    """Rows of a junction are numbered over all its connections; without those, later ones had another's row."""
    whole = RoadMap.read(cross)
    text = Path(cross).read_text(encoding="utf-8")
    net = tmp_path / "rim.net.xml"
    net.write_text(
        text.replace(f'<edge id="{edge}"', f'<edge id="{edge}" type="{BEYOND_TYPE}"', 1), encoding="utf-8"
    )
    road = RoadMap.read(net)
    assert edge not in road.edges
    ends = {pair: link for pair, link in road.links.items() if not pair[0].startswith(":")}
    assert 0 < len(ends) < len([pair for pair in whole.links if not pair[0].startswith(":")])
    for pair, link in ends.items():
        assert link.request_index == whole.links[pair].request_index, pair


def test_nobody_can_write_into_the_map_that_all_share(cross):
    road = RoadMap.read(cross)
    lane, junction = road.lanes["WC_0"], road.junctions["C"]
    line, pieces = lane.line, road.pieces()
    arrays = [lane.centre_xy_m, line.xy_m, line.s_m, line.tangents, line.segment_yaw_rad]
    arrays += [line.curvature_1pm]
    arrays += [junction.xy_m, junction.shape_xy_m, pieces.xy_m, pieces.features]
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array -= 1.0
    np.testing.assert_allclose(lane.centre_xy_m, [[-100.0, -4.8], [-7.2, -4.8]])


def test_left_hand_neighbours(cross_left):
    road = RoadMap.read(cross_left)
    assert road.lefthand
    np.testing.assert_allclose(road.lanes["WC_0"].centre_xy_m[0], [-100.0, 4.8])
    assert (road.lanes["WC_0"].left_id, road.lanes["WC_0"].right_id) == (None, "WC_1")
    assert road.lanes["WC_1"].left_id == "WC_0"
    assert road.lanes[":C_10_0"].right_id == ":C_10_1"


def test_cross_links(cross):
    road = RoadMap.read(cross)
    straight = road.links["WC_0", "CE_0"]
    assert (straight.direction, straight.state, straight.junction_id) == ("s", "M", "C")
    assert straight.via == (":C_10_0",)
    assert straight.request_index == 10
    left = road.links["WC_1", "CN_0"]
    assert left.via == (":C_12_0", ":C_14_0")  # with a waiting position inside the junction
    assert (left.state, left.request_index, left.yields) == ("m", 12, True)
    assert {link.to_lane for link in road.lanes["WC_0"].successors} == {"CS_0", "CE_0"}
    assert road.lanes[":C_12_0"].successors[0].to_lane == "CN_0"
    assert road.lanes[":C_12_0"].successors[0].via == (":C_14_0",)


def test_right_of_way(cross):
    road = RoadMap.read(cross)
    junction = road.junctions["C"]
    north_straight = road.links["NC_0", "CS_0"].request_index
    east_straight = road.links["EC_0", "CW_0"].request_index
    west_straight = road.links["WC_0", "CE_0"].request_index
    left_turn = road.links["WC_1", "CN_0"].request_index
    assert {east_straight, west_straight} <= junction.response[north_straight]
    assert junction.response[west_straight] == frozenset()
    assert north_straight in junction.foes[west_straight]
    assert east_straight in junction.response[left_turn]
    assert west_straight not in junction.foes[east_straight]


def test_signals(make_cross):
    road = RoadMap.read(make_cross(kind="traffic_light"))
    indices = sorted(link.tls_index for link in road.links.values())
    assert {link.tls_id for link in road.links.values()} == {"C"}
    assert indices == list(range(len(road.links)))
    assert {link.state for link in road.links.values()} <= {"O", "o"}


def test_pedestrian_areas_are_no_lanes(make_cross):
    road = RoadMap.read(
        make_cross("--sidewalks.guess", "--sidewalks.guess.max-speed", "20", "--crossings.guess")
    )
    assert any(name.startswith(":C_c") for name in road.pedestrian_shapes)
    assert any(name.startswith(":C_w") for name in road.pedestrian_shapes)
    assert not any(lane.startswith((":C_c", ":C_w")) for lane in road.lanes)
    sidewalk = road.lanes["WC_0"]
    assert sidewalk.permits("pedestrian")
    assert not sidewalk.permits("passenger")
    assert not sidewalk.is_drivable
    found = road.locate(sidewalk.line.at(40.0)[0], 0.0)
    assert found is not None
    assert found.lane_id == "WC_1"
    indices = {link.request_index for link in road.links.values() if road.lanes[link.from_lane].is_drivable}
    assert -1 not in indices


def test_gzip_reads_the_same(cross, tmp_path):
    packed = tmp_path / "cross.net.xml.gz"
    packed.write_bytes(gzip.compress(cross.read_bytes()))
    plain, unpacked = RoadMap.read(cross), RoadMap.read(packed)
    assert unpacked.name == "cross"
    assert list(plain.lanes) == list(unpacked.lanes)
    assert plain.links == unpacked.links


def _write(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("cut.net.xml", lambda net: net[: len(net) // 2], "not readable as XML"),
        ("cut.net.xml.gz", lambda net: gzip.compress(net)[:-500], "gzip data are cut off"),
        ("empty.net.xml", lambda _: b"", "not readable as XML"),
        ("routes.net.xml", lambda _: b"<routes/>", "root element is <routes>"),
        ("none.net.xml", lambda _: b"<net version='1.20'/>", "no lane that is open to motor vehicles"),
        ("bad.net.xml", lambda net: net.replace(b'speed="14', b'speed="x14'), "malformed value"),
        ("code.net.xml", lambda _: b"<?xml version='1.0' encoding='x'?><net/>", "unknown encoding: x"),
        ("bomb.net.xml", lambda _: b"<!DOCTYPE a [<!ENTITY b 'c'>]><net>&b;</net>", "not readable as XML"),
    ],
)
def test_bad_files_are_named(cross, tmp_path, name, content, says):
    path = _write(tmp_path / name, content(cross.read_bytes()))
    with pytest.raises(NetError, match=says) as caught:
        RoadMap.read(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(NetError, match="no such file"):
        RoadMap.read(tmp_path / "none.net.xml")
    with pytest.raises(NetError, match="is a folder"):
        RoadMap.read(tmp_path)


def test_net_for_pedestrians_only_is_refused(cross, tmp_path):
    text = cross.read_text().replace("<lane ", '<lane allow="pedestrian" ')
    path = _write(tmp_path / "walk.net.xml", text.encode())
    with pytest.raises(NetError, match="open to motor vehicles"):
        RoadMap.read(path)


def test_sidecar_is_found_and_used(cross, tmp_path):
    net = tmp_path / "cross.net.xml"
    shutil.copy(cross, net)
    (tmp_path / "cross.poly.xml").write_text(
        '<additional><poly id="a" type="drivable_area" shape="-10,-10 10,-10 10,10 -10,10"/>'
        '<poly id="h" type="drivable_area_hole" shape="-1,-1 1,-1 1,1 -1,1"/>'
        '<poly id="x" type="building" shape="50,50 60,50 60,60"/></additional>'
    )
    road = RoadMap.read(net)
    assert road.drivable.area == pytest.approx(400.0 - 4.0)
    assert road.bounds == (-10.0, -10.0, 10.0, 10.0)
    bad = tmp_path / "bad.poly.xml"
    bad.write_text('<additional><poly id="a" type="drivable_area" shape="0,0 x,1 2,2"/></additional>')
    with pytest.raises(NetError, match="polygon 'a' has a malformed shape"):
        RoadMap.read(net, bad)
    bad.write_text("<additional/>")
    with pytest.raises(NetError, match="no polygon of type"):
        RoadMap.read(net, bad)


def test_projection(make_cross, cross):
    assert RoadMap.read(cross).lonlat(np.zeros(2)) is None
    proj = "+proj=aeqd +lat_0=42.0 +lon_0=-71.0 +R=6378137"
    net = make_cross()
    net.write_text(net.read_text().replace('projParameter="!"', f'projParameter="{proj}"'))
    road = RoadMap.read(net)
    np.testing.assert_allclose(road.lonlat(np.zeros(2)), [-71.0, 42.0], atol=1e-12)
    assert road.lonlat(np.array([0.0, 111.3195]))[1] == pytest.approx(42.001, abs=1e-6)


@pytest.mark.data
@pytest.mark.parametrize("name", REAL)
def test_same_facts_as_sumolib(adv_data, name):
    """Every lane, connection and right-of-way row that sumolib reads, we read."""
    path = adv_data / "sumo" / name
    road, theirs = RoadMap.read(path), sumolib.net.readNet(str(path), withInternal=True, lxml=False)
    kept = [e for e in theirs.getEdges() if e.getFunction() in ("", "internal")]
    assert set(road.edges) == {e.getID() for e in kept}
    compared = 0
    for edge in kept:
        for lane in edge.getLanes():
            ours = road.lanes[lane.getID()]
            assert ours.width_m == lane.getWidth()
            assert ours.speed_mps == lane.getSpeed()
            assert ours.permits("passenger") == lane.allows("passenger")
            assert ours.permits("bus") == lane.allows("bus")
            if edge.getFunction() == "":
                compared += sum(_same_link(road, c) for c in lane.getOutgoing())
    assert compared == len(road.links)
    assert compared > 100


def _same_link(road, theirs) -> bool:
    ours = road.links[theirs.getFromLane().getID(), theirs.getToLane().getID()]
    assert (ours.via[0] if ours.via else "") == theirs.getViaLaneID()
    assert (ours.direction, ours.state) == (theirs.getDirection(), theirs.getState())
    assert (ours.tls_id or "") == theirs.getTLSID()
    assert (-1 if ours.tls_index is None else ours.tls_index) == theirs.getTLLinkIndex()
    node = theirs.getFrom().getToNode()
    assert ours.junction_id == node.getID()
    number = node.getLinkIndex(theirs)
    if ours.request_index >= 0:
        assert ours.request_index == number
        foes = road.junctions[node.getID()].foes[number]
        assert foes == {i for i in range(len(road.junctions[node.getID()].foes)) if node.areFoes(number, i)}
    return True


def test_connection_to_a_missing_lane_is_refused(cross, tmp_path):
    text = cross.read_text().replace('to="CN" fromLane="0" toLane="0"', 'to="CN" fromLane="0" toLane="7"')
    path = _write(tmp_path / "loose.net.xml", text.encode())
    with pytest.raises(NetError, match="leads to 'CN_7', which is no lane"):
        RoadMap.read(path)


def test_lane_drawn_as_a_point_gets_a_direction(cross, tmp_path):
    """An internal lane without length points along the lane that leads to it."""
    text = cross.read_text()
    start = text.index("shape=", text.index('id=":C_1_0"'))
    end = text.index('"', start + 7) + 1
    path = _write(
        tmp_path / "point.net.xml", (text[:start] + 'shape="-1.6,7.2 -1.6,7.2"' + text[end:]).encode()
    )
    lane = RoadMap.read(path).lanes[":C_1_0"]
    assert lane.length_m == 0.01
    np.testing.assert_allclose(lane.line.tangents, [[0.0, -1.0]], atol=1e-12)


def test_an_area_within_another_ones_hole_is_kept(tmp_path: Path) -> None:
    """A ring of streets, 100 m wide, around a block with a yard of its own, which reaches the block's corner."""
    ring, hole, yard = "0,0 100,0 100,100 0,100", "20,20 80,20 80,80 20,80", "20,20 50,20 50,50 20,50"
    rows = (("drivable_area", ring), ("drivable_area_hole", hole), ("drivable_area", yard))
    polys = "".join(f'<poly id="{k}" type="{kind}" shape="{shape}"/>' for k, (kind, shape) in enumerate(rows))
    path = tmp_path / "x.poly.xml"
    path.write_text(f"<additional>{polys}</additional>", encoding="utf-8")
    area = read_sidecar(path)
    assert area is not None
    assert area.area == pytest.approx(100.0**2 - 60.0**2 + 30.0**2)
    assert area.contains(shapely.Point(35.0, 35.0))
    assert not area.contains(shapely.Point(65.0, 65.0))


@pytest.mark.parametrize("lefthand", [False, True])
def test_turning_round_has_a_letter_of_its_own_on_each_side(tmp_path: Path, lefthand: bool) -> None:
    net = tmp_path / "x.net.xml"
    words = [
        "--grid",
        "--grid.number",
        "3",
        "--no-turnarounds",
        "false",
        "--lefthand",
        str(lefthand).lower(),
        "-o",
        str(net),
    ]
    subprocess.run([sumolib.checkBinary("netgenerate"), *words], check=True, capture_output=True)
    links = [link for lane in RoadMap.read(net).lanes.values() for link in lane.successors]
    back = [link for link in links if link.turns_round]
    assert back
    assert all(link.direction == ("T" if lefthand else "t") for link in back)
    assert {link.direction for link in links} > {link.direction for link in back}
