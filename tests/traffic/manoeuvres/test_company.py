"""A leader that stops while other vehicles are nearer to the target: where these drive, and when they mask it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.manoeuvres.choice import rank
from advdiff_sumo.traffic.manoeuvres.commitments import Commitments
from advdiff_sumo.traffic.manoeuvres.company import (
    ACCOMPANIES,
    car_spacing_m,
    company_manoeuvres,
    company_places,
    company_rows,
    insertion_places,
)
from advdiff_sumo.traffic.manoeuvres.hidden_stop import hard_stop_in_company, is_masked
from advdiff_sumo.traffic.manoeuvres.intensity import Intensity
from advdiff_sumo.traffic.manoeuvres.repertoire import DOUBLE
from advdiff_sumo.traffic.manoeuvres.schedule import insert_vehicles, update_manoeuvres
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.staging import StagingMemory, insert_newcomers
from tests.sim.nets import build
from tests.traffic.manoeuvres.scenes import lane_alone, scene_on, view_of

TARGET = {"target": (1, 100.0, 20.0)}
LEADER = {"leader": (1, 136.6, 20.0)}
FRONT, REAR, LEVEL = {"front": (2, 108.0, 20.0)}, {"rear": (2, 87.0, 20.0)}, {"level": (0, 98.0, 20.0)}


def stop(view: SituationView) -> bool:
    """Return whether the leader, row 1, may stop."""
    return any(not manoeuvre.is_positioning for manoeuvre in hard_stop_in_company(view, 1))


def test_the_company_keeps_lawful_gaps(motorway: RoadMap) -> None:
    """At 20 m/s: 1.1 · 0.75 s · 20 m/s, 1 m and a car of 4.6 m are 22.1 m; a share of 0.4 is ahead of the target."""
    assert car_spacing_m(20.0) == pytest.approx(22.1)
    between = company_places(view_of(motorway, **TARGET))
    assert between["left"] == pytest.approx((8.84, -13.26))
    assert between["right"] == pytest.approx((-2.21,))
    rightmost = company_places(view_of(motorway, target=(0, 100.0, 20.0)))
    assert rightmost.keys() == {"left", ""}
    assert rightmost[""] == pytest.approx((-22.1,))


def test_there_is_no_company_without_a_lane_beside(downtown: RoadMap) -> None:
    lane = lane_alone(downtown)
    view = SituationView.of(downtown, scene_on({"target": (lane, 5.0, 10.0), "leader": (lane, 28.0, 10.0)}))
    assert company_places(view) == {}
    assert not list(hard_stop_in_company(view, 1))
    assert insert_newcomers(view, StagingMemory(most=6), (DOUBLE,))[0] == ()


def test_no_company_on_a_lane_that_ends_or_leads_into_the_targets(motorway: RoadMap) -> None:
    """The right one of two lanes is the target's; the left one leads into the same lane, or ends."""
    count = 0
    for lane in motorway.lanes.values():
        beside = motorway.lanes[lane.left_id] if lane.left_id and not lane.is_internal else None
        if beside is None or not beside.is_drivable or not lane.is_drivable or lane.length_m < 60.0:
            continue
        onto, theirs = ({link.to_lane for link in one.successors} for one in (lane, beside))
        if len(onto) == 1 and (not theirs or theirs == onto):
            view = SituationView.of(motorway, scene_on({"target": (lane, lane.length_m - 40.0, 20.0)}))
            assert "left" not in company_places(view)
            count += 1
    assert count


def test_a_leader_in_a_bend_is_not_beside_the_target(tmp_path: Path) -> None:
    """After 38 m of a bend of 150 m radius a leader is 38²/(2 · 150) m = 4.8 m to the left of the target's heading."""
    turns = np.arange(0.0, 1.5, 0.1)
    shape = " ".join(f"{150.0 * np.sin(a):.2f},{150.0 * (1.0 - np.cos(a)):.2f}" for a in turns)
    nodes = '<nodes><node id="a" x="0" y="0"/><node id="b" x="147.8" y="124.5"/></nodes>'
    edges = f'<edges><edge id="ab" from="a" to="b" numLanes="2" speed="22" shape="{shape}"/></edges>'
    road = RoadMap.read(build(tmp_path, nodes, edges, name="bend"))
    cars = {"target": (road.lanes["ab_0"], 40.0, 15.0), "leader": (road.lanes["ab_0"], 78.0, 15.0)}
    view = SituationView.of(road, scene_on(cars | {"beside": (road.lanes["ab_1"], 46.0, 15.0)}))
    assert company_rows(view, "left") == [2]


def test_a_vehicle_on_a_ramp_into_the_targets_lane_is_not_beside_it(tmp_path: Path) -> None:
    """The ramp meets the road at 11°, and is 4 m aside 20 m before. Only the ways ahead show that it joins the road."""
    nodes = "".join(
        f'<node id="{name}" x="{x}" y="{y}"/>'
        for name, x, y in (("a", 0, 0), ("r", 0, -60), ("m", 300, 0), ("e", 600, 0))
    )
    edges = "".join(
        f'<edge id="{edge}" from="{edge[0]}" to="{edge[1]}" speed="22" priority="{rank}"/>'
        for edge, rank in (("am", 3), ("rm", 1), ("me", 3))
    )
    road = RoadMap.read(build(tmp_path, f"<nodes>{nodes}</nodes>", f"<edges>{edges}</edges>", name="ramp"))
    ends_m = {name: road.lanes[name].length_m for name in ("am_0", "rm_0")}
    cars = {
        name: (road.lanes[lane], ends_m[lane] - 10.0, 15.0) for name, lane in zip("tr", ends_m, strict=True)
    }
    view = SituationView.of(road, scene_on(cars))
    assert set(view.ways) == {0, 1}
    assert company_rows(view, "right") == []


@pytest.mark.parametrize(
    ("company", "stops"),
    [
        (FRONT | REAR | LEVEL, True),
        (REAR | LEVEL, False),  # the leader is the nearest ahead
        (FRONT | REAR, True),  # it is one of the nearest three, but no other vehicle comes nearer
        (FRONT | REAR | {"late": (0, 140.0, 15.0)}, False),  # another one comes nearer, and is not there yet
        ({}, False),
    ],
)
def test_the_leader_stops_if_others_are_nearer(
    company: dict[str, tuple[int, float, float]], stops: bool, motorway: RoadMap
) -> None:
    view = view_of(motorway, **TARGET, **LEADER, **company)
    assert stop(view) == stops
    assert any(manoeuvre.is_positioning for manoeuvre in hard_stop_in_company(view, 1))


def test_a_careful_driver_avoids_the_stopping_leader(motorway: RoadMap) -> None:
    """A gap of 32.1 m and 20²/(2 · 6) m less 15.1 m in 0.75 s leave 50 m, which requires 4.2 m/s² from 20.4 m/s."""
    view = view_of(motorway, **TARGET, **LEADER, **FRONT, **REAR, **LEVEL)
    stops = [m for m in hard_stop_in_company(view, 1) if m.profile.then_mps2 == -6.0]
    (chosen,) = rank(view, stops, {DOUBLE: 1.0})
    assert chosen.needed_mps2 == 5.0
    assert is_masked(view, chosen.manoeuvre)


def test_the_leader_brakes_as_prescribed(motorway: RoadMap) -> None:
    """The prescribed 5 m/s² is none of the values that are tried."""
    view = view_of(motorway, **TARGET, **LEADER, **FRONT, **REAR, **LEVEL, time_s=10.0)
    since_s = dict.fromkeys(view.scene.history.ids, 0.0)
    kept = Commitments({DOUBLE: 1.0}, intensity=Intensity(braking_mps2=5.0), since_s=since_s)
    stops = [m for m in update_manoeuvres(view, kept, 1, 8.0)[0] if m.kind == DOUBLE]
    assert [m.profile.then_mps2 for m in stops] == [-5.0]


def test_vehicles_that_fall_too_far_back_do_not_mask_the_leader(motorway: RoadMap) -> None:
    """The company drives at 10 m/s, and is 20 m behind the target when the leader stands."""
    slow = {name: (lane, at, 10.0) for name, (lane, at, _) in (FRONT | REAR | LEVEL).items()}
    assert not stop(view_of(motorway, **TARGET, **LEADER, **slow))


def test_the_company_gets_to_its_places_within_the_limit(motorway: RoadMap) -> None:
    """The front one, at 30 m, and the rear one, level with the target, fall back. The right one closes up."""
    cars = {"front": (2, 130.0, 20.0), "rear": (2, 100.0, 20.0), "level": (0, 85.0, 20.0)}
    view = view_of(motorway, **TARGET, **cars)
    accels = {m.row: m.profile.first_mps2 for m in company_manoeuvres(view, ())}
    assert accels[1] < 0.0
    assert accels[2] < 0.0
    assert accels[3] > 0.0
    assert all(m.profile.highest_mps == m.way.lane.speed_mps for m in company_manoeuvres(view, ()))
    assert {m.row for m in company_manoeuvres(view, {1})} == {2, 3}


def test_a_vehicle_that_would_collide_is_left_to_sumo(motorway: RoadMap) -> None:
    """A vehicle stands 20 m ahead of the front one, on its lane."""
    view = view_of(motorway, **TARGET, **FRONT, stands=(2, 128.0, 0.0))
    assert 1 not in {m.row for m in company_manoeuvres(view, ())}


def test_no_vehicle_accompanies_a_target_that_brakes(motorway: RoadMap) -> None:
    view = view_of(motorway, **TARGET, **FRONT, **REAR)
    assert company_manoeuvres(view, ())
    speed = view.scene.history.speed_mps.copy()
    speed[0, -2] = 21.5
    history = replace(view.scene.history, speed_mps=speed)
    braking = SituationView.of(motorway, replace(view.scene, history=history))
    assert company_manoeuvres(braking, ()) == []


@pytest.mark.parametrize("sideways_mps", [1.0, -1.0])
def test_the_company_leaves_room_for_a_target_that_changes_lanes(
    sideways_mps: float, motorway: RoadMap
) -> None:
    """A vehicle that closes up on the goal lane would take away the lawful gap."""
    view = view_of(motorway, **TARGET, rear=(2, 75.0, 20.0))
    assert [m.profile.first_mps2 > 0.0 for m in company_manoeuvres(view, ())] == [True]
    history = view.scene.history
    yaw, xy = history.yaw_rad[0, -1], history.xy_m.copy()
    left = np.array([-np.sin(yaw), np.cos(yaw)])
    xy[0] += sideways_mps * history.dt_s * np.arange(-4.0, 1.0)[:, None] * left
    changing = SituationView.of(motorway, replace(view.scene, history=replace(history, xy_m=xy)))
    assert company_manoeuvres(changing, ()) == []


def test_the_company_takes_part_in_the_encounter_without_attacking(motorway: RoadMap) -> None:
    view = view_of(motorway, **TARGET, **LEADER, **FRONT, **REAR, **LEVEL)
    driven, kept = update_manoeuvres(view, Commitments({DOUBLE: 1.0}), 1, 8.0)
    assert [m.kind for m in driven] == [DOUBLE, *[ACCOMPANIES] * 3]
    assert kept.active.keys() == {"leader"}
    assert kept.manoeuvres == dict.fromkeys(("front", "rear", "level"), DOUBLE)
    assert kept.attacking == ()
    assert update_manoeuvres(view, Commitments({"hard-stop": 1.0}), 1, 8.0)[1].manoeuvres == {}


def test_company_is_inserted_around_the_target(motorway: RoadMap) -> None:
    """On an empty road these are a leader and three cars, limited by the number that may be inserted."""
    view = view_of(motorway, **TARGET)
    assert dict(insertion_places(view, 19.0)) == {"left": pytest.approx(19.0), "right": pytest.approx(-19.0)}
    (leader, *company), stage = insert_newcomers(
        view, StagingMemory(most=6, classes=(AgentClass.TRUCK,)), (DOUBLE,)
    )
    assert stage.count == 4
    assert leader.agent_class is AgentClass.TRUCK
    assert {newcomer.agent_class for newcomer in company} == {AgentClass.CAR}
    assert view.target is not None
    ahead, left = view.target.way.line.project(np.array([newcomer.xy_m for newcomer in (leader, *company)]))
    assert ahead - 100.0 == pytest.approx([38.0, -19.0, 19.0, -19.0], abs=0.5)
    assert np.sign(np.round(left)).tolist() == [0.0, 1.0, 1.0, -1.0]
    assert len(insert_newcomers(view, StagingMemory(most=2), (DOUBLE,))[0]) == 2
    assert insert_newcomers(view, StagingMemory(most=0), (DOUBLE,))[0] == ()


def test_an_episode_of_double_has_no_other_kind(motorway: RoadMap) -> None:
    kept = Commitments.start("double", np.random.default_rng(3), staged=6)
    view = view_of(motorway, **TARGET)
    newcomers, kept = insert_vehicles(view, kept)
    assert kept.startable_kinds(view) == (DOUBLE,)
    assert len(newcomers) == 4
    assert kept.attacking == ()
    assert DOUBLE not in Commitments.start("any", np.random.default_rng(3), staged=6).weights
