"""Braking along planned paths, worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.core.boxes import corners, overlap
from advdiff_sumo.traffic.planning.braking import GAP_M, Braked, brake, brake_ahead
from advdiff_sumo.traffic.planning.futures import Futures, constant_velocity_futures

T, DT = 12, 0.5
FREE = np.inf


def cars(*states: tuple[float, float, float, float]) -> Futures:
    """Return cars (x, y, yaw, speed) of 4 by 2 m that drive straight on for 6 s."""
    x = np.array(states, dtype=np.float64)
    return constant_velocity_futures(x[:, :2], x[:, 2], x[:, 3], np.tile([4.0, 2.0], (len(x), 1)), T, DT)


def braked(futures: Futures, stop: float = FREE, exempt: tuple[int, int] | None = None) -> Braked:
    count = futures.agents
    may_brake_for = ~np.eye(count, dtype=np.bool_)
    if exempt is not None:
        may_brake_for[exempt] = False
    return brake(futures, np.ones(count, dtype=np.bool_), may_brake_for, np.full(count, stop))


def touching(futures: Futures) -> bool:
    for k in range(T + 1):
        boxes = corners(futures.xy_m[:, k], futures.yaw_rad[:, k], futures.size_m)
        if any(overlap(boxes[i], boxes[j]) for i in range(len(boxes)) for j in range(i)):
            return True
    return False


def test_plans_without_conflict_are_unchanged() -> None:
    plans = cars((0, 0, 0, 10), (0, 4, 0, 10), (30, 0, 0, 10))
    made = braked(plans)
    assert not made.braked.any()
    np.testing.assert_array_equal(made.futures.xy_m, plans.xy_m)


def test_a_follower_brakes_for_a_standing_car_and_keeps_the_clearance() -> None:
    """From 10 m/s with 40 − 4 − 1 = 35 m to go: 1.5 m/s² stops after 33.3 m, 1 m/s² does not within 6 s."""
    made = braked(cars((0, 0, 0, 10), (40, 0, 0, 0)))
    assert made.braked.tolist() == [True, False]
    assert not made.unsolved.any()
    x = made.futures.xy_m[0, :, 0]
    assert x[-1] == pytest.approx(10.0 * 6.0 - 0.5 * 1.5 * 36.0)  # 33 m after 6 s
    assert x[-1] <= 40.0 - 4.0 - GAP_M
    assert x[1] == pytest.approx(10.0 * 0.5 - 0.5 * 1.5 * 0.25)
    assert made.futures.speed_mps[0, 1] == pytest.approx(10.0 - 1.5 * 0.5, abs=0.01)
    assert made.futures.speed_mps[0, -1] == pytest.approx(1.0, abs=0.1)
    np.testing.assert_array_equal(made.futures.xy_m[:, :, 1], 0.0)


def test_no_vehicle_brakes_for_one_approaching_from_behind() -> None:
    made = braked(cars((0, 0, 0, 10), (-25, 0, 0, 20)))
    assert made.braked.tolist() == [False, True]
    assert not touching(made.futures)


def test_the_vehicle_whose_front_would_hit_a_side_brakes() -> None:
    """One drives east through (30, 0) after 3 s. The other drives north and is there after 3.2 s: its front hits."""
    plans = cars((0, 0, 0, 10), (30, -32, np.pi / 2, 10))
    assert touching(plans)
    made = braked(plans)
    assert made.braked.tolist() == [False, True]
    assert not touching(made.futures)


def test_a_car_brakes_that_would_clip_the_corner_of_a_standing_bus() -> None:
    """A car drives south past the front of a bus of 12 m, 0.3 m too near. The centre of the bus is beside it."""
    plans = cars((0, 0, 0, 0), (6.7, 8, -np.pi / 2, 3))
    plans.size_m[0] = 12.0, 2.5
    assert touching(plans)
    made = braked(plans)
    assert made.braked.tolist() == [False, True]
    assert not touching(made.futures)


def test_a_vehicle_brakes_for_one_ahead_that_is_not_adjustable() -> None:
    """As above, but SUMO drives the vehicle from the south. A vehicle still does not brake for such a follower."""
    plans = cars((0, 0, 0, 10), (30, -32, np.pi / 2, 10))
    may_brake_for, ours = ~np.eye(2, dtype=np.bool_), np.array([True, False])
    made = brake(plans, ours, may_brake_for, np.full(2, FREE))
    assert made.braked.tolist() == [True, False]
    assert not touching(made.futures)
    behind = brake(cars((0, 0, 0, 10), (-25, 0, 0, 20)), ours, may_brake_for, np.full(2, FREE))
    assert not behind.braked.any()


def test_vehicles_already_near_each_other_keep_a_share_of_the_clearance() -> None:
    """Side by side with a gap of 0.1 m, less than the full clearance; one approaches the other."""
    plans = cars((0, 0, 0, 2.0), (0, 2.1, 0, 2.0))
    plans.xy_m[1, :, 1] -= np.minimum(
        0.02 * np.arange(T + 1), 0.2
    )  # 2 cm in half a second, touching in the end
    assert touching(plans)
    made = braked(plans)
    assert made.braked.any()
    assert not touching(made.futures)
    apart = np.abs(made.futures.xy_m[0, :, 1] - made.futures.xy_m[1, :, 1]) - 2.0
    beside = np.abs(made.futures.xy_m[0, :, 0] - made.futures.xy_m[1, :, 0]) < 4.0
    assert apart[beside].min() >= 0.0


def test_both_brake_head_on() -> None:
    made = braked(cars((0, 0, 0, 8), (60, 0, np.pi, 8)))
    assert made.braked.tolist() == [True, True]
    assert not touching(made.futures)


def test_one_of_two_vehicles_that_would_wait_for_ever_goes() -> None:
    """Both start from standing with 1 m/s² towards the crossing of their paths, 8 m and 8.5 m ahead."""
    plans = cars((0, 0, 0, 0), (8, -8.5, np.pi / 2, 0))
    time = 0.5 * np.arange(T + 1)
    for row, heading in enumerate(((1.0, 0.0), (0.0, 1.0))):
        plans.xy_m[row] = plans.xy_m[row, 0] + 0.5 * (time**2)[:, None] * np.array(heading)
        plans.speed_mps[row] = time
    assert touching(plans)
    made = braked(plans)
    assert made.braked.sum() == 1
    assert not touching(made.futures)


def setting_off(plans: Futures, row: int, speed_mps: float, accel_mps2: float = 1.0) -> None:
    """Let *row* drive straight on from *speed_mps* and accelerate by *accel_mps2*."""
    time = DT * np.arange(T + 1)
    heading = np.array((np.cos(plans.yaw_rad[row, 0]), np.sin(plans.yaw_rad[row, 0])))
    driven = speed_mps * time + 0.5 * accel_mps2 * time**2
    plans.xy_m[row] = plans.xy_m[row, 0] + driven[:, None] * heading
    plans.speed_mps[row] = speed_mps + accel_mps2 * time


def test_a_creeping_vehicle_goes_before_a_standing_one() -> None:
    """A queue at 0.8 m/s, and a vehicle that stands beside it and would turn into it towards its front."""
    plans = cars((0, 0, 0, 0.8), (9, -3.5, 2.2, 0))
    setting_off(plans, 0, 0.8)
    setting_off(plans, 1, 0.0)
    assert touching(plans)
    made = braked(plans)
    assert made.braked.tolist() == [False, True]
    assert made.futures.travelled_m()[1, -1] == 0.0
    assert not touching(made.futures)


@pytest.mark.parametrize("creeps", [0.0, 0.8])
def test_the_vehicle_whose_path_is_free_goes(creeps: float) -> None:
    """The standing vehicle has a corner 0.7 m in the path of a queue: the queue waits."""
    plans = cars((0, 0, 0, creeps), (12, -2.2, 2.6, 0))
    setting_off(plans, 0, creeps)
    setting_off(plans, 1, 0.0)
    assert touching(plans)
    made = braked(plans)
    assert made.braked.tolist() == [True, False]
    assert not touching(made.futures)


def test_the_vehicle_with_right_of_way_goes_first() -> None:
    """Both creep towards the crossing of their paths: the right of way decides, and not both wait."""
    plans = cars((0, 0, 0, 0.8), (10, -4.5, 2.2, 0.8))
    for row in (0, 1):
        setting_off(plans, row, 0.8)
    for first in (0, 1):
        yields = np.zeros((2, 2), dtype=np.bool_)
        yields[1 - first, first] = True
        made = brake(
            plans, np.ones(2, dtype=np.bool_), ~np.eye(2, dtype=np.bool_), np.full(2, FREE), None, yields
        )
        assert made.braked.tolist() == [first == 1, first == 0]
        assert not touching(made.futures)
    assert braked(plans).braked.all()


def test_a_creeping_vehicle_passes_a_slow_one_with_less_clearance() -> None:
    """0.1 m between their sides instead of 0.15 m; the other vehicle stands."""
    for speed, brakes in ((1.0, False), (6.0, True)):
        plans = cars((0, 0, 0, speed), (12, 2.1, np.pi, 0))
        assert braked(plans).braked.tolist() == [brakes, False]


def test_no_vehicle_sets_off_in_front_of_a_fast_one() -> None:
    """One drives at 6 m/s towards one that stands with a corner in its path and would turn across it."""
    plans = cars((-9, 0, 0, 6.0), (6.0, -2.2, 2.6, 0))
    setting_off(plans, 0, 6.0, 0.0)
    setting_off(plans, 1, 0.0)
    made = braked(plans)
    assert made.braked.tolist() == [True, True]
    assert made.futures.travelled_m()[1, -1] == 0.0
    assert not touching(made.futures)


def test_an_attacker_does_not_brake_for_its_target() -> None:
    plans = cars((40, 0, 0, 0), (0, 0, 0, 10))
    assert braked(plans).braked.tolist() == [False, True]
    made = braked(plans, exempt=(1, 0))
    assert not made.braked.any()


def test_a_queue_of_followers_brakes() -> None:
    made = braked(cars((0, 0, 0, 10), (-10, 0, 0, 10), (-20, 0, 0, 10), (30, 0, 0, 0)))
    assert made.braked[:3].all()
    assert not touching(made.futures)


def test_boxes_that_overlap_now_do_not_brake() -> None:
    plans = cars((0, 0, 0, 5), (3, 0, 0, 8))
    assert not braked(plans).braked.any()


def test_no_vehicle_brakes_for_a_gap_that_is_small_now() -> None:
    """Half a metre between two vehicles of the same speed."""
    assert not braked(cars((0, 0, 0, 5), (4.5, 0, 0, 5))).braked.any()


def test_a_stop_line() -> None:
    """From 10 m/s with 25 m to go: 2 m/s² needs exactly 25 m."""
    made = braked(cars((0, 0, 0, 10)), stop=25.0)
    x = made.futures.xy_m[0, :, 0]
    assert x[-1] == pytest.approx(25.0)
    assert made.futures.speed_mps[0, -1] == 0.0
    assert x[2] == pytest.approx(10.0 - 0.5 * 2.0)


def test_a_collision_that_braking_cannot_avoid_is_unsolved() -> None:
    made = braked(cars((0, 0, 0, 20), (10, 0, 0, 0)))
    assert made.unsolved.tolist() == [True, False]
    assert made.futures.speed_mps[0, -1] < 0.5  # the hardest braking
    assert made.futures.xy_m[0, -1, 0] == pytest.approx(20.0**2 / 17.0, abs=0.1)


def test_only_conflicts_within_the_given_steps_count() -> None:
    """A car at 10 m/s and one that stands 45 m ahead: they collide after 4 s, beyond the next 3 s."""
    time = 0.5 * np.arange(13)
    xy = np.zeros((2, 13, 2))
    xy[0, :, 0], xy[1, :, 0] = 10.0 * time, 45.0
    speed = np.array([[10.0] * 13, [0.0] * 13])
    plans = Futures(xy, np.zeros((2, 13)), speed, np.array([[4.0, 2.0]] * 2), 0.5)
    may_brake_for = ~np.eye(2, dtype=np.bool_)
    free = np.full(2, np.inf)
    adjustable = np.array([True, False])
    assert brake_ahead(plans, adjustable, may_brake_for, free, 12).braked.tolist() == [True, False]
    assert brake_ahead(plans, adjustable, may_brake_for, free, 6).braked.tolist() == [False, False]
    near = brake_ahead(plans, adjustable, may_brake_for, free, 9)
    assert near.braked.tolist() == [True, False]
    driven = near.futures.travelled_m()[0]
    assert near.futures.steps == 12
    assert driven[9] <= 45.0 - 4.0
    np.testing.assert_allclose(np.diff(driven)[9:], 0.5 * near.futures.speed_mps[0, 10:], atol=1e-9)
