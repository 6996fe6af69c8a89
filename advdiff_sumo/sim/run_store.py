"""Define the tables of a run: their columns, and the rows that one episode adds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from advdiff_sumo.core.record import Controller, EpisodeRecord
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.metrics.arrow_tables import schema_of, table_of
from advdiff_sumo.metrics.columns import COLLISION_COLUMNS, EPISODE_COLUMNS, Column
from advdiff_sumo.sim.episode import Timing

STATE_COLUMNS: Mapping[str, Column] = {
    "episode": Column("int64", "", "number of the episode in its run", nullable=False),
    "step": Column("int64", "", "SUMO step since the start; 0 is the seed scene", nullable=False),
    "time_s": Column("float64", "s", "since the episode's start", nullable=False),
    "agent": Column("str", "", "name of the road user", nullable=False),
    "class": Column("str", "", "car, truck, bus, motorcycle, bicycle or pedestrian", nullable=False),
    "length_m": Column("float64", "m", "length and width of the box", nullable=False),
    "width_m": Column("float64", "m", "length and width of the box", nullable=False),
    "x_m": Column("float64", "m", "east and north, centre of the box", nullable=False),
    "y_m": Column("float64", "m", "east and north, centre of the box", nullable=False),
    "yaw_rad": Column("float64", "rad", "heading, counter-clockwise from east", nullable=False),
    "speed_mps": Column("float64", "m/s", "speed along the heading", nullable=False),
    "controller": Column(
        "str",
        "",
        "who moved it: sumo, policy, planner, or replayed (its log)",
        nullable=False,
    ),
    "is_target": Column("bool", "", "whether it is the target", nullable=False),
}
PLAN_COLUMNS: Mapping[str, Column] = {
    "episode": Column("int64", "", "number of the episode in its run", nullable=False),
    "made_s": Column("float64", "s", "when the plan was made", nullable=False),
    "agent": Column("str", "", "whose plan", nullable=False),
    "time_s": Column("float64", "s", "when it would be there", nullable=False),
    "x_m": Column("float64", "m", "planned centre of the box, to 1 cm", nullable=False),
    "y_m": Column("float64", "m", "planned centre of the box, to 1 cm", nullable=False),
}
NATURAL_COLUMNS: Mapping[str, Column] = {
    name: column for name, column in STATE_COLUMNS.items() if name != "controller"
} | {"step": Column("int64", "", "number of the instant, `sim.model_step_s` apart", nullable=False)}
SIGNAL_COLUMNS: Mapping[str, Column] = {
    "episode": Column("int64", "", "number of the episode in its run", nullable=False),
    "step": Column("int64", "", "first SUMO step at which it shows this", nullable=False),
    "traffic_light": Column("str", "", "SUMO's id of the traffic light", nullable=False),
    "state": Column("str", "", "SUMO's letters, one a connection", nullable=False),
}
TIMING_COLUMNS: Mapping[str, Column] = {
    "episode": Column("int64", "", "number of the episode in its run", nullable=False),
    "simulated_s": Column("float64", "s", "simulated time", nullable=False),
    "wall_s": Column("float64", "s", "wall-clock, SUMO's start included", nullable=False),
    "real_time_factor": Column("float64", "", "simulated_s / wall_s", nullable=False),
    "cpu_s": Column("float64", "s", "processor time, SUMO's included"),
    "target_plan_p50_s": Column(
        "float64", "s", "time of a plan of a Python target, median and 99th percentile"
    ),
    "target_plan_p99_s": Column(
        "float64", "s", "time of a plan of a Python target, median and 99th percentile"
    ),
    "background_plan_p50_s": Column("float64", "s", "the same of the policy"),
    "background_plan_p99_s": Column("float64", "s", "the same of the policy"),
}
TABLES: Mapping[str, Mapping[str, Column]] = {
    "episodes": EPISODE_COLUMNS,
    "states": STATE_COLUMNS,
    "collisions": COLLISION_COLUMNS,
    "plans": PLAN_COLUMNS,
    "unattacked": NATURAL_COLUMNS,
    "signals": SIGNAL_COLUMNS,
    "timing": TIMING_COLUMNS,
}
#: Tables that are missing in folders of earlier versions.
LATER_TABLES = frozenset(("signals",))


def episode_tables(
    record: EpisodeRecord,
    episode: Mapping[str, Any],
    collisions: list[dict[str, Any]],
    timing: Timing,
) -> dict[str, pa.Table]:
    """Return the rows that one episode adds to each of ``TABLES``."""
    rows = {"episodes": [dict(episode)], "collisions": collisions, "timing": [timing_row(record, timing)]}
    tables = {name: table_of(content, TABLES[name]) for name, content in rows.items()}
    tables |= {"states": states_table(record), "plans": plans_table(record)}
    return {**tables, "unattacked": natural_table(record), "signals": signals_table(record)}


def states_table(record: EpisodeRecord) -> pa.Table:
    """Return one row for each agent and step of *record*, ordered by agent, then step."""
    controllers = np.array([c.name.lower() for c in Controller if c >= 0], dtype=object)
    columns = _state_columns(record.tracks, record.episode, record.target)
    columns["controller"] = controllers[record.controller[np.nonzero(record.tracks.valid)]]
    return pa.table({name: columns[name] for name in STATE_COLUMNS}, schema=schema_of(STATE_COLUMNS))


def natural_table(record: EpisodeRecord) -> pa.Table:
    """Return one row for each agent and instant of the course without attack, to 1 cm, 1 mrad and 1 cm/s."""
    natural = record.natural if record.natural is not None else Tracks.empty()
    target = record.tracks.ids[record.target] if record.tracks.agents else ""
    columns = _state_columns(natural, record.episode, natural.index.get(target, -1))
    for name, digits in (("x_m", 2), ("y_m", 2), ("yaw_rad", 3), ("speed_mps", 2)):
        columns[name] = np.round(columns[name], digits) + 0.0  # no −0
    return pa.table({name: columns[name] for name in NATURAL_COLUMNS}, schema=schema_of(NATURAL_COLUMNS))


def _state_columns(tracks: Tracks, episode: int, target: int) -> dict[str, Any]:
    """Return the columns of *tracks* that ``states`` and ``unattacked`` share."""
    agent, step = np.nonzero(tracks.valid)
    names = np.array(tracks.ids, dtype=object)
    classes = np.array([c.name.lower() for c in AgentClass], dtype=object)
    return {
        "episode": np.full(len(agent), episode),
        "step": step,
        "time_s": np.round(tracks.times_s[step], 6),
        "agent": names[agent],
        "class": classes[tracks.classes[agent]],
        "length_m": tracks.size_m[agent, 0],
        "width_m": tracks.size_m[agent, 1],
        "x_m": tracks.xy_m[agent, step, 0],
        "y_m": tracks.xy_m[agent, step, 1],
        "yaw_rad": tracks.yaw_rad[agent, step],
        "speed_mps": tracks.speed_mps[agent, step],
        "is_target": agent == target,
    }


def signals_table(record: EpisodeRecord) -> pa.Table:
    """Return what each traffic light shows at first, and each change, in order of time."""
    rows: list[dict[str, Any]] = []
    lights: dict[str, str] = {}
    for step, states in enumerate(record.signals):
        for name in sorted(states):
            if lights.get(name) != states[name]:
                lights[name] = states[name]
                row = {"episode": record.episode, "step": step, "traffic_light": name, "state": states[name]}
                rows.append(row)
    return table_of(rows, SIGNAL_COLUMNS)


def plans_table(record: EpisodeRecord) -> pa.Table:
    """Return one row for each planned position of *record*, ordered by plan, agent, time."""
    indices = [np.nonzero(np.isfinite(plans.xy_m).all(axis=-1)) for plans in record.plans]
    counts = [len(agent) for agent, _ in indices]
    plans_with_indices = list(zip(record.plans, indices, strict=True))
    times = [plans.made_s + plans.dt_s * (step + 1) for plans, (_, step) in plans_with_indices]
    positions = [plans.xy_m[index] for plans, index in plans_with_indices]
    xy = np.round(np.concatenate([np.zeros((0, 2)), *positions]), 2) + 0.0  # no −0
    made_s = [np.full(count, plans.made_s) for plans, count in zip(record.plans, counts, strict=True)]
    columns: dict[str, Any] = {
        "episode": np.full(sum(counts), record.episode),
        "made_s": np.round(np.concatenate([np.zeros(0), *made_s]), 6),
        "agent": [plans.ids[row] for plans, (agent, _) in plans_with_indices for row in agent.tolist()],
        "time_s": np.round(np.concatenate([np.zeros(0), *times]), 6),
        "x_m": xy[:, 0],
        "y_m": xy[:, 1],
    }
    return pa.table(columns, schema=schema_of(PLAN_COLUMNS))


def timing_row(record: EpisodeRecord, timing: Timing) -> dict[str, Any]:
    """Return the row of one episode in ``timing.parquet``."""
    simulated_s = max(record.tracks.steps - 1, 0) * record.tracks.dt_s
    return {
        "episode": record.episode,
        "simulated_s": simulated_s,
        "wall_s": timing.wall_s,
        "real_time_factor": simulated_s / timing.wall_s,
        "cpu_s": timing.cpu_s,
        "target_plan_p50_s": _percentile(timing.target_plans_s, 50),
        "target_plan_p99_s": _percentile(timing.target_plans_s, 99),
        "background_plan_p50_s": _percentile(timing.background_plans_s, 50),
        "background_plan_p99_s": _percentile(timing.background_plans_s, 99),
    }


def _percentile(values: tuple[float, ...], percent: float) -> float | None:
    return float(np.percentile(values, percent)) if values else None
