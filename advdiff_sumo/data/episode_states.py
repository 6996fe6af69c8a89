"""Converts the rows of one episode in ``states.parquet`` into tracks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.scene import AgentClass, Tracks

STATE_COLUMNS = (
    *("episode", "step", "time_s", "agent", "class", "length_m", "width_m"),
    *("x_m", "y_m", "yaw_rad", "speed_mps", "is_target"),
)
"""Columns of ``states.parquet`` that :func:`states_of` needs."""
_DEFAULT_STEP_S = 0.1


@dataclass(frozen=True)
class EpisodeStates:
    """The tracks of one episode.

    Attributes:
        tracks: (A, T) states at SUMO's time step, agents in the order of the table.
        target: row of the target.
        moved: rows of the agents that the background policy moved at any step.
    """

    tracks: Tracks
    target: int
    moved: frozenset[int] = frozenset()


def states_of(table: pa.Table) -> EpisodeStates | None:
    """Return the tracks in *table*, rows of one episode in any order; None if they contain no target."""
    names = np.array(table["agent"].to_pylist(), dtype=object)
    is_target = np.asarray(table["is_target"].to_numpy(), dtype=np.bool_)
    if not is_target.any():
        return None
    ids = tuple(dict.fromkeys(names.tolist()))
    row_of = {name: row for row, name in enumerate(ids)}
    agent = np.array([row_of[name] for name in names], dtype=np.int64)
    step = np.asarray(table["step"].to_numpy(), dtype=np.int64)
    first = np.unique(agent, return_index=True)[1]
    shape = (len(ids), int(step.max()) + 1)

    def by_agent_and_step(column: str) -> FloatArray:
        values = np.full(shape, np.nan)
        values[agent, step] = _floats(table, column)
        return values

    classes = [AgentClass[str(name).upper()] for name in table["class"].take(first).to_pylist()]
    tracks = Tracks(
        ids=ids,
        classes=np.array([int(c) for c in classes], dtype=np.int64),
        size_m=np.stack((_floats(table, "length_m")[first], _floats(table, "width_m")[first]), axis=1),
        xy_m=np.stack((by_agent_and_step("x_m"), by_agent_and_step("y_m")), axis=-1),
        yaw_rad=by_agent_and_step("yaw_rad"),
        speed_mps=by_agent_and_step("speed_mps"),
        valid=np.isfinite(by_agent_and_step("x_m")),
        t0_s=0.0,
        dt_s=_step_s(step, _floats(table, "time_s")),
    )
    return EpisodeStates(tracks, row_of[names[int(np.argmax(is_target))]], _moved(table, agent))


def _moved(table: pa.Table, agent: IntArray) -> frozenset[int]:
    if "controller" not in table.column_names:
        return frozenset()
    by_policy = np.asarray(pc.equal(table["controller"], pa.scalar("policy")).to_numpy(), dtype=np.bool_)
    return frozenset(np.unique(agent[by_policy]).tolist())


def _floats(table: pa.Table, column: str) -> FloatArray:
    return np.asarray(table[column].to_numpy(), dtype=np.float64)


def _step_s(step: IntArray, time_s: FloatArray) -> float:
    last = int(np.argmax(step))
    return round(float(time_s[last] / step[last]), 9) if step[last] > 0 else _DEFAULT_STEP_S
