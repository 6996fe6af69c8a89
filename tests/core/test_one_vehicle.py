"""One vehicle in plain numbers drives what an array of one drives, to the last digit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.bicycle import Limits
from advdiff_sumo.core.one_vehicle import Pose, track_one
from advdiff_sumo.core.tracking import track

Reference = tuple[FloatArray, FloatArray, FloatArray]


def both(state: Pose, reference: Reference, limits: Limits) -> tuple[Reference, Reference]:
    arrays = np.array(state[:2]), np.asarray(state[2]), np.asarray(state[3])
    return (
        track_one(state, reference, 4.5, 0.1, limits),
        track(arrays, reference, np.asarray(4.5), 0.1, limits),
    )


@settings(max_examples=80, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    speed=st.floats(0.0, 40.0),
    yaw=st.floats(-3.2, 3.2),
    apart_m=st.sampled_from([0.01, 1.0, 20.0]),
    fastest=st.sampled_from([0.0, 0.5, 15.0]),
)
def test_it_follows_as_arrays_do(seed: int, speed: float, yaw: float, apart_m: float, fastest: float) -> None:
    rng = np.random.default_rng(seed)
    along = np.cumsum(rng.uniform(0.0, 2.0, 20))
    xy = np.stack((along, np.zeros(20)), -1) + rng.normal(0.0, apart_m, (20, 2))
    reference = xy, rng.uniform(-4.0, 4.0, 20), rng.uniform(0.0, 1.0, 20) * fastest
    ours, theirs = both((0.3, -0.2, yaw, speed), reference, Limits())
    for one, array in zip(ours, theirs, strict=True):
        assert one.shape == array.shape
        assert one.tobytes() == array.tobytes()


@pytest.mark.parametrize("speed", [0.0, 0.05, 12.0])
def test_who_stands_or_stops_does_so_in_both(speed: float) -> None:
    reference = np.zeros((20, 2)), np.zeros(20), np.zeros(20)
    ours, theirs = both((0.0, 0.0, 0.0, speed), reference, Limits(speed_mps=10.0))
    assert [part.tobytes() for part in ours] == [part.tobytes() for part in theirs]
    assert ours[2][-1] == 0.0 or speed == 12.0
