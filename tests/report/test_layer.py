"""Views, and the streets in them."""

from __future__ import annotations

from functools import reduce
from pathlib import Path

import numpy as np
import pytest
import shapely

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.report.layer import MapLayer, NetWindow


def test_view_keeps_margin_and_aspect() -> None:
    view = NetWindow.around(np.array([[0.0, 0.0], [90.0, 10.0], [np.nan, 0.0]]), 5.0, 30.0, aspect=2.0)
    assert view.rectangle == pytest.approx((-5.0, -20.0, 95.0, 30.0))


def test_view_of_one_point_has_the_least_width() -> None:
    assert NetWindow.around(np.array([[7.0, 7.0]]), 1.0, 30.0).rectangle == pytest.approx(
        (-8.0, -3.0, 22.0, 17.0)
    )


def test_view_has_a_largest_width() -> None:
    view = NetWindow.around(np.array([[0.0, 0.0], [500.0, 0.0]]), 5.0, 30.0, most_width_m=60.0)
    assert (view.x0_m, view.x1_m) == pytest.approx((220.0, 280.0))


@pytest.fixture(scope="module", params=["downtown", "downtown-left"])
def layer(request: pytest.FixtureRequest, networks: Path) -> MapLayer:
    return MapLayer(RoadMap.read(networks / f"{request.param}.net.xml"))


def _cut(layer: MapLayer) -> NetWindow:
    x0, y0, x1, y1 = layer.road.bounds
    return NetWindow.around(np.array([[0.5 * (x0 + x1), 0.5 * (y0 + y1)]]), 0.0, 0.4 * (x1 - x0))


def test_streets_are_the_drivable_area(layer: MapLayer) -> None:
    view = _cut(layer)
    streets = layer.streets(view, tolerance_m=0.1)
    drawn = shapely.Polygon()
    for ring in streets.areas:  # even-odd rule
        drawn = drawn.symmetric_difference(shapely.Polygon(ring))
    true = layer.road.drivable.intersection(shapely.box(*view.rectangle))
    assert drawn.symmetric_difference(true).area < 0.02 * true.area


def test_markings_lie_on_the_road_within_the_view(layer: MapLayer) -> None:
    view = _cut(layer)
    streets = layer.streets(view)
    assert streets.solid
    assert streets.dashed
    points = np.concatenate([*streets.solid, *streets.dashed])
    assert (points.min(axis=0) >= (view.x0_m - 1e-6, view.y0_m - 1e-6)).all()
    assert (points.max(axis=0) <= (view.x1_m + 1e-6, view.y1_m + 1e-6)).all()
    assert (layer.road.drivable_edge_distance(points) > -0.3).mean() > 0.95


def test_dashes_lie_between_two_lanes_of_an_edge(layer: MapLayer) -> None:
    for line in layer.streets(_cut(layer)).dashed[:20]:
        near = layer.road.near(line.mean(axis=0), 4.0)
        edges = [layer.road.lanes[pose.lane_id].edge_id for pose in near[:2]]
        sides = [np.sign(pose.d_m) for pose in near[:2]]
        assert edges[0] == edges[1]
        assert sides[0] != sides[1]


def test_blocks_between_streets_stay_open_when_the_view_cuts_the_net(networks: Path) -> None:
    road = RoadMap.read(networks / "downtown.net.xml")
    layer = MapLayer(road)
    view = NetWindow.around(np.array([[386.0, 400.0], [474.0, 496.0]]), 10.0, 50.0, 1.5)
    rings = [shapely.Polygon(ring) for ring in layer.streets(view).areas]
    drawn = reduce(shapely.symmetric_difference, rings)  # the fill rule is even-odd
    there = road.drivable & shapely.box(*view.rectangle)
    assert drawn.area == pytest.approx(there.area, rel=0.01)
    assert not drawn.covers(shapely.Point(444.5, 448.2))
