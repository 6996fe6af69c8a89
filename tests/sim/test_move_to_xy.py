"""Undocumented behaviour of moveToXY, and how the package handles it (docs/sumo.md)."""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from advdiff_sumo.core.errors import PlanRefusedError
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.plan import Trajectory
from advdiff_sumo.core.record import Controller
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.actuate import Actuator
from advdiff_sumo.sim.plan_validation import check_plan
from advdiff_sumo.sim.sumo_perception import visible_ids
from advdiff_sumo.sim.world import World, read, register
from tests.hang_guard import HANG_S
from tests.sim.actuated import EASTBOUND, NOBODY, actuator_on, move
from tests.sim.nets import EAST, EXACTLY, LENGTH_M, NORTH, TYPES, WEST, WIDTH_M, Stage, stage

NETWORKS = Path(__file__).parents[2] / "networks"


# --- poses ---------------------------------------------------------------------------------------------------


def test_centre_and_heading_come_back_at_every_angle(street: Path) -> None:
    with stage(street) as s:
        s.add("b", EASTBOUND)
        for y in (-4.8, -1.6, 0.0, 20.0):  # on lanes, on the edge of one, off the road
            for yaw in np.linspace(-np.pi, np.pi, 25):
                s.hold("b", 150.0, y, float(yaw))
                s.step()
                xy, seen = s.pose("b")
                np.testing.assert_allclose(xy, (150.0, y), atol=1e-6)
                assert abs(wrap_angle(seen - yaw)) < 1e-6


def test_the_position_is_that_of_the_front_bumper(street: Path) -> None:
    with stage(street) as s:
        s.add("b", EASTBOUND)
        s.hold("b", 150.0, -4.8, NORTH)
        s.step()
        assert s.api.vehicle.getPosition("b") == pytest.approx((150.0, -4.8 + 0.5 * LENGTH_M))
        assert s.api.vehicle.getAngle("b") == pytest.approx(0.0, abs=1e-9)


# --- routes --------------------------------------------------------------------------------------------------


def test_a_move_anywhere_rewrites_the_route(street: Path) -> None:
    with stage(street) as s:
        s.add("b", EASTBOUND)
        s.hold("b", 150.0, 1.6, WEST)
        s.step()
        assert s.api.vehicle.getRoute("b") == ("MW",)


def test_a_move_within_the_own_route_leaves_it(street: Path) -> None:
    with stage(street) as s:
        s.add("b", EASTBOUND)
        s.free("b")
        s.put("b", np.array((150.0, -2.0)), EAST, keep_route=3)
        s.session.step()
        assert s.api.vehicle.getRoute("b") == EASTBOUND
        assert s.pose("b")[0] == pytest.approx((150.0, -2.0))


def test_a_move_before_departure_pins_the_route_unless_it_is_onto_it(street: Path) -> None:
    """With keepRoute 0 SUMO resets the first route in every later step, without a message."""
    for keep_route, kept in ((0, EASTBOUND[:1]), (1, EASTBOUND)):
        with stage(street) as s:
            s.api.route.add("short", EASTBOUND[:1])
            s.api.vehicle.add("b", "short", depart="now", departPos="base")
            s.api.vehicle.moveToXY("b", "", -1, 150.0, -4.8, angle=90.0, keepRoute=keep_route)
            s.session.step()
            s.api.vehicle.setRoute("b", EASTBOUND)
            s.session.step()
            assert s.api.vehicle.getRoute("b") == kept


def test_a_vehicle_that_is_inserted_and_handed_back_drives_its_route(street: Path) -> None:
    with stage(street) as s:
        s.session.step()
        actuator = actuator_on(s, street)
        row = actuator.world.add("b", 0, LENGTH_M, WIDTH_M)
        actuator.world.set_state(
            np.array([row]), np.array([[150.0, -4.8]]), np.array([EAST]), np.array([5.0]), Controller.POLICY
        )
        actuator.insert(row, "car")
        move(actuator, s, row, (150.0, -4.8), EAST, 5.0, take_out=False)
        actuator.release(row, EASTBOUND)
        for _ in range(3):
            s.session.step()
        assert s.api.vehicle.getRoute("b") == EASTBOUND


def from_the_south(s: Stage, actuator: Actuator | None, route: tuple[str, ...]) -> tuple[float, bool]:
    """Move a vehicle at 10 m/s along the priority road of a crossing, which an IDM car approaches from the south.

    Returns the lowest speed of that car before the crossing, and whether ``visible_ids`` named the moved vehicle.
    """
    s.add("b", ("WC",), at=20)
    s.add("t", ("SC", "CN"), at=105, speed=9)
    if actuator is None:
        s.free("b")
        s.api.vehicle.setSpeedFactor("b", 20.0)
    else:
        register(actuator.world, s.api, ["b", "t"])
        actuator.take(0)
    slowest, seen = np.inf, False
    for x in np.arange(-70.0, -6.0):
        if actuator is None:
            s.put("b", np.array((x, -1.6)), EAST)
            if route:
                s.api.vehicle.setRoute("b", route)
            s.session.step()
        else:
            actuator.predict_route(0, route)
            move(actuator, s, 0, (float(x), -1.6), EAST, 10.0)
        slowest = min(slowest, s.api.vehicle.getSpeed("t"))
        seen |= "b" in visible_ids(s.api, "t")
    return slowest, seen


def test_drivers_at_a_junction_yield_only_to_a_predicted_route(crossing: Path) -> None:
    """Issue 6140 of SUMO."""
    with stage(crossing) as s:
        alone, _ = from_the_south(s, None, ())
        assert s.pose("t")[0][1] > -5.0, "it drove across in front of the other"
    with stage(crossing) as s:
        yields, _ = from_the_south(s, None, ("WC", "CE"))
        assert s.pose("t")[0][1] < -8.0, "it waits"
        assert yields < 0.5 * alone


def test_the_actuators_predicted_route_makes_them_yield_and_visible_ids_says_why(crossing: Path) -> None:
    with stage(crossing) as s:
        yields, seen = from_the_south(s, Actuator(s.api, World(), RoadMap.read(crossing)), ("WC", "CE"))
        assert s.pose("t")[0][1] < -8.0
    assert yields < 2.0
    assert seen


@pytest.mark.parametrize("minor", [("SC", "CN"), ("SC", "CW"), ("NC", "CS"), ("SC", "CE")])
def test_sumo_names_some_foes_on_one_side_only_but_we_name_both(
    crossing: Path, minor: tuple[str, str]
) -> None:
    with stage(crossing) as s:
        s.add("b", ("WC", "CE"), at=95, speed=9)
        s.add("t", minor, at=95, speed=9)
        for _ in range(10):
            s.step()
        listed = {foe[0] for foe in s.api.vehicle.getJunctionFoes("t", 100.0)}
        assert listed == (set() if minor in {("SC", "CN"), ("SC", "CW")} else {"b"})
        assert visible_ids(s.api, "t") == {"b"}
        assert visible_ids(s.api, "b") == {"t"}


def test_a_vehicle_without_a_route_ahead_arrives_and_the_actuator_keeps_it(crossing: Path) -> None:
    with stage(crossing) as s:
        s.add("b", ("WC",), at=100)
        for k in range(20):
            if "b" not in s.api.vehicle.getIDList():
                break
            s.hold("b", -20.0 + k, -1.6, EAST)
            s.step()
        gone_at = -20.0 + k
    with stage(crossing) as s:
        s.add("b", ("WC",), at=100)
        actuator = actuator_on(s, crossing)
        actuator.take(0)
        for k in range(40):
            x = -20.0 + k
            actuator.predict_route(0, ("WC", "CE") if x < -8.0 else ("CE",))
            move(actuator, s, 0, (x, -1.6), EAST, 10.0)
            assert "b" in s.api.vehicle.getIDList()
    assert gone_at <= 0.0


# --- NaN, positions off the road -------------------------------------------------------------------------------


def test_sumo_accepts_a_place_that_is_no_number_but_our_guard_does_not(street: Path) -> None:
    with stage(street) as s:
        s.add("b", EASTBOUND)
        s.free("b")
        s.api.vehicle.moveToXY("b", "", -1, float("nan"), 0.0, angle=90.0, keepRoute=EXACTLY)
        s.session.step()  # no complaint
        assert not np.isfinite(s.api.vehicle.getPosition("b")).all()
    plan = Trajectory(np.full((5, 2), np.nan), np.zeros(5), np.zeros(5), 0.1)
    with pytest.raises(PlanRefusedError, match="not numbers"):
        check_plan(plan, np.zeros(2), 0.5, "it")


def test_off_the_road_there_is_no_lane_and_a_vehicle_that_is_not_moved_again_is_lost(street: Path) -> None:
    with stage(street) as s:
        s.add("b", EASTBOUND)
        world = World()
        register(world, s.api, ["b"])
        s.hold("b", 150.0, -20.0)
        s.step()
        assert s.api.vehicle.getLaneID("b") == ""
        assert not read(world, s.api, NOBODY).size
        s.held.clear()
        s.step()
        assert s.api.vehicle.getIDList() == ()
        assert s.api.simulation.getArrivedIDList() == (), "without a word"
        assert read(world, s.api, NOBODY).tolist() == [0], "but we say so"


def test_off_the_road_neither_subscriptions_of_others_nor_a_saved_state_hold_it(
    street: Path, tmp_path: Path
) -> None:
    with stage(street) as s:
        s.add("b", EASTBOUND)
        s.add("t", EASTBOUND, at=150)
        s.hold("b", 150.0, -12.0)
        s.api.vehicle.subscribeContext("t", 0xA4, 50.0, [0x42])
        s.step()
        assert "b" not in s.api.vehicle.getContextSubscriptionResults("t")
        s.hold("b", 150.0, -1.6)
        s.step()
        assert "b" in s.api.vehicle.getContextSubscriptionResults("t")
        s.hold("b", 150.0, -12.0)
        s.step()
        s.api.simulation.saveState(str(tmp_path / "state.xml"))
    with stage(street, otherwise={"--load-state": tmp_path / "state.xml"}) as s:
        on_lanes = [n for n in s.api.vehicle.getIDList() if s.api.vehicle.getLaneID(n)]
        assert on_lanes == ["t"]


DEATH = """
import sys, libsumo
libsumo.start(["sumo", "-n", sys.argv[1], "-a", sys.argv[2], "--step-length", "0.1", "--no-step-log"])
libsumo.route.add("r", ["WM", "ME"])
libsumo.vehicle.add("b", "r", typeID="car")
libsumo.vehicle.moveToXY("b", "", -1, 150.0, -40.0, angle=90.0, keepRoute=2)
libsumo.simulationStep()
print("alive", libsumo.vehicle.getIDList(), flush=True)
libsumo.vehicle.getRoadID("b")
print("survived", flush=True)
"""


def test_a_vehicle_that_never_was_on_a_lane_kills_the_process(street: Path) -> None:
    words = [sys.executable, "-c", textwrap.dedent(DEATH), str(street), str(street.parent / TYPES)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=HANG_S, check=False)
    assert "alive ('b',)" in done.stdout
    assert "survived" not in done.stdout
    assert done.returncode == -signal.SIGSEGV


BESIDE_ITS_LANE = """
import sys
import libsumo
libsumo.start(["sumo", "-n", sys.argv[1], "--step-length", "0.1", "--no-step-log", "--lateral-resolution", "0.4"])
libsumo.route.add("r", ["H3f-H3.1"])
for name in ("ahead", "beside"):
    libsumo.vehicle.add(name, "r")
libsumo.vehicle.moveToXY("beside", "", -1, 854.819, 208.395, 105.67, 3)
libsumo.simulationStep()
print("beside by", round(libsumo.vehicle.getLateralLanePosition("beside"), 1), flush=True)
if sys.argv[2] == "out":
    libsumo.vehicle.remove("beside")
else:
    libsumo.vehicle.moveToXY("beside", "", -1, 855.933, 208.049, 107.25, 3)
libsumo.simulationStep()
libsumo.simulationStep()
print("survived", flush=True)
"""


def test_a_vehicle_held_beside_its_lane_kills_the_process_with_sublanes_unless_it_is_taken_out() -> None:
    def run(then: str) -> subprocess.CompletedProcess[str]:
        words = [sys.executable, "-c", BESIDE_ITS_LANE, str(NETWORKS / "downtown.net.xml"), then]
        return subprocess.run(words, capture_output=True, text=True, timeout=HANG_S, check=False)

    dead, alive = run("moved on"), run("out")
    assert "beside by -2.0" in dead.stdout  # of a lane 3.3 m wide
    assert dead.returncode == -signal.SIGSEGV
    assert "survived" in alive.stdout


@pytest.mark.parametrize(("net", "seed"), [("downtown-left", 5), ("downtown-left", 8), ("motorway", 2)])
def test_sumo_survives_moved_vehicles_that_wander_off_their_lanes(net: str, seed: int) -> None:
    words = [sys.executable, "-m", "tests.sim.moved_walk", str(NETWORKS / f"{net}.net.xml"), str(seed)]
    done = subprocess.run(
        words, capture_output=True, text=True, timeout=HANG_S, check=False, cwd=NETWORKS.parent
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(("x", "y", "yaw"), [(150.0, -40.0, EAST), (150.0, -4.0, 0.7), (-30.0, 5.0, WEST)])
def test_the_actuator_inserts_on_a_lane_first_and_removes_vehicles_off_the_lanes(
    street: Path, x: float, y: float, yaw: float
) -> None:
    with stage(street) as s:
        s.session.step()
        actuator = actuator_on(s, street)
        row = actuator.world.add("b", 0, LENGTH_M, WIDTH_M)
        actuator.world.set_state(
            np.array([row]), np.array([[x, y]]), np.array([yaw]), np.array([5.0]), Controller.POLICY
        )
        actuator.insert(row, "car")
        move(actuator, s, row, (x, y), yaw, take_out=False)
        assert actuator.moved[row].inserted
        assert s.api.vehicle.getRoadID("b") in ("WM", "MW")  # would kill the process (see above)
        for _ in range(4):
            move(actuator, s, row, (x, y), yaw)
        assert faults_of_place(actuator, s, row, (x, y), yaw) == []
        assert (row in actuator.moved) == (y == -4.0)
        actuator.remove(row)
        s.session.step()
        actuator.remove_off_lanes()
        assert s.api.vehicle.getIDList() == ()


def test_followers_see_the_true_size_of_an_inserted_vehicle(street: Path) -> None:
    """A lorry of 12 m about x = 150 ends at 144, 44 m ahead of a front at 100; by its type it would end at 151."""
    with stage(street) as s:
        s.add("behind", EASTBOUND, at=100)
        s.session.step()
        actuator = actuator_on(s, street)
        row = actuator.world.add("lorry", 1, 12.0, 2.5)
        actuator.world.set_state(
            np.array([row]), np.array([[150.0, -4.8]]), np.array([EAST]), np.array([0.0]), Controller.POLICY
        )
        actuator.insert(row, "car")
        for _ in range(2):
            move(actuator, s, row, (150.0, -4.8), EAST)
        assert (s.api.vehicle.getLength("lorry"), s.api.vehicle.getWidth("lorry")) == (12.0, 2.5)
        front = s.api.vehicle.getPosition("behind")[0]
        leader, gap = s.api.vehicle.getLeader("behind")
        assert leader == "lorry"
        assert front + gap + s.api.vehicle.getMinGap("behind") == pytest.approx(144.0)


def test_followers_see_a_vehicle_inserted_on_a_junction(crossing: Path) -> None:
    """It stands in the middle of a crossing; a vehicle that approaches from the same side stops."""
    with stage(crossing) as s:
        s.add("behind", ("WC", "CE"), at=60, speed=9)
        s.session.step()
        actuator = actuator_on(s, crossing)
        row = actuator.world.add("b", 0, LENGTH_M, WIDTH_M)
        at = np.array([row]), np.array([[0.0, -1.6]]), np.array([EAST]), np.array([0.0])
        actuator.world.set_state(*at, Controller.POLICY)
        actuator.insert(row, "car")
        move(actuator, s, row, (0.0, -1.6), EAST)
        assert s.api.vehicle.getRoadID("b").startswith(":C")
        assert s.api.vehicle.getRoute("b") == ("WC", "CE")
        for _ in range(150):
            move(actuator, s, row, (0.0, -1.6), EAST)
        assert row in actuator.moved
        front = s.pose("behind")[0][0] + 0.5 * LENGTH_M
        assert -8.0 < front < -0.5 * LENGTH_M


def test_a_vehicle_that_turns_unexpectedly_is_inserted_again_on_its_lane(crossing: Path) -> None:
    """SUMO expects it to go straight on from the west, but it turns to the south."""
    with stage(crossing) as s:
        s.add("b", ("WC", "CE"), at=80)
        s.session.step()
        actuator = actuator_on(s, crossing)
        actuator.take(0)
        actuator.predict_route(0, ("WC", "CE"))
        turn = np.linspace(0.0, 0.5 * np.pi, 24)
        for angle in turn:
            x, y = -6.0 + 5.0 * np.sin(angle), -6.6 + 5.0 * np.cos(angle)
            if 0 in actuator.outside and actuator.on_lanes(np.array([0]), *_now(actuator)):
                actuator.insert(0, "car")
            move(actuator, s, 0, (float(x), float(y)), -float(angle), 3.0)
        assert actuator.world.sumo_ids[0] == "b~1", "it was taken out once"
        assert 0 in actuator.moved
        assert s.api.vehicle.getRoute("b~1") == ("WC", "CS")


def _now(actuator: Actuator) -> tuple[np.ndarray, np.ndarray]:
    return actuator.world.xy_m[[0]], actuator.world.yaw_rad[[0]]


def test_sumo_drives_a_vehicle_for_one_step_before_it_is_removed(street: Path) -> None:
    """Removed directly after a move, a vehicle may remain registered on the lane beside its own."""
    with stage(street) as s:
        actuator = actuator_on(s, street)
        row = actuator.world.add("b", 0, LENGTH_M, WIDTH_M)
        actuator.world.set_state(
            np.array([row]), np.array([[150.0, -4.0]]), np.array([EAST]), np.array([5.0]), Controller.POLICY
        )
        actuator.insert(row, "car")
        for _ in range(3):
            move(actuator, s, row, (150.0, -4.0), EAST, 5.0)
        steps: list[tuple[str, ...]] = []
        step = s.session.step
        s.session.step = lambda: (step(), steps.append(s.api.vehicle.getIDList()))  # type: ignore[method-assign,assignment,return-value] # looks in
        for _ in range(2):
            move(actuator, s, row, (150.0, -40.0), EAST, 5.0)
        assert steps == [("b",), ()]
        assert row in actuator.outside
        assert actuator.world.xy_m[row].tolist() == [150.0, -40.0]


def faults_of_place(actuator: Actuator, s: Stage, row: int, xy: tuple[float, float], yaw: float) -> list[str]:
    """Return what is wrong: SUMO must have *row* exactly there or not at all; the package's own state continues."""
    faults = []
    if row in actuator.moved:
        at, heading = s.pose("b")
    else:
        if row not in actuator.outside:
            faults.append("neither moved nor outside")
        if "b" in s.api.vehicle.getIDList():
            faults.append("outside, and SUMO has it")
        at, heading = actuator.world.xy_m[row], float(actuator.world.yaw_rad[row])
    if not np.allclose(at, xy, rtol=1e-7, atol=1e-6):
        faults.append(f"at {at}, not {xy}")
    if not abs(wrap_angle(heading - yaw)) < 1e-6:
        faults.append(f"heads {heading}, not {yaw}")
    return faults


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    x=st.floats(-50.0, 450.0),
    y=st.floats(-60.0, 60.0),
    yaw=st.floats(-np.pi, np.pi),
    speed=st.floats(0.0, 40.0),
)
def test_any_place_can_be_inserted_at(street: Path, x: float, y: float, yaw: float, speed: float) -> None:
    with stage(street) as s:
        actuator = actuator_on(s, street)
        row = actuator.world.add("b", 0, LENGTH_M, WIDTH_M)
        actuator.world.set_state(
            np.array([row]), np.array([[x, y]]), np.array([yaw]), np.array([speed]), Controller.POLICY
        )
        actuator.insert(row, "car")
        for _ in range(3):
            move(actuator, s, row, (x, y), yaw, speed)
        assert faults_of_place(actuator, s, row, (x, y), yaw) == []
