"""The way of a reference driver on a route that passes an edge twice."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.collision import collisions, target_collision
from advdiff_sumo.metrics.reference import drive_reference
from tests.metrics.encounters import DT_S, along, build, record_of, straight

NODES = """<nodes>
  <node id="P" x="0" y="0"/> <node id="Q" x="60" y="0"/> <node id="R" x="60" y="60"/> <node id="S" x="0" y="60"/>
  <node id="T" x="200" y="0"/>
</nodes>"""
EDGES = """<edges>
  <edge id="A" from="P" to="Q"/> <edge id="B" from="Q" to="R"/> <edge id="C" from="R" to="S"/>
  <edge id="D" from="S" to="P"/> <edge id="E" from="Q" to="T"/>
</edges>"""
ROUND_AND_ON = ("A", "B", "C", "D", "A", "E")


@pytest.fixture(scope="module")
def ring(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    """A block of 60 m with the edges A, B, C and D around it, and E straight on from A; A and E lie at y = -1.6."""
    return build(tmp_path_factory.mktemp("ring"), NODES, EDGES, "ring")


@pytest.mark.parametrize("place", ["E", "B"])
def test_the_way_continues_from_the_passage_that_was_reached(ring, place) -> None:
    """On the second passage of A the route, and the target, continue to E, not into B.

    A car standing on E is hit on the second passage, one standing on B on the first.
    """
    (path, *_) = ring.lane_path(ROUND_AND_ON, "A_0", 500.0, start_s_m=5.0, vclass=None)
    ego = along("ego", path.line, 10.0 * DT_S * np.arange(360))
    centre = ring.lanes[f"{place}_0"].line.at(np.asarray(30.0))
    still = straight("still", tuple(centre[0]), float(centre[1]), 0, steps=360)
    record = record_of(ego, still, route=ROUND_AND_ON)
    hit = target_collision(record, collisions(record))
    assert hit is not None
    assert (hit.time_s > 20.0) == (place == "E")
    states = drive_reference(record, ring, hit, "CC_human_driver").states
    way = path.line.project(states.xy_m)[1]
    assert np.abs(way).max() < 0.5, "off the way of the target"
    assert float(np.hypot(*(states.xy_m[-1] - centre[0]))) < 40.0
