"""Rebuilds the record of an episode from the tables of a folder, as far as they contain it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pyarrow as pa

from advdiff_sumo.core.record import Controller, EndReason, EpisodeRecord
from advdiff_sumo.data.episode_states import EpisodeStates, states_of


def stored_record(
    states: pa.Table, row: Mapping[str, Any] | None = None, signals: pa.Table | None = None
) -> EpisodeRecord | None:
    """Return the record of one episode; None without a target.

    Missing data stay empty: plans, failures, and in folders of earlier versions routes and signals.

    Args:
        states: rows of ``states.parquet`` of the episode.
        row: its row of ``episodes.parquet``.
        signals: its rows of ``signals.parquet``.
    """
    episode = states_of(states)
    if episode is None:
        return None
    return replace(
        record_of_states(episode, row if row is not None else {}, signals),
        controller=_controllers(states, episode.tracks.valid.shape, episode.tracks.index),
    )


def record_of_states(
    episode: EpisodeStates, row: Mapping[str, Any], signals: pa.Table | None
) -> EpisodeRecord:
    """Return the record of one episode, with the arguments of :func:`stored_record`; all present agents are SUMO's."""
    return EpisodeRecord(
        episode=int(row.get("episode") or 0),
        seed=int(row.get("seed") or 0),
        scene=str(row.get("scene") or ""),
        tracks=episode.tracks,
        target=episode.target,
        controller=np.where(episode.tracks.valid, Controller.SUMO, Controller.ABSENT).astype(np.int64),
        route=tuple(str(row.get("route") or "").split()),
        end=EndReason(str(row.get("end") or EndReason.HORIZON)),
        signals=_signals(signals, episode.tracks.steps),
    )


def _controllers(states: pa.Table, shape: tuple[int, ...], index: Mapping[str, int]) -> Any:
    controllers = np.full(shape, Controller.ABSENT, dtype=np.int64)
    if "controller" in states.column_names:
        columns = (states[agent_id].to_pylist() for agent_id in ("agent", "step", "controller"))
        for agent_id, step, controller in zip(*columns, strict=True):
            controllers[index[agent_id], step] = Controller[controller.upper()]
    return controllers


def _signals(table: pa.Table | None, steps: int) -> tuple[Mapping[str, str], ...]:
    """Return the states of the traffic lights at each of *steps* instants; () if they are unknown."""
    if table is None or not table.num_rows:
        return ()
    changes: dict[int, dict[str, str]] = {}
    for change in table.to_pylist():
        changes.setdefault(int(change["step"]), {})[change["traffic_light"]] = change["state"]
    lights: dict[str, str] = {}
    instants: list[Mapping[str, str]] = []
    for step in range(steps):
        if step in changes:
            lights = {**lights, **changes[step]}
        instants.append(lights)
    return tuple(instants)
