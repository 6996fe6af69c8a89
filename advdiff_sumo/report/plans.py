"""Reads the plans of ``plans.parquet`` and encodes them for an episode's block."""

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
    """The plan of one vehicle at one moment.

    Attributes:
        agent: its id.
        made_s: time at which it was made.
        times_s: (T,) of the planned positions, evenly spaced.
        xy_m: (T, 2) planned centres of the box.
    """

    agent: str
    made_s: float
    times_s: FloatArray
    xy_m: FloatArray


def plans_of(table: pa.Table) -> tuple[Planned, ...]:
    """Return the plans in *table* (rows of one episode), by agent and then in order of time."""
    if not table.num_rows:
        return ()
    table = table.sort_by([("agent", "ascending"), ("made_s", "ascending"), ("time_s", "ascending")])
    agents = table["agent"].to_pylist()
    made_s, times, x, y = (
        np.asarray(table[name].to_numpy(), dtype=np.float64) for name in ("made_s", "time_s", "x_m", "y_m")
    )
    xy = np.stack((x, y), axis=-1)
    plans = []
    for (agent, plan_time), rows in groupby(range(len(agents)), key=lambda k: (agents[k], made_s[k])):
        indices = list(rows)
        plans.append(Planned(agent, float(plan_time), times[indices], xy[indices]))
    return tuple(plans)


def packed_plans(
    plans: Sequence[Planned], rows: Mapping[str, int], origin_m: FloatArray
) -> tuple[dict[str, Any] | None, list[IntArray]]:
    """Return the header and the numbers of *plans* for a block; the header is None without plans.

    The header has the spacing ``dt`` of positions, the least time ``every`` between plans, and for each series of plans
    of an agent its row ``r``, their number ``n``, and ``x`` and ``y`` in cm of the first plan's first position. A plan
    is five numbers: steps of ``dt`` since the previous plan, steps until its first position, number of positions, and x
    and y of the first position less those of the previous plan. The second differences of x and of y follow.

    Args:
        plans: of one episode, see :func:`plans_of`.
        rows: row of each agent in the block; other agents are left out.
        origin_m: (2,) origin of the block's positions.
    """
    packable = [plan for plan in plans if plan.agent in rows]
    if not packable:
        return None, []
    dt = min(float(plan.times_s[0]) - plan.made_s for plan in packable)
    made_times = np.unique([plan.made_s for plan in packable])
    series: list[dict[str, int]] = []
    numbers: list[IntArray] = []
    for agent, agent_plans in groupby(packable, key=lambda plan: plan.agent):
        previous: tuple[int, IntArray] | None = None
        for plan in agent_plans:
            xy_cm = np.rint((plan.xy_m - origin_m) * PER_M).astype(np.int64)
            made_step = round(plan.made_s / dt)
            plan_numbers = None
            if previous is not None:
                plan_numbers = _coded(plan, xy_cm, made_step - previous[0], previous[1], dt)
            if plan_numbers is None:  # the first plan, or one too far from the previous one: a new series
                x, y = xy_cm[0].tolist()
                series.append({"r": rows[agent], "n": 0, "x": x, "y": y})
                plan_numbers = _coded(plan, xy_cm, made_step, xy_cm[0], dt)
            if plan_numbers is not None:
                series[-1]["n"] += 1
                numbers.append(plan_numbers)
                previous = made_step, xy_cm[0]
    every = float(np.diff(made_times).min()) if len(made_times) > 1 else dt
    return {"dt": round(dt, 6), "every": round(every, 6), "series": series}, numbers


def _coded(
    plan: Planned, xy_cm: IntArray, steps_since: int, previous_xy_cm: IntArray, dt_s: float
) -> IntArray | None:
    """Return the numbers of one plan; None if one exceeds the range of a block."""
    first = round((float(plan.times_s[0]) - plan.made_s) / dt_s)
    header = np.array([steps_since, first, len(xy_cm), *(xy_cm[0] - previous_xy_cm)], dtype=np.int64)
    coded = np.concatenate((header, second_differences(xy_cm[:, 0]), second_differences(xy_cm[:, 1])))
    return coded if fits(coded) else None
