"""Routes over edges that no sequence of lanes follows are found, and the converter leaves none."""

from __future__ import annotations

import math
from pathlib import Path

import sumolib
from small_maps import MapBuilder

from advdiff_sumo.maps.convert import convert_map
from advdiff_sumo.maps.convert.lane_routes import RouteLanes, edges_to_part, graph_of_net, undrivable_routes


def graph(changes: bool) -> RouteLanes:
    """Return a → m ← b without lane changes on m: a leads over lane 0 of m to c, b over lane 1 to d."""
    lanes = RouteLanes({name: [set()] for name in "abcd"})
    lanes.changes["m"] = [{1}, {0}] if changes else [set(), set()]
    lanes.add_link(("a", 0), ("m", 0))
    lanes.add_link(("b", 0), ("m", 1))
    lanes.add_link(("m", 0), ("c", 0))
    lanes.add_link(("m", 1), ("d", 0))
    return lanes


def test_routes_that_need_a_forbidden_change() -> None:
    assert sorted(undrivable_routes(graph(changes=False))) == [("a", "m", "d"), ("b", "m", "c")]
    assert edges_to_part(graph(changes=False)) == ["m"]
    assert undrivable_routes(graph(changes=True)) == []


def test_a_change_in_one_direction_helps_one_of_them() -> None:
    lanes = graph(changes=False)
    lanes.changes["m"] = [{1}, set()]
    assert undrivable_routes(lanes) == [("b", "m", "c")]
    assert edges_to_part(lanes) == ["m"]
    assert lanes.parts("m") == [[0], [1]]


def short_middle() -> MapBuilder:
    """Return two lanes of 4 m side by side that come from different roads and lead to different roads."""
    road = MapBuilder()
    for name, y, far_m in (("left", 103.5, 130.0), ("right", 100.0, 70.0)):
        road.straight(f"{name}-in", (20.0, far_m, 0.0), 50.0)
        road.straight(f"{name}-mid", (100.0, y, 0.0), 4.0)
        road.straight(f"{name}-out", (134.0, far_m, 0.0), 50.0)
        _connector(road, f"{name}-a", (70.0, far_m), (100.0, y))
        _connector(road, f"{name}-b", (104.0, y), (134.0, far_m))
        road.link(f"{name}-in", f"{name}-a", f"{name}-mid", f"{name}-b", f"{name}-out")
    road.dashed([(100.0, 101.75), (104.0, 101.75)])
    return road


def _connector(road: MapBuilder, token: str, start: tuple[float, float], end: tuple[float, float]) -> None:
    dx, dy = end[0] - start[0], end[1] - start[1]
    road.straight(token, (*start, math.atan2(dy, dx)), math.hypot(dx, dy), connector=True)


def test_short_edges_are_parted_where_a_route_would_get_stuck(tmp_path: Path) -> None:
    result = convert_map(short_middle().write(tmp_path / "m.json"), tmp_path / "m.net.xml")
    assert result.counts["edges parted as routes got stuck on their lanes"] == 1
    assert undrivable_routes(graph_of_net(result.net)) == []
    net = sumolib.net.readNet(str(result.net))
    assert [edge.getLaneNumber() for edge in net.getEdges()] == [1] * 6
    assert sorted(len(edge.getOutgoing()) for edge in net.getEdges()) == [0, 0, 1, 1, 1, 1]
