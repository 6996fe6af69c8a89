"""A follower of the target can stop behind it, worked by hand on a straight road."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.metrics.reference.driver_models import FULL_BRAKE_MPS2
from advdiff_sumo.traffic.planning.braking import LADDER_MPS2
from advdiff_sumo.traffic.planning.futures import Futures, constant_velocity_futures
from advdiff_sumo.traffic.planning.keep_back import keep_back

T, DT, LENGTH_M = 12, 0.5, 4.5
FOLLOWER = np.array([False, True])


def street(
    gap_m: float, target_mps: float, own_mps: float, aside_m: float = 0.0, yaw_rad: float = 0.0
) -> Futures:
    """Return the target, and a follower *gap_m* behind it; both keep their speeds."""
    xy = np.array([[200.0, aside_m], [200.0 - LENGTH_M - gap_m, 0.0]])
    yaw, speed = np.array([yaw_rad, 0.0]), np.array([target_mps, own_mps])
    return constant_velocity_futures(xy, yaw, speed, np.tile([LENGTH_M, 1.8], (2, 1)), T, DT)


def slows_by(plans: Futures) -> float:
    """Return the speed that the follower loses within a step, m/s."""
    driven = plans.xy_m[1, 1, 0] - plans.xy_m[1, 0, 0]
    return float(2.0 * (plans.speed_mps[1, 0] - driven / DT))


@pytest.mark.parametrize(
    ("gap_m", "target_mps", "own_mps", "braking"),
    [(22.0, 30.0, 30.0, 0.0), (19.0, 30.0, 30.0, 1.0), (40.0, 16.0, 28.0, 8.5), (60.0, 16.0, 28.0, 0.0)],
)
def test_the_mildest_braking_that_leaves_room_to_stop(
    gap_m: float, target_mps: float, own_mps: float, braking: float
) -> None:
    """At 30 m/s both: 15 m until the next plan and 64.3 m with 7 m/s², less the target's 59.3 m, and a metre: 21 m.

    With a m/s² until then it is 0.125 a + (30² − (30 − a / 2)²) / 14 m less: 2.25 m for 1 m/s², 1.13 m for 0.5.
    At 28 m/s behind 16 m/s it is 14 + 56 − 16.9 + 1 = 54.1 m; 14 m less take 8.5 m/s² at most: 17.1 m.
    """
    plans = street(gap_m, target_mps, own_mps)
    assert bool(keep_back(plans, FOLLOWER, 0, LADDER_MPS2)[1]) is (braking > 0.0)
    most = slows_by(plans) / DT
    assert 0.0 <= most <= braking + 1e-9
    if braking == 8.5:
        assert most > 5.0


@pytest.mark.parametrize(("aside_m", "yaw_rad"), [(3.5, 0.0), (0.0, np.pi), (0.0, 0.5 * np.pi)])
def test_no_gap_is_kept_to_a_target_beside_oncoming_or_crossing(aside_m: float, yaw_rad: float) -> None:
    plans = street(5.0, 20.0, 30.0, aside_m, yaw_rad)
    before = plans.copy()
    assert not keep_back(plans, FOLLOWER, 0, LADDER_MPS2).any()
    np.testing.assert_array_equal(plans.xy_m, before.xy_m)


@pytest.mark.parametrize("braking", [3.0, 6.0, FULL_BRAKE_MPS2])
def test_the_follower_does_not_hit_a_target_that_brakes_to_a_stop(braking: float) -> None:
    """Both from 30 m/s and 22 m apart; replanned each half second, always with a target predicted to keep its speed."""
    gap, target, own = 22.0, 30.0, 30.0
    for _ in range(40):
        plans = street(gap, target, own)
        keep_back(plans, FOLLOWER, 0, LADDER_MPS2)
        driven = float(plans.xy_m[1, 1, 0] - plans.xy_m[1, 0, 0])
        own = max(2.0 * driven / DT - own, 0.0)
        slower = max(target - braking * DT, 0.0)
        gap += 0.5 * DT * (target + slower) - driven
        target = slower
        assert gap > 0.0
    assert target == 0.0
    assert own < 0.2
