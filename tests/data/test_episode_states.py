"""What the store writes is what the report reads."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.record import Controller, EndReason, EpisodeRecord
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.data.episode_states import states_of
from advdiff_sumo.sim.run_store import states_table


def _record() -> EpisodeRecord:
    nan = np.nan
    x = np.array([[0.0, 1.0, 2.0], [nan, 50.0, 51.0]])
    valid = np.isfinite(x)
    tracks = Tracks(
        ids=("truck 1", "ego"),
        classes=np.array([AgentClass.TRUCK, AgentClass.CAR], dtype=np.int64),
        size_m=np.array([[12.0, 2.5], [4.5, 1.8]]),
        xy_m=np.stack((x, np.where(valid, 3.0, nan)), axis=-1),
        yaw_rad=np.where(valid, 0.25, nan),
        speed_mps=np.where(valid, 10.0, nan),
        valid=valid,
        t0_s=0.0,
        dt_s=0.1,
    )
    who = np.where(valid, Controller.SUMO, Controller.ABSENT).astype(np.int64)
    return EpisodeRecord(4, 9, "s", tracks, 1, who, (), EndReason.HORIZON)


def test_round_trip() -> None:
    record = _record()
    states = states_of(states_table(record))
    assert states is not None
    assert states.target == 1
    assert states.tracks.ids == record.tracks.ids
    assert states.tracks.dt_s == 0.1
    for name in ("classes", "size_m", "xy_m", "yaw_rad", "speed_mps", "valid"):
        np.testing.assert_array_equal(getattr(states.tracks, name), getattr(record.tracks, name))


def test_no_rows_are_no_states() -> None:
    assert states_of(states_table(_record()).slice(0, 0)) is None
