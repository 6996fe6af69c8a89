"""Poses and lanes: hand-worked places on the crossing, round trips on every net."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from advdiff_sumo.maps import RoadMap

REAL = (
    "bologna-acosta/acosta_buslanes.net.xml",
    "drivearena-boston-seaport/osm.net.xml",
    "drivearena-singapore-onenorth/osm.net.xml",
)


@pytest.fixture(scope="module")
def road(cross) -> RoadMap:
    return RoadMap.read(cross)


def test_hand_worked_place(road):
    pose = road.locate(np.array([-60.0, -4.3]), 0.1)
    assert pose.lane_id == "WC_0"
    assert pose.s_m == pytest.approx(40.0)
    assert pose.d_m == pytest.approx(0.5)
    assert pose.yaw_error_rad == pytest.approx(0.1)
    xy, yaw = road.to_world("WC_0", 40.0, 0.5)
    np.testing.assert_allclose(xy, [-60.0, -4.3])
    assert yaw == 0.0


def test_a_place_before_a_lane_is_at_its_start(road):
    pose = road.locate(np.array([-101.5, -4.8]), 0.0)
    assert (pose.lane_id, pose.s_m, abs(pose.d_m)) == ("WC_0", 0.0, pytest.approx(1.5))


def test_heading_decides_between_directions(road):
    between = np.array([-60.0, 0.0])  # the axis: 1.6 m from WC_1 (east) and from CW_0 (west)
    assert road.locate(between, 0.0).lane_id == "WC_1"
    assert road.locate(between, np.pi).lane_id == "CW_0"
    wrong_way = road.locate(np.array([-60.0, -4.8]), np.pi, max_distance_m=2.0)
    assert wrong_way.lane_id == "WC_0"
    assert abs(wrong_way.yaw_error_rad) == pytest.approx(np.pi)


def test_route_decides_on_the_junction(road):
    start = road.to_world(":C_9_0", 0.5)[0]  # right turn and straight still lie on each other here
    assert road.locate(start, 0.0, route=("WC", "CS")).lane_id == ":C_9_0"
    assert road.locate(start, 0.0, route=("WC", "CE")).lane_id == ":C_10_0"
    assert not road.lanes[road.locate(start, 0.0, internal=False).lane_id].is_internal


def test_far_points_and_nan_have_no_lane(road):
    assert road.locate(np.array([50.0, 50.0]), 0.0) is None
    assert road.locate(np.array([np.nan, 0.0]), 0.0) is None
    ids, s, d, error = road.locate_many(np.array([[50.0, 50.0], [-60.0, -4.8]]), np.zeros(2))
    assert ids == [None, "WC_0"]
    assert np.isnan([s[0], d[0], error[0]]).all()
    assert (s[1], d[1], error[1]) == (pytest.approx(40.0), 0.0, 0.0)
    ids, s, *_ = road.locate_many(np.zeros((0, 2)), np.zeros(0))
    assert ids == []
    assert s.shape == (0,)


def test_many_follow_a_route_too(road):
    start = road.to_world(":C_9_0", 0.5)[0]
    for route, lane in ((("WC", "CS"), ":C_9_0"), (("WC", "CE"), ":C_10_0")):
        assert road.locate_many(start[None], np.zeros(1), route=route)[0] == [lane]


def test_on_a_lane_is_within_its_width(road):
    xy = np.array([[-60.0, -4.3], [-60.0, -6.3], [-60.0, -6.5], [50.0, 50.0], [np.nan, 0.0]])
    assert road.on_lane(xy, np.zeros(5)).tolist() == [True, True, False, False, False]
    assert road.on_lane(np.zeros((0, 2)), np.zeros(0)).shape == (0,)


@given(x=st.floats(-12.0, 12.0), y=st.floats(-12.0, 12.0), yaw=st.floats(-3.2, 3.2))
def test_on_a_lane_is_on_the_one_that_is_located(road, x, y, yaw):
    xy, headings = np.array([[x, y], [3.0 * x, 0.6 * y], [0.6 * x, 3.0 * y]]), np.array([yaw, 0.1 * yaw, 0.0])
    ids, _, d, _ = road.locate_many(xy, headings)
    width = np.array([road.lanes[lane].width_m if lane is not None else 0.0 for lane in ids])
    assert road.on_lane(xy, headings).tolist() == (np.abs(d) <= 0.5 * width).tolist()


def test_near_sorts_by_distance(road):
    poses = road.near(np.array([-60.0, -4.0]), 10.0)
    assert [p.lane_id for p in poses] == ["WC_0", "WC_1", "CW_0"]
    assert [p.d_m for p in poses] == pytest.approx([0.8, -2.4, 5.6])


def test_to_world_clamps_and_is_vectorised(road):
    xy, yaw = road.to_world("WC_0", np.array([-5.0, 0.0, 500.0]))
    np.testing.assert_allclose(xy, [[-100.0, -4.8], [-100.0, -4.8], [-7.2, -4.8]])
    np.testing.assert_allclose(yaw, 0.0)


@given(x=st.floats(-99.0, -8.0), y=st.floats(-6.3, -0.1), yaw=st.floats(-0.5, 0.5))
def test_locate_undone_by_to_world(road, x, y, yaw):
    pose = road.locate(np.array([x, y]), yaw)
    assert pose.lane_id in ("WC_0", "WC_1")
    xy, heading = road.to_world(pose.lane_id, pose.s_m, pose.d_m)
    np.testing.assert_allclose(xy, [x, y], atol=1e-9)
    assert heading + pose.yaw_error_rad == pytest.approx(yaw)
    assert abs(pose.d_m) <= 1.6 + 1e-9


@given(x=st.floats(-120.0, 120.0), y=st.floats(-120.0, 120.0), yaw=st.floats(-3.0, 3.0))
def test_one_and_many_agree(road, x, y, yaw):
    one = road.locate(np.array([x, y]), yaw)
    ids, s, d, error = road.locate_many(np.array([[x, y]]), np.array([yaw]))
    assert ids[0] == (None if one is None else one.lane_id)
    if one is not None:
        assert (s[0], d[0], error[0]) == (one.s_m, one.d_m, one.yaw_error_rad)


def _check_round_trip(road: RoadMap) -> None:
    rng = np.random.default_rng(7)
    lanes = [lane for lane in road.lanes.values() if lane.is_drivable]
    picked = [lanes[i] for i in rng.integers(len(lanes), size=400)]
    places = [road.to_world(lane.id, rng.uniform(0.0, lane.length_m)) for lane in picked]
    xy, yaw = np.array([p for p, _ in places]), np.array([y for _, y in places])
    ids, s, d, error = road.locate_many(xy, yaw)
    back = np.array([road.to_world(lane, *sd)[0] for lane, *sd in zip(ids, s, d, strict=True)])
    np.testing.assert_allclose(back, xy, atol=1e-6)
    assert np.abs(d).max() < 0.5  # each point is on a centre line: only overlapping lanes may win instead
    same = np.array([lane == p.id for lane, p in zip(ids, picked, strict=True)])
    assert same.mean() > 0.8
    assert np.abs(d[same]).max() < 1e-6
    assert np.abs(error[same]).max() < 1e-6


@pytest.mark.data
@pytest.mark.parametrize("name", REAL)
def test_round_trip_on_real_nets(adv_data, name):
    _check_round_trip(RoadMap.read(adv_data / "sumo" / name))


@pytest.mark.parametrize("name", ["downtown", "downtown-left", "motorway"])
def test_round_trip_on_shipped_nets(networks, name):
    _check_round_trip(RoadMap.read(networks / f"{name}.net.xml"))
