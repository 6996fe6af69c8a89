"""The table of map pieces: worked by hand on a crossing, and what holds for any frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import unit
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.shipped_nets import SHIPPED_NETS, find_net
from advdiff_sumo.maps.vector_map import VIEWS, Feature, PieceTable
from tests.sim.nets import build

NEAR = VIEWS["near"]


@pytest.fixture(scope="module")
def road(cross: Path) -> RoadMap:
    return RoadMap.read(cross)


def on_lane(road: RoadMap, lane: str) -> list[int]:
    """Return the pieces whose middle lies on *lane*, in driving order."""
    table, line = road.pieces(), road.lanes[lane].line
    found = {}
    for row in np.flatnonzero(table.features[:, Feature.IS_LANE] > 0):
        s, d = line.project(table.xy_m[row])
        if np.abs(d).max() < 0.02 and (np.diff(s) > 0).all():
            found[float(s[0])] = int(row)
    return [found[s] for s in sorted(found)]


def test_a_lane_of_93_m_is_five_equal_pieces_of_six_points(road: RoadMap) -> None:
    rows = on_lane(road, "WC_1")  # from x = −100 to −7.2, centre at y = −1.6
    assert len(rows) == 5
    points = road.pieces().xy_m[rows]
    np.testing.assert_allclose(points[..., 1], -1.6)
    np.testing.assert_allclose(points[0, :, 0], -100.0 + 18.56 / 5 * np.arange(6), atol=1e-9)
    np.testing.assert_allclose(points[1:, 0], points[:-1, -1])


def test_features_of_a_straight_lane(road: RoadMap) -> None:
    first, *_, last = on_lane(road, "WC_0")
    expected = [3.2, 14.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    np.testing.assert_allclose(road.pieces().features[first], expected)
    np.testing.assert_allclose(
        road.pieces().features[last], expected
    )  # the major road goes straight or right


@pytest.mark.parametrize(
    ("lane", "turn", "yields"),
    [
        (":C_9_0", -1.0, 0.0),  # WC to CS, the major road turns right
        (":C_10_0", 0.0, 0.0),  # WC to CE
        (":C_12_0", 1.0, 1.0),  # WC to CN waits for oncoming traffic
        (":C_14_0", 1.0, 1.0),  # its second half
        (":C_7_0", 0.0, 1.0),  # SC to CN crosses the major road
    ],
)
def test_turns_and_right_of_way_on_the_junction(road: RoadMap, lane: str, turn: float, yields: float) -> None:
    rows = on_lane(road, lane)
    assert rows
    features = road.pieces().features[rows]
    assert (features[:, Feature.TURN] == turn).all()
    assert (features[:, Feature.YIELDS] == yields).all()
    assert (features[:, Feature.IS_INTERNAL] == 1.0).all()
    assert (road.pieces().signal[rows] == -1).all()


def test_only_the_last_piece_before_the_junction_yields(road: RoadMap) -> None:
    rows = on_lane(road, "SC_0")
    assert road.pieces().features[rows, Feature.YIELDS].tolist() == [0.0] * (len(rows) - 1) + [1.0]


def test_left_is_left_in_left_hand_traffic_too(cross_left: Path) -> None:
    road = RoadMap.read(cross_left)
    for link in road.links.values():
        for lane in link.via:
            turns = road.pieces().features[on_lane(road, lane), Feature.TURN]
            assert (turns == {"l": 1.0, "s": 0.0, "r": -1.0}[link.direction]).all()
            heading = road.lanes[lane].line.segment_yaw_rad
            if link.direction != "s" and len(link.via) == 1:
                assert np.sign(np.sin(heading[-1] - heading[0])) == turns[0]


def test_all_way_stops_are_marked(make_cross: Callable[..., Path]) -> None:
    road = RoadMap.read(make_cross(kind="allway_stop"))
    for lane in ("WC_0", "SC_0"):
        *before, last = on_lane(road, lane)
        assert road.pieces().features[last, Feature.STOP_SIGN] == 1.0
        assert not road.pieces().features[before, Feature.STOP_SIGN].any()


def test_signals_count_on_the_junction_and_on_the_piece_before_it(make_cross: Callable[..., Path]) -> None:
    road = RoadMap.read(make_cross(kind="traffic_light"))
    table = road.pieces()
    assert table.signal_links == tuple(("C", index) for index in range(13))
    for link in road.links.values():
        for lane in link.via:
            assert set(table.signal[on_lane(road, lane)].tolist()) == {link.tls_index}
    straight = road.links["WC_0", "CE_0"].tls_index
    rows = on_lane(road, "WC_0")
    assert table.signal[rows].tolist() == [-1] * (len(rows) - 1) + [straight]
    left = on_lane(road, road.links["WC_1", "CN_0"].via[0])
    assert (table.features[left, Feature.YIELDS] == 1.0).all()  # green together with oncoming traffic


def test_signal_letters() -> None:
    links = (*(("J", k) for k in range(9)), ("K", 0))
    table = PieceTable(np.zeros((0, 6, 2)), np.zeros((0, 10)), np.zeros(0, dtype=np.int64), links)
    states = table.signal_states({"J": "rRuyYgGo"})
    assert states.tolist() == [1, 1, 1, 2, 2, 3, 3, 0, 0, 0]  # off, beyond the string, unknown light
    assert states.dtype == np.uint8


def test_nearest_pieces_of_a_car_on_a_lane(road: RoadMap) -> None:
    table = road.pieces()
    rows = table.rows_near(np.array([[-50.0, -1.6]]), np.array([0.0]), np.array([10.0]))[0]
    assert rows.shape == (NEAR.pieces,)
    own = on_lane(road, "WC_1")
    assert rows[:2].tolist() == [own[2], own[3]]  # the one it is on, then the next one, 5.7 m ahead × 0.4
    assert rows[2] == on_lane(road, "WC_0")[2]  # beside it, 3.2 m
    lanes, edges = rows[: NEAR.lanes], rows[NEAR.lanes :]
    assert (table.features[lanes[lanes >= 0], Feature.IS_LANE] == 1.0).all()
    assert (table.features[edges[edges >= 0], Feature.IS_ROAD_EDGE] == 1.0).all()
    assert edges[0] >= 0
    assert (
        abs(table.xy_m[edges[0], :, 1].mean() + 6.4) < 0.1
        or abs(table.xy_m[edges[0], :, 1].mean() - 3.2) < 0.1
    )


def test_turning_round_brings_other_pieces_to_the_front(road: RoadMap) -> None:
    rows = road.pieces().rows_near(np.array([[-50.0, -1.6]] * 2), np.array([0.0, np.pi]), np.zeros(2))
    middle = road.pieces().xy_m[rows[:, : NEAR.lanes]].mean(axis=2)[..., 0]
    found = rows[:, : NEAR.lanes] >= 0
    assert middle[0][found[0]].mean() > middle[1][found[1]].mean()


def test_nothing_is_near_a_point_far_away(road: RoadMap) -> None:
    assert (road.pieces().rows_near(np.array([[1e5, 0.0]]), np.zeros(1), np.zeros(1)) == -1).all()
    assert road.pieces().rows_near(np.zeros((0, 2)), np.zeros(0), np.zeros(0)).shape == (0, NEAR.pieces)


@settings(max_examples=25, deadline=None)
@given(
    shift=st.tuples(st.floats(-500, 500), st.floats(-500, 500)),
    turn=st.floats(-3.1, 3.1),
    seed=st.integers(0, 2**31),
)
def test_the_choice_does_not_depend_on_the_frame(
    table: PieceTable, shift: tuple[float, float], turn: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    xy, yaw = rng.uniform(-80, 80, (5, 2)), rng.uniform(-3, 3, 5)

    def moved(points: FloatArray) -> FloatArray:
        return points @ np.stack((unit(turn), unit(turn + 0.5 * np.pi))) + np.array(shift)

    other = replace(table, xy_m=moved(table.xy_m))
    here, there = table.rows_near(xy, yaw, yaw), other.rows_near(moved(xy), yaw + turn, yaw)
    cost = [
        _costs(t, r, p, y) for t, r, p, y in ((table, here, xy, yaw), (other, there, moved(xy), yaw + turn))
    ]
    np.testing.assert_allclose(cost[0], cost[1], atol=1e-6)  # the same but for ties


@pytest.fixture(scope="module")
def table(road: RoadMap) -> PieceTable:
    return road.pieces()


def _costs(table: PieceTable, rows: FloatArray, xy: FloatArray, yaw: FloatArray) -> FloatArray:
    """Return the distance (S, K) with what lies ahead at 0.4 of its way, 0 where there is no piece."""
    delta = table.xy_m[rows] - xy[:, None, None]
    ahead = delta[..., 0] * np.cos(yaw)[:, None, None] + delta[..., 1] * np.sin(yaw)[:, None, None]
    aside = delta[..., 1] * np.cos(yaw)[:, None, None] - delta[..., 0] * np.sin(yaw)[:, None, None]
    ahead = np.where(ahead > 0.0, 0.4 * ahead, ahead)
    return np.where(rows >= 0, np.hypot(ahead, aside).min(axis=-1), 0.0)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_nearest_first_without_repeats_within_60_m(table: PieceTable, seed: int) -> None:
    rng = np.random.default_rng(seed)
    xy, yaw = rng.uniform(-120, 120, (4, 2)), rng.uniform(-3, 3, 4)
    rows = table.rows_near(xy, yaw, np.full(4, 30.0))
    cost = _costs(table, rows, xy, yaw)
    for part in (slice(0, NEAR.lanes), slice(NEAR.lanes, NEAR.pieces)):
        for agent in range(4):
            found = rows[agent, part][rows[agent, part] >= 0]
            assert (rows[agent, part][len(found) :] == -1).all()
            assert len(set(found.tolist())) == len(found)
            assert (np.diff(cost[agent, part][: len(found)]) >= -1e-9).all()
            away = np.linalg.norm(table.xy_m[found] - xy[agent], axis=-1).min(axis=1)
            assert (away <= 60.0).all()


@pytest.mark.parametrize("net", SHIPPED_NETS)
def test_shipped_nets_give_whole_tables(net: str) -> None:
    table = RoadMap.read(find_net(net)).pieces()
    assert np.isfinite(table.xy_m).all()
    steps = np.linalg.norm(np.diff(table.xy_m, axis=1), axis=-1)
    assert steps.sum(axis=1).max() <= 20.0 + 1e-6
    assert ((table.features[:, Feature.IS_LANE] + table.features[:, Feature.IS_ROAD_EDGE]) == 1.0).all()
    assert table.signal.max() == len(table.signal_links) - 1


def test_the_far_view_reaches_as_far_as_six_seconds_lead(tmp_path: Path) -> None:
    """A straight road of 600 m at 30 m/s: pieces of 60 m; at 30 m/s one sees 60 m + 6.5 s ahead, standing 60 m."""
    nodes = '<nodes><node id="A" x="0" y="0"/><node id="B" x="600" y="0"/></nodes>'
    edges = '<edges><edge id="AB" from="A" to="B" numLanes="1" speed="30" spreadType="center"/></edges>'
    road = RoadMap.read(build(tmp_path, nodes, edges))
    near, far = road.pieces("near"), road.pieces("far")
    assert road.pieces("far") is far
    for table, length_m in ((near, 20.0), (far, 60.0)):
        lanes = table.xy_m[table.features[:, Feature.IS_LANE] > 0.0]
        np.testing.assert_allclose(np.linalg.norm(lanes[:, -1] - lanes[:, 0], axis=-1), length_m, rtol=0.02)
    xy, yaw = np.array([[100.0, 0.0]] * 2), np.zeros(2)
    speed = np.array([30.0, 0.0])
    for table, reach_m in ((near, (60.0, 60.0)), (far, (255.0, 60.0))):
        rows = table.rows_near(xy, yaw, speed)[:, : table.limits.lanes]
        for agent in range(2):
            ahead = table.xy_m[rows[agent][rows[agent] >= 0]][..., 0] - 100.0
            assert (ahead.min(axis=1) <= reach_m[agent] + 1e-6).all()
            assert ahead.max() >= reach_m[agent] - 5.0


@pytest.mark.parametrize("net", SHIPPED_NETS)
def test_what_is_driven_in_six_seconds_is_in_the_far_view(net: str) -> None:
    """Whoever keeps to a lane at its limit for 6 s is within 3 m of a piece of the far view then."""
    road = RoadMap.read(find_net(net))
    table = road.pieces("far")
    lanes = sorted(
        (lane for lane in road.lanes.values() if lane.is_drivable and not lane.is_internal),
        key=lambda lane: (-lane.line.length_m / lane.speed_mps, lane.id),
    )[:20]
    for lane in lanes:
        way = min(6.0 * lane.speed_mps, lane.line.length_m - 1.0)
        (begin, end), yaw, *_ = lane.line.at(np.array([0.5, 0.5 + way]))
        rows = table.rows_near(begin[None], np.asarray(yaw)[:1], np.array([lane.speed_mps]))[0]
        seen = table.xy_m[rows[: table.limits.lanes][rows[: table.limits.lanes] >= 0]]
        share = np.linspace(0.0, 1.0, 50)[:, None, None, None]
        points = seen[None, :, :-1] * (1.0 - share) + seen[None, :, 1:] * share
        assert np.linalg.norm(points - end, axis=-1).min() < 3.0, lane.id
