"""Turns the rows of ``states.parquet`` of one episode back into tracks."""

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
"""Columns of ``states.parquet`` that are read."""
_DEFAULT_STEP_S = 0.1


@dataclass(frozen=True)
class EpisodeStates:
    """Tracks of one episode and who of them was tested.

    Attributes:
        tracks: (A, T) states at SUMO's step, agents in the order of the table.
        target: row of the tested vehicle.
        moved: rows of those that the background policy ever moved.
    """

    tracks: Tracks
    target: int
    moved: frozenset[int] = frozenset()


def states_of(table: pa.Table) -> EpisodeStates | None:
    """Return the tracks in *table* (rows of one episode, in any order); None when no target is among them."""
    names = np.array(table["agent"].to_pylist(), dtype=object)
    is_target = np.asarray(table["is_target"].to_numpy(), dtype=np.bool_)
    if not is_target.any():
        return None
    ids = tuple(dict.fromkeys(names.tolist()))
    index = {name: row for row, name in enumerate(ids)}
    agent = np.array([index[name] for name in names], dtype=np.int64)
    step = np.asarray(table["step"].to_numpy(), dtype=np.int64)
    first = np.unique(agent, return_index=True)[1]
    shape = (len(ids), int(step.max()) + 1)

    def spread(column: str) -> FloatArray:
        filled = np.full(shape, np.nan)
        filled[agent, step] = _real(table, column)
        return filled

    classes = [AgentClass[str(name).upper()] for name in table["class"].take(first).to_pylist()]
    tracks = Tracks(
        ids=ids,
        classes=np.array([int(c) for c in classes], dtype=np.int64),
        size_m=np.stack((_real(table, "length_m")[first], _real(table, "width_m")[first]), axis=1),
        xy_m=np.stack((spread("x_m"), spread("y_m")), axis=-1),
        yaw_rad=spread("yaw_rad"),
        speed_mps=spread("speed_mps"),
        valid=np.isfinite(spread("x_m")),
        t0_s=0.0,
        dt_s=_step_s(step, _real(table, "time_s")),
    )
    return EpisodeStates(tracks, index[names[int(np.argmax(is_target))]], _moved(table, agent))


def _moved(table: pa.Table, agent: IntArray) -> frozenset[int]:
    if "controller" not in table.column_names:
        return frozenset()
    by_policy = np.asarray(pc.equal(table["controller"], pa.scalar("policy")).to_numpy(), dtype=np.bool_)
    return frozenset(np.unique(agent[by_policy]).tolist())


def _real(table: pa.Table, column: str) -> FloatArray:
    return np.asarray(table[column].to_numpy(), dtype=np.float64)


def _step_s(step: IntArray, time_s: FloatArray) -> float:
    latest = int(np.argmax(step))
    return round(float(time_s[latest] / step[latest]), 9) if step[latest] > 0 else _DEFAULT_STEP_S
