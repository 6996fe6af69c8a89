"""Breaches by entering a lane or moving sideways in it, and by vehicles towards pedestrians who walk into one.

The crossing and its lanes are those of ``encounters.crossing``; cars are 4 x 2 m.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from advdiff_sumo.core.scene import AgentClass
from tests.metrics.encounters import (
    EDGES,
    NODES,
    Car,
    blame,
    broken,
    build,
    driven,
    record_of,
    straight,
)

NORTH = math.pi / 2


def test_unsafe_and_safe_lane_entries(road) -> None:
    ego = straight("ego", (-150, -4.8), 0, 15)
    cutter = straight("cutter", (-138, -1.6), 0, 10, drift=-2.0)  # 5.5 m ahead, 21.7 m needed
    assert broken(record_of(ego, cutter), road) == ([], ["unsafe_lane_entry"])
    slow_ego = straight("ego", (-150, -4.8), 0, 10)
    roomy = straight("roomy", (-122, -1.6), 0, 2, drift=-2.0)  # 20 m ahead, 15.5 m needed
    roomy.xy_m[16:, 1] = -4.8
    assert broken(record_of(slow_ego, roomy), road) == (["ran_into"], [])
    assert broken(record_of(roomy, slow_ego), road) == ([], ["ran_into"])


def test_an_entry_did_not_lead_to_the_collision_if_the_gap_recovered(road) -> None:
    # 6 m ahead at 12 m/s each (9 m needed) it enters, draws away, and brakes gently 2 s later
    steps = 81
    t = 0.1 * np.arange(steps)
    speed = np.where(t < 1.5, 12.0 + 4.0 * t, np.maximum(0.0, 18.0 - 3.9 * (t - 1.5)))
    cutter = driven("cutter", (-135, -1.6), 0, speed, left=np.maximum(-3.2, -3.2 * t))
    ego = straight("ego", (-150, -4.8), 0, 12, steps=steps)
    assert broken(record_of(ego, cutter), road) == (["ran_into"], [])


def test_a_cut_in_that_ends_in_the_side_is_a_cut_in(road) -> None:
    """The target swerves, and is hit by the side of the vehicle that cut in."""
    steps = 41
    t = 0.1 * np.arange(steps)
    cutter = driven(
        "cutter", (-144.5, -1.6), 0, np.full(steps, 12.0) - 1.0 * t, left=np.maximum(-3.2, -2.5 * t)
    )
    ego = driven("ego", (-150, -4.8), 0, np.full(steps, 13.0), left=np.clip((t - 0.4) * -1.0, -0.8, 0.0))
    assert blame(record_of(ego, cutter), road) == ("cut_in", "other")
    assert broken(record_of(ego, cutter), road) == ([], ["unsafe_lane_entry"])
    assert blame(record_of(cutter, ego), road) == ("cut_in", "target")


def test_sideways(road) -> None:
    steady, drifting = (
        straight("steady", (-150, -1.6), 0, 12),
        straight("drifting", (-150, -4.8), 0, 12, drift=1),
    )
    assert broken(record_of(steady, drifting), road) == ([], ["sideways"])
    assert broken(record_of(drifting, steady), road) == (["sideways"], [])


def test_a_lane_is_entered_by_who_changes_to_it_and_not_by_who_is_there(road) -> None:
    """The motorcycle's centre is over the line (y = -3.2) at 0.9 s, where it touches the car's left side (y = -3.8)."""
    car = straight("car", (-120, -4.8), 0, 12)
    left = -np.clip(0.3 * np.arange(-3, 38), 0.0, 3.2)
    motorcycle = driven("motorcycle", (-116, -1.6), 0, np.full(41, 10.0), left=left, size=(2.2, 0.8))
    assert broken(record_of(car, motorcycle), road) == ([], ["sideways"])
    assert broken(record_of(motorcycle, car), road) == (["sideways"], [])
    assert blame(record_of(motorcycle, car), road)[1] == "target"


def test_both_drift_into_each_other(road) -> None:
    # they touch at 0.75 s, on the line between their lanes
    left, right = (
        straight("left", (-150, -1.6), 0, 12, drift=-0.8),
        straight("right", (-150, -4.8), 0, 12, drift=0.8),
    )
    assert broken(record_of(left, right), road) == (["sideways"], ["sideways"])


def test_a_leader_on_a_junction_does_not_cut_in(road) -> None:
    """The leader reaches the next lane first; that is no entry into the lane of the follower."""
    lead = straight("lead", (-16, -1.6), 0, 9, steps=61)
    chaser = straight("chaser", (-45, -1.6), 0, 15, steps=61)
    assert broken(record_of(lead, chaser), road) == ([], ["ran_into"])
    assert blame(record_of(lead, chaser), road) == ("rear_end_struck", "other")


def test_a_slow_pedestrian_far_ahead_and_one_that_runs_out(road) -> None:
    walker = {"size": (0.6, 0.6), "agent_class": AgentClass.PEDESTRIAN}
    ego = straight("ego", (-150, -4.8), 0, 12, steps=51)
    # in the lane (y > -6.7 + 0.3 at its edge) at 0.5 s, 36 m ahead: 9 + 12 = 21 m are needed
    slow = driven("slow", (-106, -7.2), NORTH, np.full(51, 1.0), **walker)
    assert broken(record_of(ego, slow), road) == (["ran_into"], [])
    sudden = driven("sudden", (-106, -9.2), NORTH, np.full(51, 1.0), **walker)  # 2 s later: 12 m ahead
    assert broken(record_of(ego, sudden), road) == ([], ["unsafe_lane_entry"])


@pytest.mark.parametrize(
    ("xy", "mps", "fault", "expected"),
    [
        # 1 m/s across: in the lane (its corner, at 0.4 m, beyond y = -6.1) from 1.5 s on, hit at about 2 s
        ((-117.8, -8.0), 2.0, "other", ([], ["unsafe_lane_entry"])),
        # 0.14 m/s across: in the lane from 2.1 s on, 28 m ahead, where 21 m are needed; hit at about 4.4 s
        ((-94.1, -6.8), 0.28, "target", (["ran_into"], [])),
    ],
)
def test_a_pedestrian_who_walks_towards_the_vehicle_enters_its_lane_too(
    road, xy, mps, fault, expected
) -> None:
    ego = straight("ego", (-150, -4.8), 0, 12, steps=61)
    walker = driven(
        "walker", xy, math.radians(150), np.full(61, mps), size=(0.6, 0.6), agent_class=AgentClass.PEDESTRIAN
    )
    assert broken(record_of(ego, walker), road) == expected
    assert blame(record_of(ego, walker), road)[1] == fault


@pytest.mark.parametrize("name", ["C", "north_c"])
def test_running_into_a_pedestrian_on_a_crossing_and_beyond_it(tmp_path, name) -> None:
    """The name of a junction may contain "_c", as those of crossings do."""
    nodes, edges = (
        NODES.format(kind="priority").replace('"C"', f'"{name}"'),
        EDGES.replace('"C"', f'"{name}"'),
    )
    more = ["--sidewalks.guess", "true", "--crossings.guess", "true"]
    foot = build(tmp_path, nodes, edges, "foot", more=more)
    ego = straight("ego", (1.6, -20), NORTH, 8, steps=51)
    walker = {"size": (0.6, 0.6), "agent_class": AgentClass.PEDESTRIAN}
    on = driven("on", (6.4, 8.4), math.pi, np.full(51, 1.3), **walker)  # the crossing lies at y = 8.4
    beyond = driven("beyond", (2.4, 12), NORTH, np.full(51, 0.3), **walker)  # 3.3 m past it, by the kerb
    route = ("SC", "CN")
    assert "right_of_way" in broken(record_of(ego, on, route=route), foot)[0]
    assert broken(record_of(ego, beyond, route=route), foot) == (["ran_into"], [])


CYCLE_LANES = """<edges>
  <edge id="WE" from="W" to="E" numLanes="2"><lane index="0" allow="bicycle" width="1.5"/>
    <lane index="1" disallow="bicycle pedestrian"/></edge>
  <edge id="EW" from="E" to="W" numLanes="1"><lane index="0" allow="bicycle" width="1.5"/></edge>
</edges>"""


def test_a_cyclist_on_its_own_lane_is_not_out_of_one(tmp_path) -> None:
    """The bicycle lane counts, not the parallel lane for cars.

    From north to south: bicycles westward around y = 0.75, cars around -1.6, bicycles eastward around -3.95.
    """
    nodes = '<nodes><node id="W" x="0" y="0"/><node id="E" x="400" y="0"/></nodes>'
    street = build(tmp_path, nodes, CYCLE_LANES, "cycles")
    bike = {"size": (1.8, 0.6), "agent_class": AgentClass.BICYCLE}

    def met(ego: Car, rider: Car) -> tuple[tuple[str, str], tuple[list[str], list[str]]]:
        record = record_of(ego, rider, route=("WE",))
        return blame(record, street), broken(record, street)

    along = driven("along", (56, -3.95), 0, np.full(61, 5.0), **bike)
    drifts = straight("ego", (50, -1.6), 0, 8, steps=61, drift=-0.6)
    assert met(drifts, along) == (("side", "target"), (["sideways"], []))
    against = driven("against", (96, 0.75), math.pi, np.full(61, 5.0), **bike)
    drifts = straight("ego", (50, -1.6), 0, 8, steps=61, drift=0.4)
    assert met(drifts, against) == (("head_on", "target"), (["wrong_side"], []))
    swerves = driven(
        "swerves", (66, -3.95), 0, np.full(61, 5.0), left=np.minimum(2.0, 0.1 * np.arange(61)), **bike
    )
    assert met(straight("ego", (50, -1.6), 0, 10, steps=61), swerves) == (
        ("cut_in", "other"),
        ([], ["unsafe_lane_entry"]),
    )
