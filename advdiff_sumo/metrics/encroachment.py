"""Post-encroachment time of the target with vehicles whose paths cross its own.

PET is the time from when the first of two vehicles has left the place where their paths cross until the other
reaches it (Allen, Shin and Cooper 1978, "Analysis of traffic conflicts and collisions"). Here: the least |t₁ − t₂|
at which the target's box at t₁ and the other's box at t₂ share a place. For two straight paths this is the time
between leaving and entering the conflict area; it stays defined for curved and merging paths, whose conflict
area has no end.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from advdiff_sumo.core.arrays import BoolArray, IntArray
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.metrics.continuous_collision import Sweep, gaps_at
from advdiff_sumo.metrics.criticality import Extreme
from advdiff_sumo.metrics.kinematics import unbroken

#: Paths at a smaller angle do not cross: one vehicle follows or meets the other.
CROSSING_RAD = np.deg2rad(30.0)
#: Longer times are not looked for.
PET_HORIZON_S = 10.0
#: Each step is divided into so many parts: the result is exact to a tenth of a step.
_PARTS = 10
_BATCH = 64


def post_encroachment(tracks: Tracks, target: int) -> Extreme | None:
    """Return the least PET of *target* over all others, with the time at which the later vehicle arrived.

    None when no path crosses the target's. 0 when both are there at once.
    """
    steady = unbroken(tracks)
    own, other, row = _near_steps(tracks, target, steady)
    if not own.size:
        return None
    wait = np.abs(own - other)
    order = np.lexsort((row, np.minimum(own, other), wait))
    best: tuple[float, int, float] | None = None
    for start in range(0, len(order), _BATCH):
        batch = order[start : start + _BATCH]
        if best is not None and (wait[batch[0]] - 1) * tracks.dt_s >= best[0]:
            break
        finest = _finest(tracks, target, own[batch], other[batch], row[batch])
        best = min((x for x in (best, finest) if x is not None), default=None)
    return None if best is None else Extreme(best[0], best[1], best[2])


def _near_steps(tracks: Tracks, target: int, steady: BoolArray) -> tuple[IntArray, IntArray, IntArray]:
    """Return steps of the target, steps of others and their rows whose boxes may meet, at crossing angles."""
    row, step = np.nonzero(steady & (np.arange(tracks.agents) != target)[:, None])
    mine = np.flatnonzero(steady[target])
    if not len(row) or not len(mine):
        return (np.zeros(0, dtype=np.int64),) * 3
    middle = 0.5 * (tracks.xy_m[:, 1:] + tracks.xy_m[:, :-1])
    radius = 0.5 * np.hypot(tracks.size_m[:, 0], tracks.size_m[:, 1])
    travel = 0.5 * np.hypot(*np.moveaxis(np.diff(tracks.xy_m, axis=1), -1, 0))
    reach = radius[row] + travel[row, step] + radius[target] + float(travel[target, mine].max())
    near = cKDTree(middle[target, mine]).query_ball_point(middle[row, step], reach)
    counts = np.array([len(x) for x in near], dtype=np.int64)
    if not counts.any():
        return (np.zeros(0, dtype=np.int64),) * 3
    own = mine[np.concatenate([np.asarray(x, dtype=np.int64) for x in near])]
    row, other = np.repeat(row, counts), np.repeat(step, counts)
    angle = tracks.yaw_rad[target, own] - tracks.yaw_rad[row, other]
    keep = np.abs(np.sin(angle)) >= np.sin(CROSSING_RAD)
    keep &= np.abs(own - other) * tracks.dt_s <= PET_HORIZON_S
    own, other, row = own[keep], other[keep], row[keep]
    keep = _swept_meet(tracks, target, own, other, row)
    return own[keep], other[keep], row[keep]


def _swept_meet(tracks: Tracks, target: int, own: IntArray, other: IntArray, row: IntArray) -> BoolArray:
    """Return whether the boxes may meet when each is grown by all that it moves and turns within its step."""
    a, b = _sweeps(tracks, target, own, other, row)
    gaps, _, _ = gaps_at(a, b, 0.5, 0.5)
    slack = sum(
        0.5 * np.hypot(*x.move_m.T) + 0.5 * np.abs(x.turn_rad) * np.hypot(*x.half_m.T) for x in (a, b)
    )
    return np.asarray(gaps.max(-1) <= slack)


def _finest(
    tracks: Tracks, target: int, own: IntArray, other: IntArray, row: IntArray
) -> tuple[float, int, float] | None:
    """Return the least wait in s, its row and the later time, over all parts of the given steps."""
    a, b = _sweeps(tracks, target, own, other, row)
    part = np.linspace(0.0, 1.0, _PARTS + 1)
    share_a, share_b = np.meshgrid(part, part, indexing="ij")
    count = share_a.size
    pick = np.repeat(np.arange(len(own)), count)
    at_a, at_b = np.tile(share_a.ravel(), len(own)), np.tile(share_b.ravel(), len(own))
    gaps, _, _ = gaps_at(a.rows(pick), b.rows(pick), at_a, at_b)
    hit = np.flatnonzero(gaps.max(-1) < 0.0)
    if not hit.size:
        return None
    mine, theirs = own[pick[hit]] + at_a[hit], other[pick[hit]] + at_b[hit]
    wait, later = np.abs(mine - theirs), np.maximum(mine, theirs)
    first = np.lexsort((row[pick[hit]], later, np.round(wait, 6)))[0]
    seconds = round(float(wait[first]) * tracks.dt_s, 9)
    return seconds, int(row[pick[hit[first]]]), tracks.t0_s + float(later[first]) * tracks.dt_s


def _sweeps(
    tracks: Tracks, target: int, own: IntArray, other: IntArray, row: IntArray
) -> tuple[Sweep, Sweep]:
    return Sweep.of(tracks, np.full(len(own), target), own), Sweep.of(tracks, row, other)
