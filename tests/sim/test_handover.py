"""Vehicles return to SUMO without a jump in position, speed or heading."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st

from advdiff_sumo.core.boxes import corners, overlap
from advdiff_sumo.core.frames import bumper_from_centre, wrap_angle
from advdiff_sumo.core.record import Controller
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.actuate import Actuator
from advdiff_sumo.sim.background_control import MovedMotion
from advdiff_sumo.sim.handover import Handover
from advdiff_sumo.sim.sim_options import SimOptions
from advdiff_sumo.sim.world import World, read, register
from tests.sim import nets
from tests.sim.actuated import EASTBOUND, actuator_on
from tests.sim.nets import BEND_CORNER_RAD, LENGTH_M, Stage, stage

STEP_S, PERIOD = 0.1, 5
_BEFORE = 10  # steps before SUMO takes a follower back
POSITION_M, SPEED_MPS, HEADING_RAD = 0.01, 0.5, 0.06


@dataclass
class Released:
    """States (T, 4) x, y, yaw, speed of one vehicle at each step, and when SUMO took it over."""

    states: np.ndarray
    at: int
    waited_s: float
    misaligned_ids: list[str]

    def check_smooth(self, corner_rad: float = 0.0) -> None:
        """Assert that nothing jumps in the step in which SUMO takes over.

        Where the pieces of the centre line meet, a vehicle beside it turns, and moves by up to 1.5 m × *corner_rad*.

        The position is that of the front bumper, by which SUMO steers; a change of heading swings the centre about it.
        """
        xy, yaw, speed = self.states[:, :2], self.states[:, 2], self.states[:, 3]
        bumper = bumper_from_centre(xy, yaw, np.full(len(yaw), LENGTH_M))
        k = self.at
        moved, top = np.hypot(*(bumper[k] - bumper[k - 1])), max(speed[k], speed[k - 1])
        slack = POSITION_M + 1.5 * corner_rad
        assert moved <= slack + STEP_S * top
        assert moved >= STEP_S * min(speed[k], speed[k - 1]) - slack
        assert abs(speed[k] - speed[k - 1]) <= SPEED_MPS
        assert abs(wrap_angle(yaw[k] - yaw[k - 1])) <= HEADING_RAD + corner_rad


def hand_over(
    s: Stage,
    road: RoadMap,
    route: tuple[str, ...],
    lane_id: str,
    s_m: float,
    d_m: float,
    turn: float,
    speed: float,
) -> Released:
    """Move a vehicle along a lane for 1 s, *d_m* to its left and turned by *turn*, then stop planning for it."""
    s.add("b", route, at=20.0)
    world = World()
    register(world, s.api, ["b"])
    read(world, s.api, np.zeros(0, dtype=np.int64))
    actuator = Actuator(s.api, world, road)
    handover = Handover(world, actuator, road, SimOptions())
    actuator.take(0)
    rows, out = np.array([0]), []
    routes = {"b": route}

    def step() -> None:
        s.session.step()
        actuator.take_inserted(register(world, s.api, s.api.simulation.getDepartedIDList()))
        read(world, s.api, actuator.controlled_rows)
        actuator.remove_off_lanes()
        assert np.isfinite(world.xy_m[0]).all()
        out.append((*world.xy_m[0], world.yaw_rad[0], world.speed_mps[0]))

    def come_back() -> None:
        """Insert it into SUMO again once it is back on a lane, as the loop does."""
        if actuator.outside and actuator.on_lanes(rows, world.xy_m[rows], world.yaw_rad[rows]):
            actuator.insert(0, "car")

    for k in range(10):
        point, along = road.to_world(lane_id, s_m - (9 - k) * STEP_S * speed, d_m)
        yaw = wrap_angle(along + turn)
        world.set_state(rows, point[None], np.atleast_1d(yaw), np.array([speed]), Controller.POLICY)
        if k in (0, 5):
            handover.predict({0: (point, float(yaw))}, routes)
        heading = np.atleast_1d(yaw)
        actuator.move(rows, point[None], heading, actuator.is_on_lane(rows, point[None], heading))
        step()
    begun = len(out)
    for _ in range(40):
        motion = handover.release_or_align(MovedMotion.none(PERIOD), -1, PERIOD, routes)
        if not motion.rows.size:
            break
        come_back()
        for k in range(PERIOD):
            at = motion.xy_m[:, k], motion.yaw_rad[:, k]
            world.set_state(rows, *at, motion.speed_mps[:, k], Controller.POLICY)
            actuator.move(rows, *at, actuator.is_on_lane(rows, *at))
            step()
    taken = len(out)
    assert not actuator.controlled_rows
    for _ in range(10):
        step()
    return Released(np.array(out), taken, STEP_S * (taken - begun), handover.misaligned_ids)


@pytest.mark.parametrize("speed", [0.0, 3.0, 12.0])
@pytest.mark.parametrize("d_m", [0.0, 0.7, -1.2])
def test_on_a_straight(street: Path, speed: float, d_m: float) -> None:
    with stage(street) as s:
        got = hand_over(s, RoadMap.read(street), ("WM", "ME"), "WM_0", 100.0, d_m, 0.0, speed)
    got.check_smooth()
    assert got.waited_s == 0.0


@pytest.mark.parametrize("d_m", [0.0, 0.7, -1.2])
def test_on_a_straight_with_traffic_on_the_left(tmp_path: Path, d_m: float) -> None:
    net = nets.build(tmp_path, *nets.STREET, lefthand=True)
    with stage(net) as s:
        got = hand_over(s, RoadMap.read(net), ("WM", "ME"), "WM_0", 100.0, d_m, 0.0, 12.0)
    got.check_smooth()
    assert got.waited_s == 0.0


@pytest.mark.parametrize("d_m", [0.0, 0.8, -0.8])
def test_in_a_curve(bend: Path, d_m: float) -> None:
    road = RoadMap.read(bend)
    with stage(bend) as s:
        got = hand_over(s, road, ("AB", "BZ"), "AB_0", 140.0, d_m, 0.0, 10.0)
    got.check_smooth(BEND_CORNER_RAD)
    assert got.waited_s == 0.0


@pytest.mark.parametrize("route", [("WC", "CE"), ("WC", "CN"), ("WC", "CS")])
def test_on_a_junction(crossing: Path, route: tuple[str, str]) -> None:
    road = RoadMap.read(crossing)
    via = next(link.via for link in road.lanes["WC_0"].successors if link.to_lane.startswith(route[1]))
    lane = via[-1]
    with stage(crossing) as s:
        got = hand_over(s, road, route, lane, 0.5 * road.lanes[lane].length_m, 0.0, 0.0, 4.0)
    got.check_smooth()
    turns = route != ("WC", "CE")
    assert (got.waited_s > 0.0) is turns, "in a turn SUMO would swing it off its course: it waits for the end"
    assert got.misaligned_ids == []


def test_a_vehicle_standing_in_a_turn_yields_to_oncoming_traffic_and_leaves(crossing: Path) -> None:
    """It stands before the middle of a left turn, while SUMO drives an oncoming vehicle that has the right of way."""
    road, routes = RoadMap.read(crossing), {"b": ("WC", "CN"), "o": ("EC", "CW")}
    lane = next(link.via[0] for link in road.lanes["WC_0"].successors if link.to_lane == "CN_0")
    point, yaw = road.to_world(lane, 1.0)
    with stage(crossing) as s:
        s.add("b", routes["b"], at=20.0)
        s.add("o", routes["o"], at=100.0, speed=12.0)
        world, rows, still = World(), np.array([0]), np.zeros(1)
        register(world, s.api, ["b", "o"])
        actuator = Actuator(s.api, world, road)
        handover = Handover(world, actuator, road, SimOptions())
        read(world, s.api, np.zeros(0, dtype=np.int64))
        actuator.take(0)
        heading = np.atleast_1d(yaw)
        world.set_state(rows, point[None], heading, still, Controller.POLICY)
        handover.predict({0: (point, float(yaw))}, routes)
        boxes, speeds, motion = [], [], MovedMotion.none(PERIOD)
        for k in range(120):
            if actuator.moved and k % PERIOD == 0:
                motion = handover.release_or_align(MovedMotion.none(PERIOD), -1, PERIOD, routes)
            if motion.rows.size:
                at = motion.xy_m[:, k % PERIOD], motion.yaw_rad[:, k % PERIOD]
                world.set_state(rows, *at, motion.speed_mps[:, k % PERIOD], Controller.POLICY)
                actuator.move(rows, *at, actuator.is_on_lane(rows, *at))
            s.session.step()
            read(world, s.api, actuator.controlled_rows)
            actuator.remove_off_lanes()
            boxes.append(corners(world.xy_m[:2], world.yaw_rad[:2], world.size_m[:2]))
            speeds.append(world.speed_mps[:2].copy())
    assert handover.misaligned_ids == []
    assert not actuator.moved
    assert world.lane[0] == "CN_0"
    assert world.lane[1] == "CW_0"
    assert not overlap(*np.array(boxes).swapaxes(0, 1)).any()
    assert np.array(speeds)[:, 1].min() > 5.0, "who has the right of way is not held up"


@pytest.mark.parametrize("turn", [0.3, -0.3, 0.8])
def test_a_misaligned_standing_vehicle_is_aligned_first(street: Path, turn: float) -> None:
    with stage(street) as s:
        got = hand_over(s, RoadMap.read(street), ("WM", "ME"), "WM_0", 100.0, 0.3, turn, 8.0)
    got.check_smooth()
    assert 0.0 < got.waited_s <= 8.0
    assert got.misaligned_ids == []


def test_a_misaligned_standing_vehicle_starts(street: Path) -> None:
    with stage(street) as s:
        got = hand_over(s, RoadMap.read(street), ("WM", "ME"), "WM_0", 100.0, 0.0, 0.4, 0.0)
    got.check_smooth()
    assert 0.0 < got.waited_s <= 8.0
    assert got.misaligned_ids == []


def test_a_vehicle_that_cannot_be_aligned_is_handed_back_and_counted(street: Path) -> None:
    """It stands across its lane, from which no lane leads on."""
    with stage(street) as s:
        got = hand_over(s, RoadMap.read(street), ("WM", "ME"), "WM_0", 100.0, 0.0, 1.3, 0.0)
    assert got.misaligned_ids == ["b"]
    assert got.waited_s == pytest.approx(8.0, abs=0.5)


def test_a_vehicle_far_from_every_lane_stops(street: Path) -> None:
    """30 m beside the street at 9 m/s: at 6 to 7 m/s² it stops after 5.79 to 6.75 m, and not later."""
    road = RoadMap.read(street)
    with stage(street) as s:
        world = World()
        handover = Handover(world, Actuator(s.api, world, road), road, SimOptions())
        row, point = world.add("b", AgentClass.CAR, LENGTH_M, 1.8), road.to_world("WM_0", 100.0, -30.0)[0]
        world.set_state(np.array([row]), point[None], np.zeros(1), np.array([9.0]), Controller.POLICY)
        handover.actuator.outside.add(row)
        for _ in range(8):
            motion = handover.release_or_align(MovedMotion.none(PERIOD), -1, PERIOD, {})
            world.set_state(
                motion.rows,
                motion.xy_m[:, -1],
                motion.yaw_rad[:, -1],
                motion.speed_mps[:, -1],
                Controller.POLICY,
            )
    assert world.speed_mps[row] == 0.0
    assert 81.0 / 14.0 <= np.hypot(*(world.xy_m[row] - point)) <= 81.0 / 12.0


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    s_m=st.floats(60.0, 150.0),
    d_m=st.floats(-1.5, 1.5),
    turn=st.floats(-0.6, 0.6),
    speed=st.floats(1.0, 13.0),
    lane=st.integers(0, 1),
)
def test_any_offset_on_a_straight(
    street: Path, s_m: float, d_m: float, turn: float, speed: float, lane: int
) -> None:
    assume(
        speed * abs(np.sin(turn)) < 4.0
    )  # faster across the lane, it leaves the road and needs all of it to return
    with stage(street) as s:
        got = hand_over(s, RoadMap.read(street), ("WM", "ME"), f"WM_{lane}", s_m, d_m, turn, speed)
    if not got.misaligned_ids:
        got.check_smooth()


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    s_m=st.floats(60.0, 190.0),
    d_m=st.floats(-1.5, 1.5),
    turn=st.floats(-0.4, 0.4),
    speed=st.floats(1.0, 12.0),
)
@example(
    s_m=60.0, d_m=-1.0, turn=-0.375, speed=1.0
)  # a corner is off the road, and a lower speed would not help
def test_any_offset_in_a_curve(bend: Path, s_m: float, d_m: float, turn: float, speed: float) -> None:
    with stage(bend) as s:
        got = hand_over(s, RoadMap.read(bend), ("AB", "BZ"), "AB_0", s_m, d_m, turn, speed)
    if not got.misaligned_ids:
        got.check_smooth(BEND_CORNER_RAD)


@dataclass
class TakenBack:
    """A follower at each step after SUMO took it back: speed, gap to its leader, and headway set in SUMO."""

    speed_mps: np.ndarray
    gap_m: np.ndarray
    min_gap_m: np.ndarray
    tau_s: np.ndarray

    @property
    def braking_mps2(self) -> float:
        return float(-np.diff(self.speed_mps).min() / STEP_S)


def take_back_behind(
    net: Path, speed: float, gap: float, seconds: float, goes: float = np.inf, stands: bool = False
) -> TakenBack:
    """Move two cars one behind the other for 1 s, then let SUMO take back the follower, and continue.

    The leader drives at *speed*, as the follower did; after *goes* seconds at 12 m/s; or it *stands* all the time.
    """
    with stage(net) as s:
        s.add("lead", EASTBOUND, at=60.0)
        s.add("b", EASTBOUND, at=40.0)
        actuator, road = actuator_on(s, net), RoadMap.read(net)
        world, vehicle = actuator.world, s.api.vehicle
        handover = Handover(world, actuator, road, SimOptions())
        rows = np.array([world.index["b"], world.index["lead"]])
        for row in rows.tolist():
            actuator.take(row)
        routes, out = {"b": EASTBOUND, "lead": EASTBOUND}, []
        place = np.array([60.0, 60.0 + LENGTH_M + gap])
        for k in range(round(seconds / STEP_S) + _BEFORE):
            leads = 0.0 if stands else speed if k < _BEFORE + goes / STEP_S else 12.0
            place += STEP_S * np.array([speed, leads])
            taken = k >= _BEFORE
            poses = [road.to_world("WM_0", s_m) for s_m in place[int(taken) :]]
            held, speeds = rows[int(taken) :], np.full(len(poses), speed)
            xy, yaw = np.array([point for point, _ in poses]), np.array([along for _, along in poses])
            if taken and k % PERIOD == 0:
                there = np.ones((1, 1), dtype=np.bool_)
                handover.release_or_align(
                    MovedMotion(xy[:, None], yaw[:, None], speeds[:, None], held, there), -1, PERIOD, routes
                )
            world.set_state(held, xy, yaw, speeds, Controller.POLICY)
            actuator.move(held, xy, yaw, actuator.is_on_lane(held, xy, yaw))
            s.session.step()
            read(world, s.api, actuator.controlled_rows)
            if taken:
                between = world.xy_m[rows[1], 0] - world.xy_m[rows[0], 0] - LENGTH_M
                own = world.speed_mps[rows[0]]
                out.append((own, between, vehicle.getMinGap("b"), vehicle.getTau("b")))
    return TakenBack(*np.array(out).T)


def test_a_close_follower_widens_the_gap_slowly(street: Path) -> None:
    """1.7 m at 3 m/s, while the driver's own headway is 2.5 + 3 m: SUMO alone brakes with 5 m/s² and more at once."""
    got = take_back_behind(street, speed=3.0, gap=1.7, seconds=8.0)
    assert got.braking_mps2 < 1.0
    assert got.gap_m.min() > 1.5
    assert got.gap_m[-1] > 2.4


def test_the_headway_is_the_drivers_own_again_once_the_gap_is(street: Path) -> None:
    """The leader drives away after 2 s."""
    got = take_back_behind(street, speed=3.0, gap=1.7, seconds=8.0, goes=2.0)
    assert got.min_gap_m[0] == pytest.approx(2.5 * 1.7 / 5.5, abs=0.05)
    assert got.tau_s[0] == pytest.approx(1.7 / 5.5, abs=0.02)
    assert (got.min_gap_m[-1], got.tau_s[-1]) == (2.5, 1.0)


def test_a_follower_that_approaches_a_standing_leader_brakes_as_sumo_does(street: Path) -> None:
    """The gap was 5.5 m a second before and is 2.5 m now, at 3 m/s."""
    got = take_back_behind(street, speed=3.0, gap=5.5, seconds=2.0, stands=True)
    assert set(got.min_gap_m) == {2.5}
    assert set(got.tau_s) == {1.0}
    assert got.gap_m.min() > 0.5


def test_a_follower_at_its_own_headway_is_left_unchanged(street: Path) -> None:
    got = take_back_behind(street, speed=3.0, gap=8.0, seconds=2.0)
    assert set(got.min_gap_m) == {2.5}
    assert set(got.tau_s) == {1.0}
