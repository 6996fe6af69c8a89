"""The rows that one episode adds to the tables, worked by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from advdiff_sumo.core.record import Controller, EndReason, EpisodeRecord, MadePlans
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.sim.episode import Timing
from advdiff_sumo.sim.run_store import TABLES, natural_table, plans_table, states_table, timing_row

TIMING = Timing(wall_s=0.1, target_plans_s=(0.01, 0.03))


def record(number: int) -> EpisodeRecord:
    """The target is present for three instants, a bus for the last two."""
    valid = np.array([[True, True, True], [False, True, True]])
    x = np.array([[0.0, 1.0, 2.0], [np.nan, 8.0, 8.0]])
    tracks = Tracks(
        ids=("ego", "bus7"),
        classes=np.array([AgentClass.CAR, AgentClass.BUS]),
        size_m=np.array([[4.5, 1.8], [12.0, 2.5]]),
        xy_m=np.stack((x, 3.0 + 0.0 * x), axis=-1),
        yaw_rad=0.0 * x,
        speed_mps=10.0 + 0.0 * x,
        valid=valid,
        t0_s=0.0,
        dt_s=0.1,
    )
    moved = np.where(valid, [[Controller.PLANNER], [Controller.POLICY]], Controller.ABSENT)
    return EpisodeRecord(number, 5, f"scene{number}", tracks, 0, moved, ("e",), EndReason.HORIZON)


def test_states_by_hand() -> None:
    table = states_table(record(4)).to_pydict()
    assert table["agent"] == ["ego", "ego", "ego", "bus7", "bus7"]
    assert table["step"] == [0, 1, 2, 1, 2]
    assert table["time_s"] == [0.0, 0.1, 0.2, 0.1, 0.2]
    assert table["x_m"] == [0.0, 1.0, 2.0, 8.0, 8.0]
    assert table["class"] == ["car"] * 3 + ["bus"] * 2
    assert table["controller"] == ["planner"] * 3 + ["policy"] * 2
    assert table["is_target"] == [True] * 3 + [False] * 2
    assert set(table["episode"]) == {4}
    assert (table["length_m"][3], table["width_m"][3]) == (12.0, 2.5)


def test_plans_by_hand() -> None:
    nan = np.nan
    first = MadePlans(
        0.0, 0.5, ("ego", "bus7"), np.array([[[1.234, 0.0], [nan, nan]], [[nan, nan], [7.0, -0.001]]])
    )
    later = MadePlans(0.5, 0.5, ("ego",), np.array([[[2.0, 0.0], [3.0, 1.0]]]))
    table = plans_table(replace(record(4), plans=(first, later))).to_pydict()
    assert table == {
        "episode": [4] * 4,
        "made_s": [0.0, 0.0, 0.5, 0.5],
        "agent": ["ego", "bus7", "ego", "ego"],
        "time_s": [0.5, 1.0, 1.0, 1.5],
        "x_m": [1.23, 7.0, 2.0, 3.0],
        "y_m": [0.0, 0.0, 0.0, 1.0],
    }
    assert plans_table(record(4)).num_rows == 0


def test_the_unattacked_by_hand() -> None:
    natural = replace(record(4).tracks.rows([1, 0]), dt_s=0.5)
    table = natural_table(replace(record(4), natural=natural)).to_pydict()
    assert table["agent"] == ["bus7", "bus7", "ego", "ego", "ego"]
    assert table["time_s"] == [0.5, 1.0, 0.0, 0.5, 1.0]
    assert table["is_target"] == [False, False, True, True, True]
    assert table["x_m"] == [8.0, 8.0, 0.0, 1.0, 2.0]
    assert list(table) == list(TABLES["unattacked"])
    assert natural_table(record(4)).num_rows == 0


def test_timing_by_hand() -> None:
    row = timing_row(record(1), TIMING)
    assert math.isclose(row["simulated_s"], 0.2)
    assert math.isclose(row["real_time_factor"], 2.0)
    assert math.isclose(row["target_plan_p50_s"], 0.02)
    assert math.isclose(row["target_plan_p99_s"], 0.0298)
    assert row["background_plan_p50_s"] is None
    assert list(row) == list(TABLES["timing"])
