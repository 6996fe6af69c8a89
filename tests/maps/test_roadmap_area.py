"""The drivable area and the vector crops."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from advdiff_sumo.core.boxes import corners
from advdiff_sumo.maps import RoadMap, VectorKind

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


def test_crop_by_hand(road):
    """On WC_0 facing east at x = -60: own lane first, the left neighbour 3.2 m to the left."""
    crop = road.vectors(np.array([-60.0, -4.8]), 0.0, 15.0, 16, 5)
    assert crop.xy_m.shape == (16, 5, 2)
    assert crop.kind[0] == VectorKind.LANE
    np.testing.assert_allclose(crop.xy_m[0, :, 1], 0.0, atol=1e-9)
    np.testing.assert_allclose(crop.tangent[0], np.tile([1.0, 0.0], (5, 1)), atol=1e-12)
    assert (crop.width_m[0], crop.speed_mps[0], crop.distance_m[0]) == (
        3.2,
        14.0,
        pytest.approx(0.0, abs=1e-9),
    )
    found = crop.mask[:, 0]
    assert (np.diff(crop.distance_m[found]) >= 0.0).all()
    assert (crop.distance_m[found] <= 15.0).all()
    assert not crop.xy_m[~found].any()
    left = crop.xy_m[found & (crop.kind == VectorKind.LANE)][:, :, 1]
    assert np.isclose(left, 3.2).all(axis=1).any()
    edge = crop.xy_m[found & (crop.kind == VectorKind.ROAD_EDGE)]
    assert np.isclose(edge[..., 1], -1.6).all(axis=1).any()  # the kerb at y = -6.4


def test_crop_turns_with_the_pose(road):
    east = road.vectors(np.array([-60.0, -4.8]), 0.0, 15.0, 16, 5)
    north = road.vectors(np.array([-60.0, -4.8]), 0.5 * np.pi, 15.0, 16, 5)
    np.testing.assert_allclose(north.xy_m[..., 0], east.xy_m[..., 1], atol=1e-9)
    np.testing.assert_allclose(north.xy_m[..., 1], -east.xy_m[..., 0], atol=1e-9)


def test_crop_limits(road):
    assert not road.vectors(np.array([1e4, 0.0]), 0.0, 30.0, 8, 4).mask.any()
    few = road.vectors(np.array([-60.0, -4.8]), 0.0, 50.0, 3, 4)
    assert few.mask.all()
    with pytest.raises(ValueError, match="at least 2"):
        road.vectors(np.zeros(2), 0.0, 30.0, 8, 1)


def test_road_edge_has_the_road_on_its_left(road):
    crop = road.vectors(np.array([-60.0, 0.0]), 0.0, 20.0, 64, 6)
    edges = (crop.kind == VectorKind.ROAD_EDGE) & crop.mask[:, 0]
    xy, tangent = crop.xy_m[edges][:, 2], crop.tangent[edges][:, 2]
    left = xy + 0.3 * np.stack((-tangent[:, 1], tangent[:, 0]), axis=-1)
    assert edges.sum() >= 2
    assert road.covers(left + np.array([-60.0, 0.0])).all()
