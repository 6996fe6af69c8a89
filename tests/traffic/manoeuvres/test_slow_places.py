"""Vehicles that are inserted beside the target's lane for slow entries: where, of which class, and where not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Lane
from advdiff_sumo.traffic.manoeuvres import commitments
from advdiff_sumo.traffic.manoeuvres.agenda import Agenda, is_possible
from advdiff_sumo.traffic.manoeuvres.commitments import ANY_KINDS, Commitments
from advdiff_sumo.traffic.manoeuvres.intensity import Intensity
from advdiff_sumo.traffic.manoeuvres.repertoire import KINDS, SLOW_ENTRIES
from advdiff_sumo.traffic.manoeuvres.schedule import insert_vehicles, update_manoeuvres
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.slow_places import can_insert_slow_vehicle, insert_slow_vehicle
from advdiff_sumo.traffic.manoeuvres.staging import Newcomer, StagingMemory
from advdiff_sumo.traffic.manoeuvres.standing_traffic import StandingTraffic
from tests.traffic.manoeuvres.scenes import long_lane, scene_on, view_of

STAGE = StagingMemory(most=6, classes=(AgentClass.TRUCK,))


def inserted(view: SituationView, kind: str, stage: StagingMemory = STAGE) -> tuple[Newcomer, ...]:
    return insert_slow_vehicle(view, stage, StandingTraffic(), kind)[0].members


def place(road: RoadMap, vehicle: Newcomer) -> tuple[str, float]:
    """Return the lane of *vehicle*, and how far it is ahead of a target 50 m along the long lane."""
    return vehicle.way.present_lane.id, float(long_lane(road).line.project(vehicle.xy_m)[0]) - 50.0


def test_a_vehicle_crawls_where_it_may_soon_enter(motorway: RoadMap) -> None:
    """The target reaches 10.7 m/s in 3.5 s, of which a quarter is 2.7 m/s.

    The lawful gap is 1.1 (0.75 · 11.2 + (11.2² - 2.7²) / 12) + 1 m, 21 m. With a second at 8.0 m/s before the entry,
    3.5 s until it begins, and half the lengths of a lorry and of the target it is 64 m.
    """
    view = view_of(motorway, target=(0, 50.0, 9.0))
    (vehicle,) = inserted(view, "slow-merge")
    lane, ahead = place(motorway, vehicle)
    assert lane == long_lane(motorway).left_id
    assert vehicle.speed_mps == pytest.approx(0.25 * 10.75, abs=0.05)
    assert ahead == pytest.approx(64.0, abs=1.0)
    assert vehicle.agent_class is AgentClass.TRUCK
    assert vehicle.route == view.scene.routes[0]


def test_with_a_prescribed_gap_the_vehicle_is_so_much_farther_ahead(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, 9.0))
    ahead = []
    for spare_gap_m in (None, 6.0):
        (vehicle,) = inserted(
            view, "slow-merge", replace(STAGE, intensity=Intensity(spare_gap_m=spare_gap_m))
        )
        ahead.append(place(motorway, vehicle)[1])
    assert ahead[1] - ahead[0] == pytest.approx(6.0, abs=0.01)


def test_ahead_of_a_fast_target_the_vehicle_is_faster(motorway: RoadMap) -> None:
    shares = []
    for speed in (9.0, 14.0, 18.0):
        (vehicle,) = inserted(view_of(motorway, target=(0, 50.0, speed)), "slow-merge")
        shares.append(vehicle.speed_mps / (speed + 1.75))
    assert shares == pytest.approx([0.25, 0.25, 0.55])
    assert not inserted(view_of(motorway, target=(0, 50.0, 30.0)), "slow-merge")


def test_a_bus_stands_at_the_kerb_first(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(1, 50.0, 9.0))
    standing, stage = insert_slow_vehicle(view, STAGE, StandingTraffic(), "pull-out")
    (bus,) = standing.members
    assert (bus.agent_class, bus.speed_mps, bus.name) == (AgentClass.BUS, 0.0, "staged-0")
    assert bus.size_of(bus.agent_class) == (12.0, 2.5)
    lane, ahead = place(motorway, bus)
    assert lane == long_lane(motorway).id
    assert 36.0 < ahead < 110.0
    assert stage.count == 1
    (second,) = inserted(view, "pull-out", stage)
    assert second.agent_class is AgentClass.TRUCK
    # the target drives at the kerb itself
    assert not inserted(view_of(motorway, target=(0, 50.0, 9.0)), "pull-out")


def kerb_lanes(road: RoadMap) -> tuple[Lane, Lane]:
    """Return the outermost lane of the longest edge with two lanes, and the one beside it."""
    edges = [edge for edge in road.edges.values() if len(edge.lane_ids) > 1 and not edge.is_internal]
    lanes = [road.lanes[name] for name in max(edges, key=lambda edge: edge.length_m).lane_ids]
    return lanes[0], lanes[1]


@pytest.mark.parametrize("net", ["downtown", "downtown-left"])
def test_the_kerb_is_on_the_side_of_the_traffic(net: str, networks: object) -> None:
    """A bus stands 40 m ahead of a target at 8 m/s. Seen from the outermost lane it is on the wrong side."""
    road = RoadMap.read(f"{networks}/{net}.net.xml")
    outer, inner = kerb_lanes(road)
    assert (outer.right_id if net == "downtown" else outer.left_id) is None
    for own, other, begins in ((inner, outer, True), (outer, inner, False)):
        scene = scene_on({"target": (own, 10.0, 8.0), "bus": (other, 50.0, 0.0)}, time_s=3.0)
        kept = Commitments({"pull-out": 1.0}, since_s={"bus": 0.0})
        driven, _ = update_manoeuvres(SituationView.of(road, scene), kept, 2, 8.0)
        assert [(m.kind, m.row) for m in driven] == [("pull-out", 1)] * begins


@pytest.mark.parametrize(
    ("cars", "stage"),
    [
        ({"leader": (0, 80.0, 9.0)}, STAGE),
        ({"behind": (1, 80.0, 9.0)}, STAGE),
        ({}, replace(STAGE, most=0)),
        ({}, replace(STAGE, count=6)),
    ],
)
def test_no_vehicle_is_inserted(
    cars: dict[str, tuple[int, float, float]], stage: StagingMemory, motorway: RoadMap
) -> None:
    """The target has a leader; a vehicle behind would have to brake; none may be inserted; all have been."""
    view = view_of(motorway, target=(0, 50.0, 9.0), **cars)
    assert not inserted(view, "slow-merge", stage)
    slow = view_of(motorway, target=(0, 50.0, 5.0))
    assert not can_insert_slow_vehicle(slow, "slow-merge")


def test_a_vehicle_that_pulls_out_no_longer_counts_as_standing(motorway: RoadMap) -> None:
    """A bus that stood 46 m ahead of a target at 10 m/s sets off. From then on its manoeuvre drives it."""
    stands = {"target": (1, 50.0, 10.0), "staged-0": (0, 50.0 + 46.0, 0.0)}
    right = long_lane(motorway)
    lanes = [motorway.lanes[name] for name in motorway.edges[right.edge_id].lane_ids]
    scene = scene_on({name: (lanes[k], s, v) for name, (k, s, v) in stands.items()}, time_s=4.0)
    view = SituationView.of(motorway, scene)
    (bus,) = inserted(view_of(motorway, target=(1, 50.0, 10.0)), "pull-out")
    kept = Commitments({"pull-out": 1.0}, since_s={"staged-0": 0.0}, stage=STAGE)
    kept = replace(kept, standing=StandingTraffic("pull-out", (bus,), 0.0, 15.0))
    driven, after = update_manoeuvres(view, kept, 2, 8.0)
    assert [m.kind for m in driven] == ["pull-out"]
    assert after.standing.members == ()
    assert after.attacking == ("staged-0",)
    assert insert_vehicles(view, after)[1].standing.members == ()


def test_any_has_no_slow_entries_by_default(motorway: RoadMap) -> None:
    assert tuple(KINDS) == ANY_KINDS
    drawn = [Agenda.draw(np.random.default_rng(k)).order for k in range(40)]
    assert not set(SLOW_ENTRIES) & {kind for order in drawn for kind in order}
    asked = [Agenda.draw(np.random.default_rng(k), SLOW_ENTRIES).order for k in range(40)]
    assert [tuple(kind for kind in order if kind not in SLOW_ENTRIES) for order in asked] == drawn
    assert {kind for order in asked for kind in order} >= set(SLOW_ENTRIES)
    free, led = (
        view_of(motorway, target=(1, 50.0, 9.0)),
        view_of(motorway, target=(1, 50.0, 9.0), leader=(1, 90.0, 9.0)),
    )
    for kind in SLOW_ENTRIES:
        assert is_possible(free, kind)
        assert not is_possible(led, kind)


def test_slow_entries_can_be_added_to_any(motorway: RoadMap, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some episodes begin with their turns, in which vehicles are inserted for them."""
    free = view_of(motorway, target=(1, 50.0, 9.0))
    before = [Commitments.start("any", np.random.default_rng(k), 6) for k in range(20)]
    monkeypatch.setattr(commitments, "ANY_KINDS", (*KINDS, *SLOW_ENTRIES))
    after = [Commitments.start("any", np.random.default_rng(k), 6) for k in range(20)]
    assert {kind for kept in before for kind in kept.weights} == set(KINDS)
    assert all(set(kept.weights) == {*KINDS, *SLOW_ENTRIES} for kept in after)
    kinds = {kept.agenda.now: insert_vehicles(free, kept)[1].standing.kind for kept in after}
    assert all(kinds[kind] == kind for kind in SLOW_ENTRIES)
