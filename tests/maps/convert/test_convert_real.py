"""The four real maps: the bars that the converter is held to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.maps.convert import ConversionResult, convert_map
from advdiff_sumo.maps.convert.fidelity import measure
from advdiff_sumo.maps.convert.poses import compare_poses, ego_poses

pytestmark = pytest.mark.data
LOCATIONS = ("singapore-onenorth", "singapore-queenstown")  # the other two, larger, are checked by the tool


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


def test_logged_poses_lie_as_on_the_hd_map(result: ConversionResult, adv_data: Path) -> None:
    poses = ego_poses(adv_data / "nuscenes-mini", result.source.location)
    figures = compare_poses(result, np.vstack(list(poses.values())))
    assert figures["on_a_lane_of_the_net"] == figures["poses"] > 0
    assert figures["differences_above_0.05_m"] == 0
