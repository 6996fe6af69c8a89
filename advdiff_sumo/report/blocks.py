"""Makes the data of the page's player: a block for each episode, and one for the streets of each net."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.data.episode_states import EpisodeStates
from advdiff_sumo.report.encode import PER_M, block, path_parts, wrapped_differences
from advdiff_sumo.report.layer import MapLayer, NetWindow
from advdiff_sumo.report.plans import Planned, packed_plans
from advdiff_sumo.report.series import Series

#: Streets are cut into squares of this size, of which the player draws those in view.
CELL_M = 250.0
#: Streets within this distance of the targets' paths are included.
AROUND_M = 120.0
_DEVIATION_M = 0.5  # from the natural path, above which both are shown
_CHART_SERIES = (
    *("speed_mps", "attacker_mps", "reference_mps"),
    *("accel_mps2", "attacker_accel_mps2", "reference_accel_mps2"),
    *("jerk_mps3", "ttc_s", "gap_m"),
)


def episode_block(
    states: EpisodeStates,
    attacker: str | None,
    series: Series,
    natural: Tracks | None,
    plans: Sequence[Planned] = (),
    reference: Tracks | None = None,
) -> str:
    """Return the block of one episode.

    Args:
        states: of the episode.
        attacker: id of the target's collision partner, else of the nearest vehicle, or None.
        series: values of the charts.
        natural: tracks of the same seed scene without attack, or None.
        plans: of the vehicles, as far as they are known.
        reference: track of the careful driver from its takeover on, or None.
    """
    tracks = states.tracks
    origin = np.rint(np.nanmin(tracks.xy_m.reshape(-1, 2), axis=0))
    agents, numbers = _paths(tracks, origin)
    for row, agent in enumerate(agents):
        agent["c"] = AgentClass(int(tracks.classes[row])).name.lower()
        agent["s"] = [round(float(v), 2) for v in tracks.size_m[row]]
        agent["m"] = int(row in states.moved)
    header = {
        "dt": tracks.dt_s,
        "steps": tracks.steps,
        "origin": origin.tolist(),
        "target": states.target,
        "attacker": -1 if attacker is None else tracks.index.get(attacker, -1),
        "agents": agents,
        "series": list(_CHART_SERIES),
        "natural": None,
        "reference": None,
        "plans": None,
    }
    if natural is not None and natural.agents:
        ghosts, extra_numbers = _paths(natural, origin)
        header["natural"] = {"dt": natural.dt_s, "t0": natural.t0_s, "agents": ghosts}
        numbers += extra_numbers
    if reference is not None:
        ghosts, extra_numbers = _paths(reference, origin)
        header["reference"] = {"dt": reference.dt_s, "t0": reference.t0_s, "agents": ghosts}
        numbers += extra_numbers
    header["plans"], extra_numbers = packed_plans(plans, tracks.index, origin)
    numbers += extra_numbers
    numbers += [wrapped_differences(getattr(series, name)) for name in _CHART_SERIES]
    return block(header, numbers)


def _paths(tracks: Tracks, origin: FloatArray) -> tuple[list[dict[str, Any]], list[IntArray]]:
    """Return the headers of the agents' paths and their numbers."""
    agents: list[dict[str, Any]] = []
    numbers: list[IntArray] = []
    for row, name in enumerate(tracks.ids):
        parts = []
        for start, part_numbers in path_parts(tracks.xy_m[row], tracks.yaw_rad[row], origin):
            parts.append(start)
            numbers += part_numbers
        agents.append({"id": name, "p": parts})
    return agents, numbers


def deviating_tracks(states: EpisodeStates, natural: Tracks) -> Tracks:
    """Return the target and all agents of *natural* whose paths differ from those in the episode.

    The tracks are cut to the episode's duration, up to the first instant at or after its end.
    """
    tracks = states.tracks
    end_s = tracks.times_s[-1]
    steps = np.flatnonzero((natural.times_s >= -1e-6) & (natural.times_s < end_s + natural.dt_s - 1e-6))
    if not len(steps):
        return Tracks.empty()
    cut = natural.window(int(steps[0]), int(steps[-1]) + 1)
    rows = [row for row, name in enumerate(cut.ids) if _differs(tracks, cut, row, name, states.target)]
    return cut.rows(np.array(rows, dtype=np.int64))


def _differs(tracks: Tracks, natural: Tracks, row: int, name: str, target: int) -> bool:
    own_row = tracks.index.get(name)
    if own_row is None or own_row == target:
        return own_row is not None
    steps = np.clip(np.rint(natural.times_s / tracks.dt_s).astype(np.int64), 0, tracks.steps - 1)
    distance_m = np.linalg.norm(tracks.xy_m[own_row, steps] - natural.xy_m[row], axis=-1)
    distance_m = distance_m[natural.times_s <= tracks.times_s[-1] + 1e-6]
    return bool((distance_m > _DEVIATION_M).any())  # NaN compares as False


def streets_block(layer: MapLayer, paths_m: Iterable[FloatArray]) -> str:
    """Return the streets around *paths_m*, each (T, 2), NaN allowed, as one block."""
    cells: list[Mapping[str, Any]] = []
    numbers: list[IntArray] = []
    for column, row in sorted(_grid_cells(paths_m)):
        corner = np.array([column, row]) * CELL_M
        view = NetWindow(*corner.tolist(), *(corner + CELL_M).tolist())
        streets = layer.streets(view, tolerance_m=0.08)
        groups = (streets.areas, streets.solid, streets.dashed)
        if any(groups):
            cells.append({"at": corner.tolist(), "lines": [[len(p) for p in group] for group in groups]})
            numbers += [_polyline(points, corner) for group in groups for points in group]
    return block({"size": CELL_M, "cells": cells}, numbers)


def _grid_cells(paths_m: Iterable[FloatArray]) -> set[tuple[int, int]]:
    """Return the (column, row) of all squares within ``AROUND_M`` of a path."""
    cells: set[tuple[int, int]] = set()
    reach = np.array([[i, j] for i in (-AROUND_M, 0.0, AROUND_M) for j in (-AROUND_M, 0.0, AROUND_M)])
    for path in paths_m:
        points = path[np.isfinite(path).all(axis=1)]
        cell_indices = np.floor((points[:, None] + reach) / CELL_M).astype(np.int64).reshape(-1, 2)
        cells |= {(int(a), int(b)) for a, b in np.unique(cell_indices, axis=0)}
    return cells


def _polyline(points: FloatArray, corner: FloatArray) -> IntArray:
    """Return x and y of the first point and of each step between points, in cm, alternating."""
    positions_cm = np.rint((points - corner) * PER_M).astype(np.int64)
    return np.diff(positions_cm, axis=0, prepend=np.zeros((1, 2), dtype=np.int64)).reshape(-1)
