"""Widths measured on a lane's polygon: computed by hand, then a real lane wider than the largest width in a net."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely
from small_maps import MapBuilder

from advdiff_sumo.maps.convert import convert_map
from advdiff_sumo.maps.convert.lane_widths import width_between, width_profile
from advdiff_sumo.maps.convert.sources.nuscenes_map import read_nuscenes_map

LINE_M = np.array([[0.0, 0.0], [40.0, 0.0]])


@pytest.mark.parametrize(("wide_m", "width_m"), [(3.5, 3.5), (12.0, 12.0), (14.5, 12.0), (40.0, 12.0)])
def test_a_lane_wider_than_twelve_metres_is_twelve_wide(wide_m: float, width_m: float) -> None:
    profile = width_profile(LINE_M, shapely.box(0.0, -0.5 * wide_m, 40.0, 0.5 * wide_m))
    assert profile[:, 1] == pytest.approx(np.full(len(profile), width_m))
    assert width_between(profile, 0.0, 40.0) == pytest.approx(width_m)


def test_what_is_wider_and_what_is_no_width_along_a_lane() -> None:
    """Eleven stations, 3.8 m apart from 1 to 39 m: six where the area is 15 m wide, five where it is 0.4 m."""
    area = shapely.union_all([shapely.box(0.0, -7.5, 21.0, 7.5), shapely.box(21.0, -0.2, 40.0, 0.2)])
    profile = width_profile(LINE_M, area)
    assert profile[:, 0] == pytest.approx([1.0, 4.8, 8.6, 12.4, 16.2, 20.0])
    assert profile[:, 1].tolist() == [12.0] * 6


def test_lanes_without_usable_width_are_counted(tmp_path: Path) -> None:
    road = MapBuilder()
    for name, y in (("bare", 100.0), ("wide", 200.0)):
        end = road.straight(name, (100.0, y, 0.0), 60.0)
        road.straight(f"{name}-on", end, 20.0, connector=True)
        road.straight(f"{name}-out", (180.0, y, 0.0), 60.0)
        road.link(name, f"{name}-on", f"{name}-out")
    for name, y, half_m in (("bare", 100.0, 0.1), ("wide", 200.0, 7.0)):
        corners = [(100.0, y - half_m), (160.0, y - half_m), (160.0, y + half_m), (100.0, y + half_m)]
        row = next(row for row in road.data["lane"] if row["token"] == name)
        row["polygon_token"] = road.polygon(corners)
    result = convert_map(road.write(tmp_path / "m.json"), tmp_path / "m.net.xml")
    assert result.counts["lanes without usable width, made 3.5 m wide"] == 1
    widths = {lane.source.split(":")[0]: lane.width_m for edge in result.plan.edges for lane in edge.lanes}
    assert (widths["bare"], widths["wide"]) == (3.5, 12.0)


@pytest.mark.data
def test_a_real_lane_of_fifteen_metres(adv_data: Path) -> None:
    source = read_nuscenes_map(adv_data / "nuscenes-mini/maps/expansion/boston-seaport.json")
    lane = {row.token: row for row in source.lanes}["d2ff9a7b-c4fb-47da-af74-5f9f894f442f"]
    assert width_between(width_profile(lane.centre_m, lane.polygon), 0.0, 1000.0) == 12.0
