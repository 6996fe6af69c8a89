"""Standing traffic ahead of the target: where a queue ends, how long it stays, and its plans while out of sight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.core.plan import JointPlan
from advdiff_sumo.core.scene import AgentClass, Scene, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.manoeuvres.agenda import Agenda
from advdiff_sumo.traffic.manoeuvres.commitments import Commitments
from advdiff_sumo.traffic.manoeuvres.schedule import insert_vehicles
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.staging import StagingMemory
from advdiff_sumo.traffic.manoeuvres.standing_traffic import (
    StandingTraffic,
    can_insert_queue,
    insert_queue,
    with_standing,
)
from tests.traffic.manoeuvres.scenes import long_lane, scene_on, view_of

STAGE = StagingMemory(most=6, classes=(AgentClass.TRUCK, AgentClass.CAR))


def queue_before(road: RoadMap, speed_mps: float, stage: StagingMemory = STAGE) -> StandingTraffic:
    return insert_queue(view_of(road, target=(0, 50.0, speed_mps)), stage, StandingTraffic())[0]


def ahead_m(road: RoadMap, queue: StandingTraffic) -> list[float]:
    lane = long_lane(road)
    xy = np.array([member.xy_m for member in queue.members])
    return (lane.line.project(xy)[0] - 50.0).tolist()


@pytest.mark.parametrize(
    ("speed_mps", "metres", "crawls_mps"),
    [
        (12.0, 90.0, 0.0),  # out of sight
        (20.0, 20.0 * 3.75 + 400.0 / 8.0 + 8.0, 0.0),  # 3 s, then 0.75 s and braking with 4 m/s²
        (30.0, 22.0 * 3.75 + 484.0 / 8.0 + 8.0, 8.0),  # the closing speed is 22 m/s at most
    ],
)
def test_a_queue_ends_where_a_careful_driver_stops_before_it(
    speed_mps: float, metres: float, crawls_mps: float, motorway: RoadMap
) -> None:
    queue = queue_before(motorway, speed_mps)
    assert ahead_m(motorway, queue)[0] == pytest.approx(metres, abs=0.5)
    assert {member.speed_mps for member in queue.members} == {crawls_mps}


def test_a_queue_is_on_every_lane_if_enough_vehicles_may_be_inserted(motorway: RoadMap) -> None:
    lanes = len(motorway.edges[long_lane(motorway).edge_id].lane_ids)
    queue, stage = insert_queue(view_of(motorway, target=(0, 50.0, 20.0)), STAGE, StandingTraffic())
    assert stage.count == len(queue.members) == lanes
    assert len({member.way.present_lane.id for member in queue.members}) == lanes
    assert [member.agent_class for member in queue.members[:2]] == [AgentClass.TRUCK, AgentClass.CAR]
    assert queue.names == tuple(f"staged-{k}" for k in range(lanes))
    assert len(queue_before(motorway, 20.0, replace(STAGE, most=1)).members) == 1


@pytest.mark.parametrize(
    ("speed_mps", "cars"),
    [(9.0, {}), (20.0, {"leader": (0, 110.0, 20.0)})],
)
def test_no_queue_ahead_of_a_slow_target_or_one_with_a_leader(
    speed_mps: float, cars: dict[str, tuple[int, float, float]], motorway: RoadMap
) -> None:
    view = view_of(motorway, target=(0, 50.0, speed_mps), **cars)
    assert not can_insert_queue(view)
    assert insert_queue(view, STAGE, StandingTraffic()) == (StandingTraffic(), STAGE)


def test_no_queue_near_lights_or_where_the_target_yields(downtown: RoadMap) -> None:
    """Every street of the town has a junction within 130 m, and a target at 12 m/s needs that distance."""
    lanes = [lane for lane in downtown.lanes.values() if not lane.is_internal and lane.is_drivable]
    for lane in lanes[::40]:
        view = SituationView.of(downtown, scene_on({"target": (lane, 1.0, 12.0)}))
        queue, _ = insert_queue(view, STAGE, StandingTraffic())
        links = [link for line_m, link in view.target.way.links if line_m < 130.0] if view.target else []
        assert not queue.members or not any(link.yields or link.tls_id for link in links)


def later(
    road: RoadMap, queue: StandingTraffic, time_s: float, speed_mps: float, at_m: float
) -> SituationView:
    """Return the target *at_m* at *speed_mps* at *time_s*, and the queue where it is by then."""
    cars = {"target": (long_lane(road), at_m, speed_mps)}
    for member in queue.members:
        lane = member.way.present_lane
        xy, _ = queue.poses(member, np.array([time_s]))
        cars[member.name] = lane, float(lane.line.project(xy[0])[0]), member.speed_mps
    return SituationView.of(road, scene_on(cars, time_s))


def test_a_queue_ends_once_the_target_has_closed_up(motorway: RoadMap) -> None:
    queue = queue_before(motorway, 30.0)
    assert queue.updated(later(motorway, queue, 4.0, 30.0, 170.0)).members == queue.members
    assert queue.updated(later(motorway, queue, 8.0, 9.0, 200.0)).members == queue.members
    assert queue.updated(later(motorway, queue, 8.0, 8.4, 200.0)).members == ()  # it crawls at 8 m/s


def test_a_queue_ends_when_it_is_passed_or_after_its_time(motorway: RoadMap) -> None:
    queue = queue_before(motorway, 20.0)
    assert queue.updated(later(motorway, queue, 4.0, 20.0, 260.0)).members == ()
    assert queue.updated(later(motorway, queue, 19.5, 20.0, 100.0)).members == queue.members
    assert queue.updated(later(motorway, queue, 20.0, 20.0, 100.0)).members == ()


def test_members_that_could_not_be_inserted_are_dropped(motorway: RoadMap) -> None:
    queue = queue_before(motorway, 20.0)
    first = replace(queue, members=queue.members[:1])
    assert queue.updated(later(motorway, first, 1.0, 20.0, 70.0)).members == queue.members[:1]
    others = replace(queue, members=queue.members[1:])
    # no vehicle stands in the target's lane
    assert queue.updated(later(motorway, others, 1.0, 20.0, 70.0)).members == ()


def test_a_crawling_member_with_a_leader_is_left_to_sumo(motorway: RoadMap) -> None:
    queue = queue_before(motorway, 30.0, replace(STAGE, most=1))
    view = later(motorway, queue, 1.0, 30.0, 80.0)
    scene: Scene = view.scene
    place = float(long_lane(motorway).line.project(scene.history.xy_m[1, -1])[0])
    crowded = scene_on(
        {
            "target": (long_lane(motorway), 80.0, 30.0),
            "staged-0": (long_lane(motorway), place, 8.0),
            "leader": (long_lane(motorway), place + 14.0, 5.0),
        },
        1.0,
    )
    assert queue.updated(view).members == queue.members
    assert queue.updated(SituationView.of(motorway, crowded)).members == ()


def test_every_plan_holds_the_queue_where_it_is_by_then(motorway: RoadMap) -> None:
    """Crawling at 8 m/s it drives 8 m in every second since its insertion, seen or not."""
    queue = queue_before(motorway, 30.0)
    nobody = JointPlan(Tracks.empty(steps=1, dt_s=0.5, t0_s=3.5))
    plan = with_standing(nobody, queue, 3.0)
    assert plan.tracks.ids == queue.names
    driven_m = np.linalg.norm(plan.tracks.xy_m[0] - queue.members[0].xy_m, axis=-1)
    assert driven_m == pytest.approx(8.0 * (3.0 + 0.5 * np.arange(1, 13)), abs=0.1)
    assert plan.tracks.times_s[0] == 3.5
    assert plan.routes.keys() == set(queue.names)
    assert with_standing(plan, queue, 3.0) is plan


@pytest.mark.parametrize("is_inserted", [True, False])
def test_a_queue_without_room_gives_up_its_turn_and_its_vehicles(
    is_inserted: bool, motorway: RoadMap
) -> None:
    kept = Commitments({"cut-in": 1.0}, stage=STAGE, agenda=Agenda(("queue", "cut-in")))
    newcomers, kept = insert_vehicles(view_of(motorway, target=(0, 50.0, 20.0)), kept)
    assert newcomers == ()
    count = len(kept.standing.members)
    assert kept.attacking == kept.standing.names
    assert kept.manoeuvres == dict.fromkeys(kept.standing.names, "queue")
    queue = kept.standing if is_inserted else replace(kept.standing, members=())
    _, after = insert_vehicles(later(motorway, queue, 0.5, 20.0, 60.0), kept)
    assert after.standing.members == queue.members
    assert after.agenda.now == ("queue" if is_inserted else "cut-in")
    assert after.stage.most == STAGE.most + (0 if is_inserted else count)
    assert after.standing.next_try_s == (40.0 if is_inserted else 1.5)  # it is tried again a second later


def test_no_other_vehicle_attacks_at_a_queue(motorway: RoadMap) -> None:
    kept = Commitments({"cut-in": 1.0}, stage=STAGE, agenda=Agenda(("queue", "cut-in")))
    view = view_of(motorway, target=(0, 50.0, 20.0))
    _, kept = insert_vehicles(view, kept)
    assert kept.standing.is_queue
    assert kept.startable_kinds(view) == kept.insertable_kinds(view) == ()
