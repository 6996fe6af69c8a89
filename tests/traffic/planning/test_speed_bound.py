"""Bounds on speeds by a share of the limit, worked by hand on a street of two lanes."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.maps.lanes import Lane
from advdiff_sumo.traffic.planning.futures import Futures, constant_velocity_futures
from advdiff_sumo.traffic.planning.lane_following import approach_mps
from advdiff_sumo.traffic.planning.lanes_ahead import LaneAhead
from advdiff_sumo.traffic.planning.speed_bound import EASE_MPS2, NO_LANE_MPS, allowed_mps, bound_speeds

T, DT = 12, 0.5
LIMITS = {"first": 10.0, "second": 5.0}


def straight_lane(name: str, length_m: float, limit_mps: float) -> Lane:
    return Lane(
        id=name,
        edge_id=name,
        index=0,
        centre_xy_m=np.array([[0.0, 0.0], [length_m, 0.0]]),
        width_m=3.2,
        speed_mps=limit_mps,
        length_m=length_m,
        sumo_length_m=length_m,
        is_internal=False,
        allows=frozenset({"passenger"}),
        left_id=None,
        right_id=None,
        successors=(),
    )


def street(length_m: float) -> LaneAhead:
    """Return a lane of 100 m with limit 10 m/s, *length_m* of it ahead, then a lane with limit 5 m/s."""
    lanes = tuple(straight_lane(name, 100.0, limit) for name, limit in LIMITS.items())
    return LaneAhead(100.0 - length_m, lanes, 10.0, (), np.inf, 0.0)


def plan(*speeds_mps: float) -> Futures:
    speed = np.array(speeds_mps)
    return constant_velocity_futures(
        np.zeros((len(speed), 2)), np.zeros(len(speed)), speed, np.tile((4.0, 2.0), (1, 1)), T, DT
    )


def bounded(speed_mps: float, lane: LaneAhead | None, share: float = 1.0) -> Futures:
    futures = plan(speed_mps)
    bound_speeds(futures, np.array([0]), [lane], LIMITS, np.array([share]))
    return futures


def test_a_plan_within_the_bound_is_unchanged() -> None:
    made = bounded(11.4, street(100.0), 1.15)
    np.testing.assert_array_equal(made.xy_m, plan(11.4).xy_m)


def test_a_vehicle_that_is_too_fast_slows_down_gently() -> None:
    """From 14 m/s at 2.5 m/s² to 11.5: after 1 s, in which 12.75 m are driven."""
    made = bounded(14.0, street(100.0), 1.15)
    assert made.speed_mps[0, :4].tolist() == pytest.approx([14.0, 12.75, 11.5, 11.5])
    assert made.xy_m[0, 2, 0] == pytest.approx(12.75)
    assert (made.xy_m[0, :, 1] == 0.0).all()


def test_a_lower_limit_is_kept_from_its_beginning_on() -> None:
    """From 10 to 5 m/s at 2.5 m/s² takes 15 m: at 30 m, 15 m are driven as planned."""
    assert allowed_mps(
        np.array([0.0, 30.0]), np.array([10.0, 5.0]), np.array([0.0, 15.0, 22.5, 30.0, 40.0])
    ).tolist() == (pytest.approx([10.0, 10.0, np.sqrt(25.0 + 2.0 * EASE_MPS2 * 7.5), 5.0, 5.0]))
    made = bounded(10.0, street(30.0))
    assert made.speed_mps[0, 3] == pytest.approx(10.0)
    behind = made.xy_m[0, :, 0] > 32.0
    assert behind.any()
    assert made.speed_mps[0, behind] == pytest.approx(5.0, abs=0.3)
    assert (np.diff(made.speed_mps[0]) >= -EASE_MPS2 * DT - 1e-9).all()


@pytest.mark.parametrize(("left_m", "speed"), [(50.0, 10.0), (5.0, np.sqrt(50.0)), (0.0, 5.0), (-5.0, 5.0)])
def test_a_vehicle_that_follows_its_lane_slows_down_in_time(left_m: float, speed: float) -> None:
    """5 m before a lane of 5 m/s, 2.5 m/s² allow √(25 + 2 · 2.5 · 5) m/s; beyond its beginning, its limit."""
    assert approach_mps(street(left_m)) == pytest.approx(speed)


def test_a_vehicle_on_no_lane_does_not_accelerate() -> None:
    assert bounded(4.0, None).speed_mps[0, -1] == 4.0
    assert bounded(9.0, None).speed_mps[0, -1] == pytest.approx(NO_LANE_MPS)
