"""The drivable area."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely

from advdiff_sumo.core.boxes import corners
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.drivable import DrivableArea, area_of_lanes
from advdiff_sumo.maps.lanes import Junction, Lane

REAL = (
    "bologna-acosta/acosta_buslanes.net.xml",
    "drivearena-boston-seaport/osm.net.xml",
    "drivearena-singapore-onenorth/osm.net.xml",
)


@pytest.fixture(scope="module")
def road(cross) -> RoadMap:
    return RoadMap.read(cross)


def test_area_of_lanes_by_hand(road):
    """West arm: y from -6.4 to 3.2, from x = -100 to the junction."""
    inside = np.array([[-50.0, -6.3], [-50.0, 3.1], [0.0, 0.0]])
    outside = np.array([[-50.0, -6.5], [-50.0, 3.3], [-101.0, 0.0], [np.nan, 0.0]])
    assert road.covers(inside).all()
    assert not road.covers(outside).any()
    np.testing.assert_allclose(
        road.drivable_edge_distance(np.array([[-50.0, -6.0], [-50.0, -8.4], [-50.0, 0.0]])),
        [0.4, -2.0, 3.2],
        atol=1e-6,
    )
    assert np.isnan(road.drivable_edge_distance(np.array([[np.nan, 0.0]]))).all()


def test_off_road_share_by_hand(road):
    xy = np.array([[-50.0, 0.0], [-50.0, -6.4], [-50.0, -5.9], [-50.0, 20.0], [np.nan, 0.0]])
    boxes = corners(xy, np.zeros(5), np.tile([4.0, 2.0], (5, 1)))
    np.testing.assert_allclose(road.off_road_share(boxes)[:4], [0.0, 0.5, 0.25, 1.0], atol=1e-6)
    assert np.isnan(road.off_road_share(boxes)[4])
    assert road.off_road_share(np.zeros((0, 4, 2))).shape == (0,)


@pytest.mark.parametrize("angle_rad", [0.7, 1.4184600104607972, 3.0510460534636357])
def test_a_turned_net_loses_no_lane(road, angle_rad):
    """At the last two angles, corners of neighbouring lanes differ in the last bits only; GEOS then lost an arm."""
    turn = np.array([[np.cos(angle_rad), np.sin(angle_rad)], [-np.sin(angle_rad), np.cos(angle_rad)]])
    lanes = [replace(lane, centre_xy_m=lane.centre_xy_m @ turn) for lane in road.lanes.values()]
    junctions = {name: replace(x, shape_xy_m=x.shape_xy_m @ turn) for name, x in road.junctions.items()}
    assert area_of_lanes(lanes, junctions).area == pytest.approx(road.drivable.area, abs=0.01)


@pytest.mark.data
@pytest.mark.parametrize("name", REAL)
def test_area_without_sidecar_covers_lanes(adv_data, name):
    road = RoadMap.read(adv_data / "sumo" / name)
    lanes = [lane for lane in road.lanes.values() if lane.is_drivable and not lane.is_internal]
    middles = np.array([lane.line.at(0.5 * lane.length_m)[0] for lane in lanes])
    assert road.covers(middles).all()
    assert shapely.is_valid(road.drivable)


@pytest.mark.data
def test_tiles_give_the_exact_share(adv_data):
    """The share by tiles is the share by one intersection with the whole area."""
    road = RoadMap.read(adv_data / "sumo" / REAL[1])
    rng = np.random.default_rng(3)
    lanes = [lane for lane in road.lanes.values() if lane.is_drivable]
    xy = np.array([lanes[i].centre_xy_m[0] for i in rng.integers(len(lanes), size=200)])
    boxes = corners(
        xy + rng.normal(0.0, 3.0, xy.shape), rng.uniform(-3.0, 3.0, 200), np.tile([4.5, 1.9], (200, 1))
    )
    polygons = shapely.polygons(boxes)
    expected = 1.0 - shapely.area(shapely.intersection(polygons, road.drivable)) / shapely.area(polygons)
    assert 0.1 < (expected > 0.01).mean() < 0.9
    np.testing.assert_allclose(road.off_road_share(boxes), expected, atol=1e-9)


def test_road_edge_has_the_road_on_its_left(road):
    for ring in road.area.smooth_rings():
        along = np.diff(ring, axis=0)
        ahead = along / np.hypot(along[:, :1], along[:, 1:])
        left = 0.5 * (ring[1:] + ring[:-1]) + 0.3 * np.stack((-ahead[:, 1], ahead[:, 0]), axis=-1)
        assert road.covers(left).all()


def test_a_dead_end_without_extent_leaves_the_area_valid():
    """As netgenerate writes it: the outline of the end goes across the road and back (GEOS makes a ring cross)."""
    path, end = np.array([[306.1, 811.03], [182.98, 957.86]]), np.array([182.98, 957.86])
    length = float(np.linalg.norm(path[1] - path[0]))
    motor = frozenset({"passenger"})
    lane = Lane("e_0", "e", 0, path, 3.2, 13.9, length, length, False, motor, None, None, ())
    across = np.array([[184.21, 958.89], [180.23, 955.55], [184.21, 958.89]])
    junctions = {"96": Junction("96", "dead_end", end, across, {}, {}, ("e_0",))}
    area = DrivableArea(area_of_lanes([lane], junctions)).geometry
    assert shapely.is_valid(area)
    assert area.area == pytest.approx(3.2 * length, abs=0.2)
