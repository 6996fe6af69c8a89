"""Records of ScenarioNet and their own maps are placed where the map of their data set is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.errors import MapError, SceneError
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.data import ScenarioNetReader, open_log
from advdiff_sumo.data.scenarionet_log import map_offset_m
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.convert import convert_source
from advdiff_sumo.sim.logs import LoggedTraffic, fits
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sim.source_maps import read_source
from tests.sim.records_made import record, write

ORIGIN_M = (1300.0, 1040.0)


def net_of(path: Path) -> RoadMap:
    net = path.with_name(f"{path.stem}.net.xml")
    convert_source(read_source(path), net)
    return RoadMap.read(net)


@pytest.mark.parametrize("told", [False, True], ids=["given away by who is absent", "told"])
def test_a_record_and_its_map_are_where_the_place_is(tmp_path: Path, told: bool) -> None:
    path = write(tmp_path / "sd_drive.pkl", record(ORIGIN_M, told=told))
    road, drive = net_of(path), ScenarioNetReader(path).read("sd_drive")
    np.testing.assert_allclose(read_source(path).lanes[0].centre_m[0], np.add(ORIGIN_M, (-60.0, 0.0)))
    assert drive.location == "old-town"
    assert np.linalg.norm(drive.tracks.xy_m[0, 0] - ORIGIN_M) < 2.0  # from the rear axle to the middle
    assert fits(road, drive)
    scenes = LoggedTraffic(road, open_log(path), SceneOptions(), SimOptions(), SeedTree(0)).scenes()
    assert next(scenes).target == "ego"


def test_a_record_that_was_never_moved_stays(tmp_path: Path) -> None:
    value = record(told=True)
    del value["metadata"]["old_origin_in_current_coordinate"]
    assert map_offset_m(value) is None  # it may have been moved here
    for track in value["tracks"].values():
        track["state"]["position"] += (*ORIGIN_M, 0.0)
    assert map_offset_m(value) == pytest.approx([0.0, 0.0])


def test_where_the_frame_is_lost_drive_and_map_stay_together_and_at_no_place(tmp_path: Path) -> None:
    value = record(ORIGIN_M, told=True, place="boston-seaport")
    del value["metadata"]["old_origin_in_current_coordinate"]
    path = write(tmp_path / "sd_drive.pkl", value)
    road, drive = net_of(path), ScenarioNetReader(path).read("sd_drive")
    assert fits(road, drive)
    assert drive.location == ""
    assert road.lonlat(np.zeros(2)) is None


@pytest.mark.parametrize(
    ("dataset", "says"),
    [("nuscenes", r"\(old-town\)"), ("waymo", r"\(advdiff-sumo convert \S*sd_drive\.pkl -o")],
)
def test_a_net_of_another_place_is_refused_with_the_map_to_convert(
    tmp_path: Path, street: Path, dataset: str, says: str
) -> None:
    path = write(tmp_path / "sd_drive.pkl", record(ORIGIN_M, told=True, dataset=dataset))
    logged = LoggedTraffic(RoadMap.read(street), open_log(path), SceneOptions(), SimOptions(), SeedTree(0))
    with pytest.raises(SceneError, match=f"on this net; convert the log's own map {says}"):
        next(logged.scenes())


def test_a_frame_that_is_no_place_is_named(tmp_path: Path) -> None:
    value = record(told=True)
    value["metadata"]["old_origin_in_current_coordinate"] = np.array([np.nan, 0.0])
    path = write(tmp_path / "sd_drive.pkl", value)
    with pytest.raises(MapError, match=r"is no place\); convert the record again"):
        read_source(path)


@pytest.mark.slow
@pytest.mark.data
def test_a_real_record_is_on_the_net_of_its_map_and_on_that_of_the_data_set(
    adv_data: Path, tmp_path: Path
) -> None:
    path = adv_data / "scenarionet" / "sd_nuscenes_v1.0-mini_scene-0796.pkl"
    drive = ScenarioNetReader(path).read(path.stem)
    for number, source in enumerate(
        (path, adv_data / "nuscenes-mini" / "maps" / "expansion" / f"{drive.location}.json")
    ):
        convert_source(read_source(source), tmp_path / f"{number}.net.xml")
        road = RoadMap.read(tmp_path / f"{number}.net.xml")
        assert fits(road, drive)
        assert road.lonlat(drive.tracks.xy_m[drive.ego, 0]) is not None
