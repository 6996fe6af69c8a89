"""Fault and breaches where two ways lead onto one street: onto separate lanes, or onto one lane."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.maps import RoadMap
from tests.metrics.encounters import DT_S, Car, along, build, findings, record_of, signals_of, straight

RAMP_NODES = """<nodes>
  <node id="A" x="-300" y="0"/> <node id="B" x="0" y="0"/> <node id="C" x="400" y="0"/> <node id="R" x="-300" y="-60"/>
</nodes>"""
RAMP_EDGES = """<edges>
  <edge id="AB" from="A" to="B" numLanes="2" speed="30" priority="5"/>
  <edge id="BC" from="B" to="C" numLanes="3" speed="30" priority="5"/>
  <edge id="RB" from="R" to="B" numLanes="1" speed="30" priority="1"/>
</edges>"""


@pytest.fixture(scope="module")
def ramp(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    """A motorway to which a ramp adds the lane BC_0 (y = -8.0) beside BC_1 (y = -4.8), which AB_0 leads onto."""
    return build(tmp_path_factory.mktemp("ramp"), RAMP_NODES, RAMP_EDGES, "ramp")


@pytest.mark.parametrize("cutter_mps", [18.0, 20.0, 22.0])
def test_a_cut_in_from_a_lane_added_by_a_ramp_is_a_lane_entry(ramp, cutter_mps) -> None:
    """The ways do not meet at the ramp's end, so the rule is not giving way.

    The cutter passes the ramp's end at 1 s and moves left at 1.6 m/s from 2.5 s on. Its side is 0.3 m over the line at
    y = -6.4 by 3.1 s. The gap is then 6 m plus what closes in 0.2 s; 0.75 * 26 + (26² - v²) / 12 > 35 m are needed.
    """
    t = DT_S * np.arange(81)
    (path, *_) = ramp.lane_path(("RB", "BC"), "RB_0", 600.0, vclass=None)
    left = np.clip(1.6 * (t - 2.5), 0.0, 3.2)
    cutter = along("cutter", path.line, path.links[0].end_s_m + cutter_mps * (t - 1.0), left)
    ego = straight("ego", (float(cutter.xy_m[33, 0]) - 4.0 - 6.0 - 26.0 * 3.3, -4.8), 0, 26, steps=81)
    breach = ["unsafe_lane_entry"]
    assert findings(record_of(ego, cutter, route=("AB", "BC")), ramp) == ("cut_in", "other", [], breach)
    exchanged = record_of(cutter, ego, route=("RB", "BC"))
    assert findings(exchanged, ramp) == ("cut_in", "target", breach, [])


def turning_in(road: RoadMap, beyond_m: float, speed_mps: float, ego_mps: float = 13.0) -> tuple[Car, Car]:
    """Return an eastward car and one that turns right out of SC_0 ahead of it.

    At 4 s the centre of the second is *beyond_m* beyond the junction, and the front of the first reaches its rear.
    """
    (path, *_) = road.lane_path(("SC", "CE"), "SC_0", 400.0, start_s_m=100.0, vclass=None)
    s_m = path.links[0].end_s_m + beyond_m + speed_mps * (DT_S * np.arange(61) - 4.0)
    turns = along("turns", path.line, s_m)
    x = float(turns.xy_m[40, 0])
    return straight("ego", (x - 4.0 - 4.0 * ego_mps, -4.8), 0, ego_mps, steps=61), turns


@pytest.mark.parametrize("beyond_m", [2.0, 5.0, 8.0, 12.0])
def test_a_red_light_runner_hit_beyond_the_junction_is_at_fault(light_road, beyond_m) -> None:
    """It joined with too small a gap, so the target is no ordinary follower.

    The turning car joins at 7 m/s with a gap of at most 17 m; 0.75 * 13 + (13² - 7²) / 12 = 19.8 m are needed at least.
    """
    ego, turns = turning_in(light_road, beyond_m, 7.0)
    signals = signals_of(light_road, {("SC_0", "CE_0"): "r", ("WC_0", "CE_0"): "G"}, 61)
    kind = "junction" if beyond_m < 5.5 else "rear_end"
    found = findings(record_of(ego, turns, signals=signals), light_road)
    assert found[0].startswith(kind)
    assert found[1:] == ("other", [], ["red_light"])
    exchanged = findings(record_of(turns, ego, route=("SC", "CE"), signals=signals), light_road)
    assert exchanged[1:] == ("target", ["red_light"], [])


def test_a_vehicle_that_failed_to_give_way_and_is_hit_beyond_the_junction_is_at_fault(road) -> None:
    ego, turns = turning_in(road, 8.0, 7.0)
    expected = ("rear_end_striking", "other", [], ["right_of_way"])
    assert findings(record_of(ego, turns), road) == expected


def test_a_vehicle_that_joined_with_the_safe_gap_is_a_leader_beyond_the_junction(road) -> None:
    """At 5 m/s it is in the lane at 1.1 s, 24.6 m ahead; 0.75 * 13 + 13² / 12 = 23.8 m are needed at most."""
    ego, turns = turning_in(road, 8.0, 5.0)
    assert findings(record_of(ego, turns), road)[:2] == ("rear_end_striking", "target")
