"""Maps that are given as nets: what they are, and the command that makes a net of them."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import pytest

from advdiff_sumo.core.errors import NetError
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.shipped_nets import find_net

LANELET = b'<?xml version="1.0"?><osm><relation id="1"><tag k="type" v="lanelet"/></relation></osm>'


@pytest.mark.parametrize(
    ("name", "content", "kind"),
    [
        ("town.xodr", b'<?xml version="1.0"?><!-- made --><OpenDRIVE/>', "an OpenDRIVE map"),
        ("town.osm", LANELET, "a Lanelet2 map"),
        ("boston.json", b'{"lane_connector": []}', "a nuScenes map"),
        ("log_map_archive_a.json", b'{"lane_segments": {}}', "an Argoverse 2 map"),
        ("ZAM_T-1.xml", b"<commonRoad/>", "a CommonRoad scenario"),
        ("ZAM_T-1.xml.gz", gzip.compress(b"<commonRoad/>", mtime=0), "a CommonRoad scenario"),
        ("sd_a.pkl", b"\x80\x04N.", "a ScenarioNet record"),
        ("map.gpkg", b"SQLite format 3", "a nuPlan map"),
    ],
)
def test_a_map_is_named_with_the_command_that_converts_it(
    tmp_path: Path, name: str, content: bytes, kind: str
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    net = f"{name.split('.')[0]}.net.xml"
    wanted = f"{path}: is {kind}, not a SUMO net; make a net of it: advdiff-sumo convert {path} -o {net}"
    with pytest.raises(NetError, match=f"^{re.escape(wanted)}$"):
        RoadMap.read(find_net(str(path)))


def test_an_extract_of_openstreetmap_is_for_netconvert(tmp_path: Path) -> None:
    path = tmp_path / "my town.osm"
    path.write_text('<osm><node id="1" lat="1" lon="2"/></osm>')
    with pytest.raises(
        NetError, match=r"OpenStreetMap extract.*netconvert --osm-files '\S*my town\.osm' -o 'my town"
    ):
        RoadMap.read(path)


def test_a_folder_of_maps_is_converted_as_a_whole(tmp_path: Path) -> None:
    (tmp_path / "maps" / "expansion").mkdir(parents=True)
    with pytest.raises(NetError, match="is no file"):
        find_net(str(tmp_path))
    (tmp_path / "maps" / "expansion" / "boston.json").write_text("{}")
    with pytest.raises(NetError, match=r"nuScenes' maps.*advdiff-sumo convert --all \S+ -o networks"):
        find_net(str(tmp_path))


def test_what_is_no_map_keeps_its_own_message(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("{}")
    (tmp_path / "b.xml").write_text("<routes/>")
    with pytest.raises(NetError, match="is not readable as XML"):
        RoadMap.read(tmp_path / "a.json")
    with pytest.raises(NetError, match="not <net>; give the path of a SUMO net"):
        RoadMap.read(tmp_path / "b.xml")


@pytest.mark.data
def test_real_maps_are_known(adv_data: Path) -> None:
    kinds = {
        "nuscenes-mini/maps/expansion/boston-seaport.json": "a nuScenes map",
        "commonroad/ZAM_Tjunction-1_97_T-1.xml.gz": "a CommonRoad scenario",
        "argoverse2/log_map_archive_0a1e6f0a-1817-4a98-b02e-db8c9327d151.json": "an Argoverse 2 map",
    }
    for name, kind in kinds.items():
        with pytest.raises(NetError, match=f"is {kind}, not a SUMO net"):
            RoadMap.read(adv_data / name)
