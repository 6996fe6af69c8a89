"""Scenes, plans and maps as messages."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from google.protobuf import descriptor_pb2
from hypothesis import given
from hypothesis import strategies as st

import advdiff_sumo.planner_kit
from advdiff_sumo.core.plan import Controls, Plan, Trajectory
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planner_kit import messages
from advdiff_sumo.planner_kit.kit_road import road_of
from advdiff_sumo.planner_kit.wire import plan_message, plan_of, scene_message, scene_of
from advdiff_sumo.planners.planner_check import same_plan
from advdiff_sumo.planners.remote.map_message import map_message
from advdiff_sumo.planners.remote.osi_ground_truth import ground_truth, object_id

KIT = Path(advdiff_sumo.planner_kit.__file__).parent
ARRAYS = ("classes", "size_m", "xy_m", "yaw_rad", "speed_mps", "valid")
numbers = st.floats(allow_nan=True, allow_infinity=True, width=64)


def sent_and_read(plan: Plan) -> Plan:
    """Return *plan* after encoding and decoding."""
    return plan_of(messages.Plan.FromString(plan_message(plan).SerializeToString()))


def test_the_compiled_description_is_that_of_the_proto_file(tmp_path: Path) -> None:
    compiled = tmp_path / "now.binpb"
    command = [sys.executable, "-m", "grpc_tools.protoc", f"-I{KIT}", f"--descriptor_set_out={compiled}"]
    subprocess.run([*command, "planner.proto"], check=True, capture_output=True)
    now = descriptor_pb2.FileDescriptorSet.FromString(compiled.read_bytes())
    shipped = descriptor_pb2.FileDescriptorSet.FromString((KIT / messages.COMPILED).read_bytes())
    assert now == shipped, "planner.proto has changed: make proto"


def test_a_scene_survives_the_wire_exactly(scene: Scene) -> None:
    for target in (0, 1):
        routes = tuple(("a", "b") if k == target else () for k in range(2))
        sent = Scene(scene.history, target, scene.movable, routes, {"c": "GrG"})
        wire = messages.Scene.FromString(scene_message(sent).SerializeToString())
        got = scene_of(wire)
        for name in ARRAYS:
            np.testing.assert_array_equal(getattr(got.history, name), getattr(sent.history, name))
        assert (got.history.ids, got.history.t0_s, got.history.dt_s) == (sent.history.ids, -2.0, 0.5)
        assert (got.target, got.routes, got.signals) == (target, routes, {"c": "GrG"})


@given(st.lists(st.tuples(numbers, numbers), min_size=1, max_size=8), st.floats(0.01, 1.0))
def test_controls_survive_the_wire_exactly(pairs: list[tuple[float, float]], dt_s: float) -> None:
    accel, steer = np.array(pairs).T
    plan = Controls(accel, steer, dt_s)
    assert same_plan(sent_and_read(plan), plan)


@given(st.lists(st.tuples(*[numbers] * 4), min_size=1, max_size=8), st.floats(0.01, 1.0))
def test_trajectories_survive_the_wire_exactly(rows: list[tuple[float, ...]], dt_s: float) -> None:
    x, y, yaw, speed = np.array(rows).T
    plan = Trajectory(np.stack((x, y), axis=-1), yaw, speed, dt_s)
    assert same_plan(sent_and_read(plan), plan)


@pytest.mark.parametrize(
    ("plan", "problem"),
    [
        (messages.Plan(), "without a plan"),
        (messages.Plan(controls=messages.Controls(dt_s=0.1)), "plan of 0 steps"),
        (messages.Plan(controls=messages.Controls(accel_mps2=[1.0], steer_rad=[0.0])), "steps of 0 s"),
        (messages.Plan(controls=messages.Controls(dt_s=math.nan, accel_mps2=[1], steer_rad=[0])), "of nan s"),
        (
            messages.Plan(controls=messages.Controls(dt_s=0.1, accel_mps2=[1.0, 2.0])),
            "accel_mps2 2, steer_rad 0",
        ),
        (
            messages.Plan(trajectory=messages.Trajectory(dt_s=0.1, x_m=[1.0], y_m=[1.0], yaw_rad=[0.0])),
            "x_m 1, y_m 1, yaw_rad 1, speed_mps 0",
        ),
    ],
)
def test_an_answer_without_a_valid_plan(plan: object, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        plan_of(plan)


def test_a_map_has_the_lanes_links_and_rights_of_way_of_the_net(road: RoadMap) -> None:
    message = messages.Map.FromString(map_message(road).SerializeToString())
    got = road_of(message)
    assert got.net_path == str(road.path)
    assert set(got.lanes) == set(road.lanes)
    names = (
        "edge_id",
        "index",
        "width_m",
        "speed_mps",
        "length_m",
        "is_internal",
        "allows",
        "left_id",
        "right_id",
    )
    for key, lane in road.lanes.items():
        np.testing.assert_array_equal(got.lanes[key].centre_xy_m, lane.centre_xy_m)
        assert [getattr(got.lanes[key], name) for name in names] == [getattr(lane, name) for name in names]
        assert [vars(link) for link in got.lanes[key].successors] == [vars(link) for link in lane.successors]
    ways = {
        row.request: (set(row.foes), set(row.yields_to)) for j in message.junctions for row in j.right_of_way
    }
    centre = road.junctions["c"]
    assert ways == {k: (set(foes), set(centre.response[k])) for k, foes in centre.foes.items()}
    assert any(yields for _, yields in ways.values())
    outline = got.drivable_area[0][0]
    np.testing.assert_array_equal(outline[0], outline[-1])


def test_methods_of_the_road_map_are_missing_without_read_road(road: RoadMap) -> None:
    got = road_of(messages.Map.FromString(map_message(road).SerializeToString()))
    with pytest.raises(
        AttributeError, match=r"no 'locate', .* serve with read_road=RoadMap.read or --read-road"
    ):
        getattr(got, "locate")  # noqa: B009 - mypy knows that it is not there
    assert not hasattr(got, "lane_path")


def test_osi_ground_truth_of_two_cars(scene: Scene) -> None:
    truth = ground_truth(scene)
    ids = [object_id(name) for name in scene.history.ids]
    assert len(set(ids)) == 2
    assert (truth.timestamp.seconds, truth.timestamp.nanos, truth.host_vehicle_id.value) == (0, 0, ids[0])
    first, second = truth.moving_object
    assert [first.id.value, second.id.value] == ids
    assert (first.base.position.x, first.base.position.y) == tuple(scene.history.xy_m[0, -1])
    assert (first.base.dimension.length, first.base.dimension.width) == (4.6, 1.8)
    assert (first.base.velocity.x, second.base.velocity.x) == pytest.approx((8.0, -9.0))
    assert first.vehicle_classification.type == first.vehicle_classification.TYPE_MEDIUM_CAR
