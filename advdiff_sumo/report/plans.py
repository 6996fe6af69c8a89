"""What was planned, out of ``plans.parquet`` and into an episode's block."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
import pyarrow as pa

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.report.encode import PER_M, fits, second_differences

PLAN_COLUMNS = ("made_s", "agent", "time_s", "x_m", "y_m")


@dataclass(frozen=True)
class Planned:
    """What one vehicle meant to do at one moment.

    Attributes:
        agent: its id.
        made_s: when.
        times_s: (T,) of the planned positions, evenly spaced.
        xy_m: (T, 2) planned centres of the box.
    """

    agent: str
    made_s: float
    times_s: FloatArray
    xy_m: FloatArray


def plans_of(table: pa.Table) -> tuple[Planned, ...]:
    """Return the plans in *table* (rows of one episode) by agent, then in the order of time."""
    if not table.num_rows:
        return ()
    table = table.sort_by([("agent", "ascending"), ("made_s", "ascending"), ("time_s", "ascending")])
    agents = table["agent"].to_pylist()
    made_s, times, x, y = (
        np.asarray(table[name].to_numpy(), dtype=np.float64) for name in ("made_s", "time_s", "x_m", "y_m")
    )
    xy = np.stack((x, y), axis=-1)
    plans = []
    for (agent, moment), rows in groupby(range(len(agents)), key=lambda k: (agents[k], made_s[k])):
        own = list(rows)
        plans.append(Planned(agent, float(moment), times[own], xy[own]))
    return tuple(plans)


def packed_plans(
    plans: Sequence[Planned], rows: Mapping[str, int], origin_m: FloatArray
) -> tuple[dict[str, Any] | None, list[IntArray]]:
    """Return the header and the numbers of *plans* for a block; None where there are none.

    The header has the spacing ``dt`` of positions, the time ``every`` between two plans, and for each series of
    plans of an agent its row, their number, and the x and y in cm that the first one's position is relative to.
    A plan is five numbers (steps of ``dt`` since the plan before, steps until its first position, positions, x
    and y of the first one less those of the plan before), then the second differences of x and of y.

    Args:
        plans: of one episode, see :func:`plans_of`.
        rows: row of each agent in the block; others are left out.
        origin_m: (2,) what the block's positions are relative to.
    """
    known = [plan for plan in plans if plan.agent in rows]
    if not known:
        return None, []
    dt = min(float(plan.times_s[0]) - plan.made_s for plan in known)
    moments = np.unique([plan.made_s for plan in known])
    series: list[dict[str, int]] = []
    numbers: list[IntArray] = []
    for agent, own in groupby(known, key=lambda plan: plan.agent):
        last: tuple[int, IntArray] | None = None
        for plan in own:
            place = np.rint((plan.xy_m - origin_m) * PER_M).astype(np.int64)
            made_step = round(plan.made_s / dt)
            coded = None if last is None else _coded(plan, place, made_step - last[0], last[1], dt)
            if coded is None:  # the first, or so far off that it needs a beginning of its own
                x, y = place[0].tolist()
                series.append({"r": rows[agent], "n": 0, "x": x, "y": y})
                coded = _coded(plan, place, made_step, place[0], dt)
            if coded is not None:
                series[-1]["n"] += 1
                numbers.append(coded)
                last = made_step, place[0]
    every = float(np.diff(moments).min()) if len(moments) > 1 else dt
    return {"dt": round(dt, 6), "every": round(every, 6), "series": series}, numbers


def _coded(plan: Planned, place: IntArray, since: int, before: IntArray, dt_s: float) -> IntArray | None:
    """Return the numbers of one plan; None where one does not fit."""
    first = round((float(plan.times_s[0]) - plan.made_s) / dt_s)
    head = np.array([since, first, len(place), *(place[0] - before)], dtype=np.int64)
    coded = np.concatenate((head, second_differences(place[:, 0]), second_differences(place[:, 1])))
    return coded if fits(coded) else None
