"""What the page's player gets: a block for each episode and one for the streets of each net."""

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

#: Streets are cut into squares, of which the player draws those in view.
CELL_M = 250.0
#: Streets are kept so far around the targets' paths.
AROUND_M = 120.0
_DEVIATION_M = 0.5
_CHARTED = (
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
        attacker: id of the target's collision partner, or of who came nearest, or None.
        series: values of the charts.
        natural: what happened in the same seed scene without attack, or None.
        plans: what was planned, as far as it is known.
        reference: what the careful driver would have done from its takeover on, or None.
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
        "series": list(_CHARTED),
        "natural": None,
        "reference": None,
        "plans": None,
    }
    if natural is not None and natural.agents:
        ghosts, more = _paths(natural, origin)
        header["natural"] = {"dt": natural.dt_s, "t0": natural.t0_s, "agents": ghosts}
        numbers += more
    if reference is not None:
        ghosts, more = _paths(reference, origin)
        header["reference"] = {"dt": reference.dt_s, "t0": reference.t0_s, "agents": ghosts}
        numbers += more
    header["plans"], more = packed_plans(plans, tracks.index, origin)
    numbers += more
    numbers += [wrapped_differences(getattr(series, name)) for name in _CHARTED]
    return block(header, numbers)


def _paths(tracks: Tracks, origin: FloatArray) -> tuple[list[dict[str, Any]], list[IntArray]]:
    agents: list[dict[str, Any]] = []
    numbers: list[IntArray] = []
    for row, name in enumerate(tracks.ids):
        parts = []
        for start, own in path_parts(tracks.xy_m[row], tracks.yaw_rad[row], origin):
            parts.append(start)
            numbers += own
        agents.append({"id": name, "p": parts})
    return agents, numbers


def departed(states: EpisodeStates, natural: Tracks) -> Tracks:
    """Return those of *natural* whose path is another than in the episode, and the target.

    Cut to the episode's duration and one instant more where it ends between two.
    """
    driven = states.tracks
    end = driven.times_s[-1]
    within = np.flatnonzero((natural.times_s >= -1e-6) & (natural.times_s < end + natural.dt_s - 1e-6))
    if not len(within):
        return Tracks.empty()
    cut = natural.window(int(within[0]), int(within[-1]) + 1)
    kept = [row for row, name in enumerate(cut.ids) if _differs(driven, cut, row, name, states.target)]
    return cut.rows(np.array(kept, dtype=np.int64))


def _differs(driven: Tracks, natural: Tracks, row: int, name: str, target: int) -> bool:
    own = driven.index.get(name)
    if own is None or own == target:
        return own is not None
    steps = np.clip(np.rint(natural.times_s / driven.dt_s).astype(np.int64), 0, driven.steps - 1)
    apart = np.linalg.norm(driven.xy_m[own, steps] - natural.xy_m[row], axis=-1)
    apart = apart[natural.times_s <= driven.times_s[-1] + 1e-6]
    return bool((apart > _DEVIATION_M).any())  # NaN compares as False


def streets_block(layer: MapLayer, paths_m: Iterable[FloatArray]) -> str:
    """Return the streets around *paths_m*, each (T, 2) and possibly with NaN, as one block."""
    cells: list[Mapping[str, Any]] = []
    numbers: list[IntArray] = []
    for column, line in sorted(_cells(paths_m)):
        corner = np.array([column, line]) * CELL_M
        view = NetWindow(*corner.tolist(), *(corner + CELL_M).tolist())
        streets = layer.streets(view, tolerance_m=0.08)
        groups = (streets.areas, streets.solid, streets.dashed)
        if any(groups):
            cells.append({"at": corner.tolist(), "lines": [[len(p) for p in group] for group in groups]})
            numbers += [_polyline(points, corner) for group in groups for points in group]
    return block({"size": CELL_M, "cells": cells}, numbers)


def _cells(paths_m: Iterable[FloatArray]) -> set[tuple[int, int]]:
    """Return the (column, line) of all squares within ``AROUND_M`` of a path."""
    cells: set[tuple[int, int]] = set()
    reach = np.array([[i, j] for i in (-AROUND_M, 0.0, AROUND_M) for j in (-AROUND_M, 0.0, AROUND_M)])
    for path in paths_m:
        points = path[np.isfinite(path).all(axis=1)]
        places = np.floor((points[:, None] + reach) / CELL_M).astype(np.int64).reshape(-1, 2)
        cells |= {(int(a), int(b)) for a, b in np.unique(places, axis=0)}
    return cells


def _polyline(points: FloatArray, corner: FloatArray) -> IntArray:
    """Return x and y of the first point and of each step after it, in cm, alternating."""
    places = np.rint((points - corner) * PER_M).astype(np.int64)
    return np.diff(places, axis=0, prepend=np.zeros((1, 2), dtype=np.int64)).reshape(-1)
