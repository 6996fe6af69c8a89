"""The four real maps meet the requirements on the converter."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import sumolib
from defusedxml import ElementTree

from advdiff_sumo.maps.convert import ConversionResult, convert_map
from advdiff_sumo.maps.convert.fidelity import measure
from advdiff_sumo.maps.convert.poses import compare_poses, ego_poses

pytestmark = [pytest.mark.data, pytest.mark.slow]
# the other two, larger, are checked by the tool
LOCATIONS = ("singapore-onenorth", pytest.param("singapore-queenstown", marks=pytest.mark.nightly))


@pytest.fixture(scope="module", params=LOCATIONS)
def result(
    request: pytest.FixtureRequest, adv_data: Path, tmp_path_factory: pytest.TempPathFactory
) -> ConversionResult:
    path = adv_data / "nuscenes-mini" / "maps" / "expansion" / f"{request.param}.json"
    return convert_map(path, tmp_path_factory.mktemp("nets") / f"{request.param}.net.xml")


def test_exact_and_complete(result: ConversionResult) -> None:
    figures = measure(result).as_dict()
    for error in figures["centre_line_error_m"].values():
        assert error["median"] <= 0.02
        assert error["max"] <= 0.20
    assert figures["lanes"]["lost"] == []
    assert figures["connections"]["lost"] == []
    assert figures["connections"]["invented"] == []
    assert all(row["meaning"] != "not explained" for row in figures["netconvert_warnings"])
    assert figures["lane_changes"]["share"] >= 0.85
    assert figures["routes_no_lane_follows"] == []
    assert figures["lanes"]["held"] == figures["lanes"]["given"]


def test_every_token_is_written_in_the_net(result: ConversionResult) -> None:
    data = json.loads(result.source.path.read_text("utf-8"))
    given = {row["token"] for layer in ("lane", "lane_connector") for row in data[layer]}
    root = ElementTree.fromstring(result.net.read_bytes())
    rows = [row for tag in ("lane", "connection") for row in root.iter(tag)]
    params = [param for row in rows for param in row.findall("param") if param.get("key") == "source"]
    assert {part.split(":")[0] for param in params for part in param.attrib["value"].split()} == given


def test_ways_have_the_length_of_their_shape(result: ConversionResult) -> None:
    net = sumolib.net.readNet(str(result.net), withInternal=True)
    inner = [lane for edge in net.getEdges() if edge.getFunction() == "internal" for lane in edge.getLanes()]
    assert inner
    for lane in inner:
        shape = np.array(lane.getShape())[:, :2]
        assert lane.getLength() == pytest.approx(
            max(np.hypot(*np.diff(shape, axis=0).T).sum(), 0.1), abs=1e-3
        )


def test_logged_poses_lie_as_on_the_hd_map(result: ConversionResult, adv_data: Path) -> None:
    poses = ego_poses(adv_data / "nuscenes-mini", result.source.location)
    figures = compare_poses(result, np.vstack(list(poses.values())))
    assert figures["on_a_lane_of_the_net"] == figures["poses"] > 0
    assert figures["differences_above_0.05_m"] == 0
