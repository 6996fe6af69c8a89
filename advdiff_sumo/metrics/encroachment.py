"""Post-encroachment time (PET) of the target with vehicles whose paths cross its own.

PET is the time from when the first of two vehicles has left the place where their paths cross until the other
reaches it (Allen, Shin and Cooper 1978, "Analysis of traffic conflicts and collisions"). Here it is the least |t₁ − t₂|
at which the target's box at t₁ and the other's box at t₂ overlap. For two straight paths this is the time between
leaving and entering the conflict area. It is also defined for curved and merging paths, whose conflict area has no end.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from advdiff_sumo.core.arrays import BoolArray, IntArray
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.metrics.continuous_collision import BoxMotion, gaps_at
from advdiff_sumo.metrics.criticality import Extreme
from advdiff_sumo.metrics.kinematics import unbroken_steps

#: Paths at a smaller angle do not cross: the vehicles follow each other or are oncoming.
CROSSING_RAD = np.deg2rad(30.0)
#: Longer times do not count.
PET_HORIZON_S = 10.0
#: Number of parts into which each step is divided: the result is exact to a tenth of a step.
_PARTS = 10
#: Pairs of steps that are evaluated together.
_BATCH = 64


def post_encroachment(tracks: Tracks, target: int) -> Extreme | None:
    """Return the least PET of *target* over all others, with the time at which the later vehicle arrived.

    None if no path crosses the target's; 0 if both are there at the same time.
    """
    usable = unbroken_steps(tracks)
    own_step, other_step, row = _candidate_steps(tracks, target, usable)
    if not own_step.size:
        return None
    wait = np.abs(own_step - other_step)
    order = np.lexsort((row, np.minimum(own_step, other_step), wait))
    least: tuple[float, int, float] | None = None
    for start in range(0, len(order), _BATCH):
        batch = order[start : start + _BATCH]
        if least is not None and (wait[batch[0]] - 1) * tracks.dt_s >= least[0]:
            break
        batch_least = _least_wait(tracks, target, own_step[batch], other_step[batch], row[batch])
        least = min((x for x in (least, batch_least) if x is not None), default=None)
    return None if least is None else Extreme(least[0], least[1], least[2])


def _candidate_steps(tracks: Tracks, target: int, usable: BoolArray) -> tuple[IntArray, IntArray, IntArray]:
    """Return pairs of steps in which the boxes may meet at a crossing angle: of the target, of others, others' rows."""
    row, step = np.nonzero(usable & (np.arange(tracks.agents) != target)[:, None])
    own_steps = np.flatnonzero(usable[target])
    if not len(row) or not len(own_steps):
        return (np.zeros(0, dtype=np.int64),) * 3
    middle = 0.5 * (tracks.xy_m[:, 1:] + tracks.xy_m[:, :-1])
    radius = 0.5 * np.hypot(tracks.size_m[:, 0], tracks.size_m[:, 1])
    half_move = 0.5 * np.hypot(*np.moveaxis(np.diff(tracks.xy_m, axis=1), -1, 0))
    reach = radius[row] + half_move[row, step] + radius[target] + float(half_move[target, own_steps].max())
    near = cKDTree(middle[target, own_steps]).query_ball_point(middle[row, step], reach)
    counts = np.array([len(x) for x in near], dtype=np.int64)
    if not counts.any():
        return (np.zeros(0, dtype=np.int64),) * 3
    own_step = own_steps[np.concatenate([np.asarray(x, dtype=np.int64) for x in near])]
    row, other_step = np.repeat(row, counts), np.repeat(step, counts)
    angle = tracks.yaw_rad[target, own_step] - tracks.yaw_rad[row, other_step]
    keep = np.abs(np.sin(angle)) >= np.sin(CROSSING_RAD)
    keep &= np.abs(own_step - other_step) * tracks.dt_s <= PET_HORIZON_S
    own_step, other_step, row = own_step[keep], other_step[keep], row[keep]
    keep = _may_meet(tracks, target, own_step, other_step, row)
    return own_step[keep], other_step[keep], row[keep]


def _may_meet(
    tracks: Tracks, target: int, own_step: IntArray, other_step: IntArray, row: IntArray
) -> BoolArray:
    """Return whether the boxes may meet when each is grown by its motion and turn within its step."""
    own, other = _sweeps(tracks, target, own_step, other_step, row)
    gaps, _, _ = gaps_at(own, other, 0.5, 0.5)
    growth = sum(
        0.5 * np.hypot(*x.move_m.T) + 0.5 * np.abs(x.turn_rad) * np.hypot(*x.half_m.T) for x in (own, other)
    )
    return np.asarray(gaps.max(-1) <= growth)


def _least_wait(
    tracks: Tracks, target: int, own_step: IntArray, other_step: IntArray, row: IntArray
) -> tuple[float, int, float] | None:
    """Return the least wait in s, its row and the later time, over all parts of the given steps."""
    own, other = _sweeps(tracks, target, own_step, other_step, row)
    part = np.linspace(0.0, 1.0, _PARTS + 1)
    own_part, other_part = np.meshgrid(part, part, indexing="ij")
    pair = np.repeat(np.arange(len(own_step)), own_part.size)
    own_share, other_share = (np.tile(x.ravel(), len(own_step)) for x in (own_part, other_part))
    gaps, _, _ = gaps_at(own.rows(pair), other.rows(pair), own_share, other_share)
    hit = np.flatnonzero(gaps.max(-1) < 0.0)
    if not hit.size:
        return None
    own_time, other_time = own_step[pair[hit]] + own_share[hit], other_step[pair[hit]] + other_share[hit]
    wait, later = np.abs(own_time - other_time), np.maximum(own_time, other_time)
    first = np.lexsort((row[pair[hit]], later, np.round(wait, 6)))[0]
    seconds = round(float(wait[first]) * tracks.dt_s, 9)
    return seconds, int(row[pair[hit[first]]]), tracks.t0_s + float(later[first]) * tracks.dt_s


def _sweeps(
    tracks: Tracks, target: int, own_step: IntArray, other_step: IntArray, row: IntArray
) -> tuple[BoxMotion, BoxMotion]:
    return BoxMotion.of(tracks, np.full(len(own_step), target), own_step), BoxMotion.of(
        tracks, row, other_step
    )
