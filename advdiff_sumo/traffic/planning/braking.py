"""Slows vehicles along their planned paths where plans would collide or pass a stop line.

Which vehicle brakes:

1. If two footprints would overlap, the vehicle that has the other one in front of it brakes. If neither or both do,
   both brake. So no vehicle brakes for one that approaches from behind.
2. If one of the two stays where it is, the other one brakes, wherever the footprints touch. (The centre of a bus is
   beside a car that hits its front corner.)
3. If both would wait for each other, one goes (``_resolve_deadlocks``).
4. If the speed of one of the two cannot be adjusted, the other brakes if it has that vehicle in front of it, even if
   that vehicle ought to brake.

Attackers never brake for the target.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.boxes import axis_gaps
from advdiff_sumo.core.frames import unit
from advdiff_sumo.traffic.planning.futures import STANDS_MPS, WALKS_MPS, Futures
from advdiff_sumo.traffic.planning.planned_paths import PlannedPaths, drive_along

LADDER_MPS2 = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.5, 7.0, 8.5)
"""Decelerations to try after the unchanged plan; the mildest that suffices is taken."""
GAP_M = 1.0
"""Clearance in front of and behind a vehicle."""
SIDE_M = 0.15
"""Clearance on each side of a vehicle."""
_SLOW_SIDE_M = 0.05
"""Clearance on each side between two vehicles that are both slow."""
_CLEARANCE_SHARES = (1.0, 0.5, 0.25, 0.1)
"""Shares of the clearance to try where two vehicles are nearer than the full clearance now."""
_BEARING_TOLERANCE = 0.15
"""Two bearings count as equal if their cosines differ by no more than this."""
_IN_FRONT_COS = 0.3
"""A vehicle is in front if the cosine of its bearing exceeds this."""
_SETS_OFF_M, _STATIONARY_M = 0.3, 0.01
"""A plan longer than the first sets off; one no longer than the second stays where it is."""
_MAX_ROUNDS = 3


@dataclass(frozen=True)
class Braked:
    """Plans after braking.

    Attributes:
        futures: the plans, with new speeds where a vehicle had to brake.
        braked: (N,) whether the vehicle had to brake.
        unsolved: (N,) whether its footprint still overlaps another one, however hard it brakes.
    """

    futures: Futures
    braked: BoolArray
    unsolved: BoolArray


def brake_ahead(
    futures: Futures,
    adjustable: BoolArray,
    may_brake_for: BoolArray,
    stop_m: FloatArray,
    steps: int,
    side_m: FloatArray | None = None,
    must_yield: BoolArray | None = None,
) -> Braked:
    """Return :func:`brake` of the first *steps* instants; a braked vehicle keeps its last speed after them.

    Later conflicts are left out because the vehicles replan before these happen. Traffic would come to a halt if
    vehicles braked now for every conflict five seconds ahead.
    """
    if steps >= futures.steps:
        return brake(futures, adjustable, may_brake_for, stop_m, side_m, must_yield)
    near = brake(futures.first(steps), adjustable, may_brake_for, stop_m, side_m, must_yield)
    slowed, paths, dt = futures.copy(), PlannedPaths(futures), futures.dt_s
    driven = near.futures.travelled_m()
    for row in np.flatnonzero(near.braked).tolist():
        speed = near.futures.speed_mps[row, -1]
        s = driven[row, -1] + speed * dt * np.arange(1, futures.steps - steps + 1)
        xy, yaw = paths.at(row, s)
        stride = np.diff(np.minimum(s, paths.s_m[row, -1]), prepend=driven[row, -1])
        tail = xy, yaw, np.maximum(stride, 0.0) / dt
        head = near.futures.xy_m[row, 1:], near.futures.yaw_rad[row, 1:], near.futures.speed_mps[row, 1:]
        slowed.put(row, *(np.concatenate(pair) for pair in zip(head, tail, strict=True)))
    return Braked(slowed, near.braked, near.unsolved)


def brake(
    futures: Futures,
    adjustable: BoolArray,
    may_brake_for: BoolArray,
    stop_m: FloatArray,
    side_m: FloatArray | None = None,
    must_yield: BoolArray | None = None,
) -> Braked:
    """Return *futures* slowed so that no footprints overlap, as far as braking can achieve it.

    Args:
        futures: plans and predictions of N road users.
        adjustable: (N,) whether the road user's speeds may be changed.
        may_brake_for: (N, N) whether the first road user may have to brake for the second.
        stop_m: (N,) distance along the own path that must not be passed; inf: none.
        side_m: (N,) lateral clearance that each keeps and that the others keep to it; None: ``SIDE_M``.
        must_yield: (N, N) whether the second has the right of way over the first; None: no one has.
    """
    rights = np.zeros_like(may_brake_for) if must_yield is None else must_yield
    sides = np.full(futures.agents, SIDE_M) if side_m is None else side_m
    slowed = futures.copy()
    paths = PlannedPaths(futures)
    count = len(adjustable)
    braked, unsolved = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_)
    for _ in range(_MAX_ROUNDS):
        must_brake = _conflicts(slowed, may_brake_for & adjustable[:, None], adjustable, sides, rights)
        passes_stop = adjustable & (slowed.travelled_m()[:, -1] > stop_m) & ~unsolved
        rows = np.flatnonzero(must_brake.any(axis=1) | passes_stop)
        if not len(rows):
            break
        has_changed, previous = False, slowed.copy()
        for row in rows.tolist():
            obstacles = np.flatnonzero(must_brake[row])
            is_clear, was_slowed = _slow_down(slowed, previous, paths, row, obstacles, stop_m[row], sides)
            unsolved[row] = not is_clear
            braked[row] |= was_slowed
            has_changed |= was_slowed
        if not has_changed:
            break
    return Braked(slowed, braked, unsolved & braked)


@dataclass(frozen=True)
class _Boxes:
    """Boxes of N road users: centres (N, …, 2), headings (N, …), half length and width (N, 2)."""

    xy_m: FloatArray
    yaw_rad: FloatArray
    half_m: FloatArray

    @staticmethod
    def at_present(futures: Futures) -> _Boxes:
        return _Boxes(futures.xy_m[:, 0], futures.yaw_rad[:, 0], 0.5 * futures.size_m)

    @staticmethod
    def at_half_steps(futures: Futures) -> _Boxes:
        return _Boxes(*futures.halves(), 0.5 * futures.size_m)

    def rows(self, rows: IntArray) -> _Boxes:
        return _Boxes(self.xy_m[rows], self.yaw_rad[rows], self.half_m[rows])

    def gaps(self, other: _Boxes, clearance_m: FloatArray) -> FloatArray:
        """Return the gaps (N, …) from the boxes, grown by *clearance_m* (N, 2) along and across, to *other*."""
        extra = (1,) * (self.yaw_rad.ndim - 1)
        grown = (self.half_m + clearance_m).reshape(len(self.half_m), *extra, 2)
        half = other.half_m.reshape(len(other.half_m), *extra, 2)
        gaps = axis_gaps(other.xy_m - self.xy_m, self.yaw_rad, grown, other.yaw_rad, half)[0]
        return np.asarray(gaps.max(-1))


def _conflicts(
    futures: Futures,
    may_brake_for: BoolArray,
    adjustable: BoolArray,
    side_m: FloatArray,
    must_yield: BoolArray,
) -> BoolArray:
    """Return (N, N) whether the first road user must brake for the second; the arguments are those of `brake`."""
    boxes = _Boxes.at_half_steps(futures)
    reach = 0.5 * np.hypot(*futures.size_m.T) + 0.5 * GAP_M
    must_brake = np.zeros_like(may_brake_for)
    relevant = np.triu(may_brake_for | may_brake_for.T, k=1)
    distance = np.linalg.norm(boxes.xy_m[:, None] - boxes.xy_m[None], axis=-1).min(axis=-1)
    first, second = np.nonzero(relevant & (distance < reach[:, None] + reach))
    if not len(first):
        return must_brake
    clearance, overlaps_now = _clearances(futures, first, second, side_m)
    overlaps = boxes.rows(first).gaps(boxes.rows(second), clearance) < 0.0
    collides = overlaps.any(axis=1) & ~overlaps_now
    first, second, when = first[collides], second[collides], overlaps[collides].argmax(axis=1)
    when = np.maximum(when - 1, 0)  # just before the overlap, when the bearings are still meaningful
    offset = boxes.xy_m[second, when] - boxes.xy_m[first, when]
    offset /= np.maximum(np.linalg.norm(offset, axis=-1, keepdims=True), 1e-9)
    # cosines of the bearings of the second from the first, and of the first from the second
    bearing = (offset * unit(boxes.yaw_rad[first, when])).sum(-1)
    bearing_back = -(offset * unit(boxes.yaw_rad[second, when])).sum(-1)
    must_brake[first, second] = bearing >= bearing_back - _BEARING_TOLERANCE
    must_brake[second, first] = bearing_back >= bearing - _BEARING_TOLERANCE
    must_brake[first, second] |= ~adjustable[second] & (bearing > _IN_FRONT_COS)
    must_brake[second, first] |= ~adjustable[first] & (bearing_back > _IN_FRONT_COS)
    stationary = futures.travelled_m()[:, -1] <= _STATIONARY_M
    one_moves = stationary[first] != stationary[second]
    must_brake[first[one_moves], second[one_moves]] = stationary[second[one_moves]]
    must_brake[second[one_moves], first[one_moves]] = stationary[first[one_moves]]
    must_brake &= may_brake_for
    less_ahead = bearing < bearing_back
    _resolve_deadlocks(futures, must_brake, (first, second), less_ahead, clearance[collides], must_yield)
    return must_brake


def _resolve_deadlocks(
    futures: Futures,
    must_brake: BoolArray,
    pairs: tuple[IntArray, IntArray],
    first_less_ahead: BoolArray,
    clearance_m: FloatArray,
    must_yield: BoolArray,
) -> None:
    """Let one of two vehicles go that would wait for each other for ever; in place.

    Such pairs must brake for each other, both plan to move, and one of them stands or must yield. The vehicle goes
    whose plan leads past the present box of the other. If both or neither does, the right of way decides, then which
    one moves already, then which one has the other less directly in front of it. No vehicle goes if the other one is
    faster than ``WALKS_MPS``.

    Args:
        futures: plans of N road users.
        must_brake: (N, N) whether the first must brake for the second.
        pairs: (P,) rows of the first vehicles and (P,) of the second ones.
        first_less_ahead: (P,) whether the first has the second less directly in front of it than vice versa.
        clearance_m: (P, 2) clearance along and across.
        must_yield: (N, N) whether the second has the right of way over the first.
    """
    first, second = pairs
    sets_off, speed = futures.travelled_m()[:, -1] > _SETS_OFF_M, futures.speed_mps[:, 0]
    deadlocked = must_brake[first, second] & must_brake[second, first] & sets_off[first] & sets_off[second]
    one_yields = must_yield[first, second] != must_yield[second, first]
    deadlocked &= one_yields | (np.minimum(speed[first], speed[second]) < STANDS_MPS)
    if not deadlocked.any():
        return
    first, second, clearance = first[deadlocked], second[deadlocked], clearance_m[deadlocked]
    stands, slow = speed < STANDS_MPS, speed < WALKS_MPS
    first_moves = np.where(stands[first] == stands[second], first_less_ahead[deadlocked], ~stands[first])
    first_has_priority = np.where(one_yields[deadlocked], must_yield[second, first], first_moves)
    first_passes = _passes(futures, first, second, clearance)
    second_passes = _passes(futures, second, first, clearance)
    first_goes = np.where(first_passes == second_passes, first_has_priority, first_passes)
    waiting = np.where(first_goes, second, first)
    going = np.where(first_goes, first, second)
    going, waiting = going[slow[waiting]], waiting[slow[waiting]]
    must_brake[going, waiting] = False


def _passes(futures: Futures, first: IntArray, second: IntArray, clearance_m: FloatArray) -> BoolArray:
    """Return (P,) whether the plans of *first* (P,) lead past the present boxes of *second* (P,)."""
    moving = _Boxes.at_half_steps(futures).rows(first)
    yaw = np.broadcast_to(futures.yaw_rad[second, :1], moving.yaw_rad.shape)
    fixed = _Boxes(futures.xy_m[second, :1], yaw, 0.5 * futures.size_m[second])
    return np.asarray((moving.gaps(fixed, clearance_m) >= 0.0).all(axis=1))


def _clearances(
    futures: Futures, first: IntArray, second: IntArray, side_m: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return the clearance (P, 2) to keep in each pair, at most the present one, and (P,) whether they overlap now."""
    present = _Boxes.at_present(futures)
    first_boxes, second_boxes = present.rows(first), present.rows(second)
    side = np.maximum(side_m[first], side_m[second])
    slow = futures.speed_mps[:, 0] < WALKS_MPS
    side = np.where((side <= SIDE_M) & slow[first] & slow[second], _SLOW_SIDE_M, side)
    full = np.stack((np.full(len(first), GAP_M), side), axis=-1)
    clearance = np.zeros_like(full)
    for share in reversed(_CLEARANCE_SHARES):
        fits = first_boxes.gaps(second_boxes, share * full) >= 0.0
        clearance[fits] = share * full[fits]
    return clearance, first_boxes.gaps(second_boxes, np.zeros_like(full)) < 0.0


def _slow_down(
    futures: Futures,
    previous: Futures,
    paths: PlannedPaths,
    row: int,
    obstacles: IntArray,
    stop_m: float,
    side_m: FloatArray,
) -> tuple[bool, bool]:
    """Let *row* brake as mildly as suffices to avoid *obstacles*, as they are in *previous*, in place.

    Returns:
        Whether it avoids them and the stop line, and whether its plan was changed.
    """
    driven = _braking_profiles(previous, row)  # (C, T)
    is_clear = driven[:, -1] <= stop_m
    first_overlap = np.full(len(driven), np.inf)
    if len(obstacles):
        first_overlap = _first_overlaps(previous, paths, row, obstacles, driven, side_m)
        is_clear &= np.isinf(first_overlap)
    if is_clear.any():
        chosen = int(is_clear.argmax())
    elif len(obstacles):  # the one that collides last, of several the hardest braking
        chosen = int(np.argmax(first_overlap + 1e-3 * np.arange(len(first_overlap))))
    else:
        chosen = len(driven) - 1
    if chosen == 0:
        return bool(is_clear[0]), False
    drive_along(futures, paths, row, driven[chosen])
    return bool(is_clear[chosen]), True


def _braking_profiles(futures: Futures, row: int) -> FloatArray:
    """Return distances driven (C, T): as planned, then for each deceleration, at most as planned."""
    planned = futures.travelled_m()[row, 1:]
    speed = futures.speed_mps[row, 0]
    time = futures.dt_s * np.arange(1, futures.steps + 1)
    rate = np.array(LADDER_MPS2)[:, None]
    moving = np.minimum(time, speed / np.maximum(rate, 1e-9))
    braked = speed * moving - 0.5 * rate * moving**2
    return np.vstack((planned, np.minimum(planned, braked)))


def _first_overlaps(
    futures: Futures,
    paths: PlannedPaths,
    row: int,
    obstacles: IntArray,
    driven_m: FloatArray,
    side_m: FloatArray,
) -> FloatArray:
    """Return (C,) the half step at which each profile *driven_m* (C, T) first meets an obstacle; inf: never."""
    begin = np.hstack((np.zeros((len(driven_m), 1)), driven_m[:, :-1]))
    half_steps = np.empty((len(driven_m), 2 * futures.steps))
    half_steps[:, ::2], half_steps[:, 1::2] = 0.5 * (begin + driven_m), driven_m
    xy, yaw = paths.at(row, half_steps)
    all_xy, all_yaw = futures.halves()
    clearances, _ = _clearances(futures, np.full(len(obstacles), row), obstacles, side_m)
    half = 0.5 * futures.size_m
    overlaps = np.zeros(half_steps.shape, dtype=np.bool_)
    for obstacle, clearance in zip(obstacles.tolist(), clearances, strict=True):
        other_yaw = np.broadcast_to(all_yaw[obstacle], yaw.shape)
        gaps = axis_gaps(all_xy[obstacle] - xy, yaw, half[row] + clearance, other_yaw, half[obstacle])[0]
        overlaps |= gaps.max(-1) < 0.0
    return np.where(overlaps.any(axis=1), overlaps.argmax(axis=1), np.inf)
