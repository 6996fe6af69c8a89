"""Routes, lane paths and map matching."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from advdiff_sumo.maps import RoadMap

REAL = (
    "bologna-acosta/acosta_buslanes.net.xml",
    "drivearena-boston-seaport/osm.net.xml",
    "drivearena-singapore-onenorth/osm.net.xml",
)


@pytest.fixture(scope="module")
def road(cross) -> RoadMap:
    return RoadMap.read(cross)


@pytest.fixture(scope="module")
def downtown(networks) -> RoadMap:
    return RoadMap.read(networks / "downtown.net.xml")


def test_routes_on_the_cross(road):
    assert road.route("WC", "CN") == ("WC", "CN")
    assert road.route("WC", "WC") == ("WC",)
    assert road.route("CE", "WC") is None
    assert road.route("WC", "nowhere") is None
    assert road.source_edges() == ("EC", "NC", "SC", "WC")
    assert len(road.edge_graph().strongly_connected()) == 1


def test_random_route(road, downtown):
    first, again = (road.random_route("WC", 500.0, np.random.default_rng(5)) for _ in range(2))
    assert first == again
    assert first[0] == "WC"
    assert len(first) == 2
    edge = sorted(downtown.edge_graph().strongly_connected())[0]
    route = downtown.random_route(edge, 800.0, np.random.default_rng(5))
    assert sum(downtown.edges[e].length_m for e in route[1:]) >= 800.0
    for before, after in pairwise(route):
        assert after in downtown.edges[before].successors
    assert downtown.random_route("nowhere", 800.0, np.random.default_rng(5)) == ()


def test_fastest_is_fastest(downtown):
    """No route by brute force (one detour more) is quicker than the one found."""
    edges = sorted(downtown.edge_graph().strongly_connected())
    graph = downtown.edge_graph("passenger")

    def cost(route):
        crossings = sum(graph.successors[a][b] for a, b in pairwise(route))
        return crossings + sum(graph.drive_s[e] for e in route[1:])

    start, goal = edges[0], edges[-1]
    best = downtown.route(start, goal)
    for middle in edges[:: max(1, len(edges) // 25)]:
        first, second = downtown.route(start, middle), downtown.route(middle, goal)
        assert cost(best) <= cost(first) + cost(second) + 1e-9


def test_lane_choice_on_the_cross(road):
    """Left turns leave from lane 1 only, right turns from lane 0 only, straight on from both."""
    paths = road.lane_path(("WC", "CN"), "WC_0", 200.0, start_s_m=50.0)
    assert [p.lane_ids[0] for p in paths] == ["WC_0", "WC_1"]
    assert [p.offset for p in paths] == [1, 0]
    assert [p.complete for p in paths] == [False, True]
    assert paths[0].lane_change_after_m == pytest.approx(42.8)
    assert paths[0].lane_ids == ("WC_0",)
    assert paths[0].line.length_m == pytest.approx(42.8)
    assert [p.offset for p in road.lane_path(("WC", "CS"), "WC_1", 200.0)] == [-1, 0]
    assert [p.offset for p in road.lane_path(("WC", "CE"), "WC_1", 200.0)] == [0, 0]
    assert road.lane_path(("WC", "CE"), "NC_0", 200.0) == []


def test_left_hand_lane_choice(cross_left):
    """Mirrored: the right turn crosses oncoming traffic and leaves from the inner lane."""
    left_hand = RoadMap.read(cross_left)
    assert [p.offset for p in left_hand.lane_path(("WC", "CS"), "WC_0", 200.0)] == [-1, 0]
    assert [p.offset for p in left_hand.lane_path(("WC", "CN"), "WC_1", 200.0)] == [1, 0]


def test_path_geometry(road):
    path = road.lane_path(("WC", "CN"), "WC_1", 120.0, start_s_m=42.8)[0]
    assert path.lane_ids == ("WC_1", ":C_12_0", ":C_14_0", "CN_0")
    assert path.line.length_m == pytest.approx(120.0, abs=30.0)
    np.testing.assert_allclose(path.line.xy_m[0], [-57.2, -1.6])
    link = path.links[0]
    assert link.s_m == pytest.approx(50.0)
    crossing = sum(road.lanes[x].length_m for x in link.link.via)
    assert link.end_s_m - link.s_m == pytest.approx(crossing, abs=1e-6)
    assert path.speed_mps[0] == 14.0
    assert path.speed_mps[-1] == 10.0
    short = road.lane_path(("WC", "CN"), "WC_1", 30.0)[0]
    assert short.line.length_m == pytest.approx(30.0)
    assert short.links == ()


def test_path_from_inside_the_junction(road):
    (path,) = road.lane_path(("WC", "CN"), ":C_12_0", 50.0, start_s_m=1.0)
    assert path.lane_ids == (":C_12_0", ":C_14_0", "CN_0")
    assert path.complete
    np.testing.assert_allclose(path.line.xy_m[0], road.to_world(":C_12_0", 1.0)[0], atol=1e-9)


def _drive(road: RoadMap, route: tuple[str, ...], step_m: float):
    """Return the longest path along *route* without lane changes, its places, and the edges it drives."""
    paths = [p for x in road.edges[route[0]].lane_ids for p in road.lane_path(route, x, 1e4)[:1]]
    path = max(paths, key=lambda p: p.line.length_m)
    s = np.arange(5.0, path.line.length_m - 5.0, step_m)
    edges = [road.lanes[x].edge_id for x in path.lane_ids if not road.lanes[x].is_internal]
    return *path.line.at(s), tuple(edges)


def test_match_on_the_cross(road):
    xy, yaw, edges = _drive(road, ("WC", "CN"), 3.0)
    assert road.match_route(xy, yaw) == edges == ("WC", "CN")
    gap = np.abs(xy[:, 0]) + np.abs(xy[:, 1]) > 25.0  # nothing seen near the junction
    assert road.match_route(xy[gap], yaw[gap]) == ("WC", "CN")
    on_junction = road.lanes[":C_10_0"].line.at(np.array([3.0, 6.0, 9.0]))
    assert road.match_route(*on_junction) == ("WC", "CE")


def test_match_of_odd_input(road):
    assert road.match_route(np.zeros((0, 2)), np.zeros(0)) is None
    assert road.match_route(np.full((3, 2), np.nan), np.zeros(3)) is None
    assert road.match_route(np.array([[50.0, 50.0]]), np.zeros(1)) is None
    parked = np.tile([-60.0, -4.8], (20, 1))
    assert road.match_route(parked, np.zeros(20)) == ("WC",)
    parked[3:6] = np.nan
    assert road.match_route(parked, np.zeros(20)) == ("WC",)


@pytest.mark.data
@pytest.mark.parametrize("name", REAL)
def test_match_recovers_noisy_drives(adv_data, name):
    """Drives at 2 Hz-like spacing with 0.3 m and 3° of noise come back as the edges driven."""
    road = RoadMap.read(adv_data / "sumo" / name)
    rng = np.random.default_rng(11)
    starts = sorted(road.edge_graph().strongly_connected())
    right = total = 0
    for start in starts[:: max(1, len(starts) // 20)]:
        route = road.random_route(start, 300.0, rng)
        if any(a.removeprefix("-") == b.removeprefix("-") for a, b in pairwise(route)):
            continue  # turning round on the spot leaves no trace on the edge left in between
        xy, yaw, edges = _drive(road, route, 4.0)
        xy, yaw = xy + rng.normal(0.0, 0.3, xy.shape), yaw + rng.normal(0.0, 0.05, yaw.shape)
        right += road.match_route(xy, yaw, "passenger") == edges
        total += 1
    assert total >= 10
    assert right / total >= 0.9
