"""Brakes planned vehicles along their own paths where plans would run through each other or a stop line.

Who brakes: of two whose boxes would meet, the one that has the other before its front; both where neither or both
have. For one that stays where it is everybody brakes whom it meets: the middle of a bus is beside who drives into its
front corner. Of two that would stay for each other one goes: who gets past the other, has the right of way, or moves.
For one whose speed is not ours to change everybody brakes that has it before its front, even if it ought to brake
itself. Nobody brakes for a vehicle that comes from behind, and attackers never brake for the target.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.boxes import axis_gaps
from advdiff_sumo.core.frames import unit
from advdiff_sumo.traffic.planning.futures import STANDS_MPS, WALKS_MPS, Futures
from advdiff_sumo.traffic.planning.planned_paths import PlannedPaths, speeds_of_strides

LADDER_MPS2 = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.5, 7.0, 8.5)
"""Decelerations that are tried, the mildest that helps is taken; before them the plan itself."""
GAP_M = 1.0
"""Room that is kept before and behind a vehicle, where there is any."""
SIDE_M = 0.15
"""Room that is kept on each side."""
_TIGHT_SIDE_M = 0.05
"""The same between two vehicles that are both slow: who creeps past another one goes by with less."""
_SHARES = (1.0, 0.5, 0.25, 0.1)
"""Shares of that room that are tried where two are nearer than it now."""
_SAME_BEARING, _BEFORE_FRONT = 0.15, 0.3
_STARTS_M, _STAYS_M = 0.3, 0.01
_ROUNDS = 3


@dataclass(frozen=True)
class Braked:
    """What became of the plans.

    Attributes:
        futures: with new speeds where somebody had to brake.
        rows: (N,) who had to.
        unsolved: (N,) whose box still meets another one's, however hard it brakes.
    """

    futures: Futures
    rows: BoolArray
    unsolved: BoolArray


def brake_ahead(
    futures: Futures,
    may: BoolArray,
    minds: BoolArray,
    stop_m: FloatArray,
    steps: int,
    side_m: FloatArray | None = None,
    yields: BoolArray | None = None,
) -> Braked:
    """Return :func:`brake` of the first *steps* instants; who braked goes on from there at the speed it has then.

    What is to happen later is drawn anew before it happens: two vehicles that would meet in five seconds are no
    reason to brake today, and braking for all of them makes traffic stand still.
    """
    if steps >= futures.steps:
        return brake(futures, may, minds, stop_m, side_m, yields)
    near = brake(futures.first(steps), may, minds, stop_m, side_m, yields)
    slowed, path, dt = futures.copy(), PlannedPaths(futures), futures.dt_s
    driven = near.futures.travelled_m()
    for row in np.flatnonzero(near.rows).tolist():
        speed = near.futures.speed_mps[row, -1]
        further = driven[row, -1] + speed * dt * np.arange(1, futures.steps - steps + 1)
        xy, yaw = path.at(row, further)
        stride = np.diff(np.minimum(further, path.s_m[row, -1]), prepend=driven[row, -1])
        tail = xy, yaw, np.maximum(stride, 0.0) / dt
        head = near.futures.xy_m[row, 1:], near.futures.yaw_rad[row, 1:], near.futures.speed_mps[row, 1:]
        slowed.put(row, *(np.concatenate(pair) for pair in zip(head, tail, strict=True)))
    return Braked(slowed, near.rows, near.unsolved)


def brake(
    futures: Futures,
    may: BoolArray,
    minds: BoolArray,
    stop_m: FloatArray,
    side_m: FloatArray | None = None,
    yields: BoolArray | None = None,
) -> Braked:
    """Return *futures* in which no two boxes meet, as far as braking can do it.

    Args:
        futures: plans and predictions of N road users.
        may: (N,) whose speeds may be changed.
        minds: (N, N) whether the first gives way to the second at all.
        stop_m: (N,) distance along the own path that must not be passed; inf for none.
        side_m: (N,) room that is kept to each, and by each, on its sides; None: ``SIDE_M``.
        yields: (N, N) whether the second has the right of way over the first; None: nobody has.
    """
    rights = np.zeros_like(minds) if yields is None else yields
    sides = np.full(futures.agents, SIDE_M) if side_m is None else side_m
    eased = futures.copy()
    path = PlannedPaths(futures)
    braked, unsolved = np.zeros(len(may), dtype=np.bool_), np.zeros(len(may), dtype=np.bool_)
    for _ in range(_ROUNDS):
        pairs = _conflicts(eased, minds & may[:, None], may, sides, rights)
        late = may & (path.length_m(eased) > stop_m) & ~unsolved
        rows = np.flatnonzero(pairs.any(axis=1) | late)
        if not len(rows):
            break
        changed, before = False, eased.copy()
        for row in rows.tolist():
            others = np.flatnonzero(pairs[row])
            ok, moved = _ease(eased, before, path, row, others, float(stop_m[row]), sides)
            unsolved[row] = not ok
            braked[row] |= moved
            changed |= moved
        if not changed:
            break
    return Braked(eased, braked, unsolved & braked)


@dataclass(frozen=True)
class _Boxes:
    """Boxes of N road users: centres (N, …, 2), headings (N, …), half length and width (N, 2)."""

    xy_m: FloatArray
    yaw_rad: FloatArray
    half_m: FloatArray

    @staticmethod
    def now(futures: Futures) -> _Boxes:
        return _Boxes(futures.xy_m[:, 0], futures.yaw_rad[:, 0], 0.5 * futures.size_m)

    @staticmethod
    def later(futures: Futures) -> _Boxes:
        return _Boxes(*futures.halves(), 0.5 * futures.size_m)

    def rows(self, rows: IntArray) -> _Boxes:
        return _Boxes(self.xy_m[rows], self.yaw_rad[rows], self.half_m[rows])

    def gaps(self, other: _Boxes, room_m: FloatArray) -> FloatArray:
        """Return the separation (N, …) of each box, grown by *room_m* (N, 2) along and across, from the other's."""
        extra = (1,) * (self.yaw_rad.ndim - 1)
        grown = (self.half_m + room_m).reshape(len(self.half_m), *extra, 2)
        half = other.half_m.reshape(len(other.half_m), *extra, 2)
        gaps = axis_gaps(other.xy_m - self.xy_m, self.yaw_rad, grown, other.yaw_rad, half)[0]
        return np.asarray(gaps.max(-1))


def _conflicts(
    futures: Futures, minds: BoolArray, may: BoolArray, side_m: FloatArray, yields: BoolArray
) -> BoolArray:
    """Return (N, N) whether the first has to brake for the second, of whom *may* (N,) can be asked to."""
    boxes = _Boxes.later(futures)
    reach = 0.5 * np.hypot(*futures.size_m.T) + 0.5 * GAP_M
    out = np.zeros_like(minds)
    either = np.triu(minds | minds.T, k=1)
    apart = np.linalg.norm(boxes.xy_m[:, None] - boxes.xy_m[None], axis=-1).min(axis=-1)
    first, second = np.nonzero(either & (apart < reach[:, None] + reach))
    if not len(first):
        return out
    room, inside = _room(futures, first, second, side_m)
    meets = boxes.rows(first).gaps(boxes.rows(second), room) < 0.0
    hit = meets.any(axis=1) & ~inside
    first, second, when = first[hit], second[hit], meets[hit].argmax(axis=1)
    when = np.maximum(when - 1, 0)  # just before, when it still shows who is where
    offset = boxes.xy_m[second, when] - boxes.xy_m[first, when]
    offset /= np.maximum(np.linalg.norm(offset, axis=-1, keepdims=True), 1e-9)
    mine = (offset * unit(boxes.yaw_rad[first, when])).sum(-1)
    yours = -(offset * unit(boxes.yaw_rad[second, when])).sum(-1)
    out[first, second] = (mine >= yours - _SAME_BEARING) | (~may[second] & (mine > _BEFORE_FRONT))
    out[second, first] = (yours >= mine - _SAME_BEARING) | (~may[first] & (yours > _BEFORE_FRONT))
    stays = futures.travelled_m()[:, -1] <= _STAYS_M
    one = stays[first] != stays[second]
    out[first[one], second[one]] = stays[second[one]]
    out[second[one], first[one]] = stays[first[one]]
    out &= minds
    _one_goes(futures, out, (first, second), mine < yours, room[hit], yields)
    return out


def _one_goes(
    futures: Futures,
    brakes: BoolArray,
    pairs: tuple[IntArray, IntArray],
    less_squarely: BoolArray,
    room_m: FloatArray,
    yields: BoolArray,
) -> None:
    """Let one of two go that would stay for each other for ever; in place.

    These are two of whom one stands, or must yield. It is the one whose way leads past the other as that is now; where
    that holds for both or neither, the one with the right of way, that moves already, or that has the other less
    squarely before it. Nobody sets off before one that is no longer slow.

    Args:
        futures: plans of N road users.
        brakes: (N, N) who has to brake for whom.
        pairs: (P,) rows of the first ones and of the second ones.
        less_squarely: (P,) whether the first one has the second one less squarely before it.
        room_m: (P, 2) room to keep, along and across.
        yields: (N, N) whether the second has the right of way over the first.
    """
    first, second = pairs
    starts, speed = futures.travelled_m()[:, -1] > _STARTS_M, futures.speed_mps[:, 0]
    both = brakes[first, second] & brakes[second, first] & starts[first] & starts[second]
    one_yields = yields[first, second] != yields[second, first]
    both &= one_yields | (np.minimum(speed[first], speed[second]) < STANDS_MPS)
    if not both.any():
        return
    first, second, room, one_yields = first[both], second[both], room_m[both], one_yields[both]
    stands, slow = speed < STANDS_MPS, speed < WALKS_MPS
    moves = np.where(stands[first] == stands[second], less_squarely[both], ~stands[first])
    right = np.where(one_yields, yields[second, first], moves)
    passes = _passes(futures, first, second, room)
    first_goes = np.where(passes == _passes(futures, second, first, room), right, passes)
    waits = np.where(first_goes, second, first)
    goes = np.where(first_goes, first, second)
    goes, waits = goes[slow[waits]], waits[slow[waits]]
    brakes[goes, waits] = False


def _passes(futures: Futures, first: IntArray, second: IntArray, room_m: FloatArray) -> BoolArray:
    """Return (P,) whether the first ones' plans lead past the boxes that the second ones have now."""
    driven = _Boxes.later(futures).rows(first)
    yaw = np.broadcast_to(futures.yaw_rad[second, :1], driven.yaw_rad.shape)
    still = _Boxes(futures.xy_m[second, :1], yaw, 0.5 * futures.size_m[second])
    return np.asarray((driven.gaps(still, room_m) >= 0.0).all(axis=1))


def _room(
    futures: Futures, first: IntArray, second: IntArray, side_m: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return (P, 2) the room to keep in each pair, as much of it as there is now, and (P,) who overlaps now."""
    now = _Boxes.now(futures)
    mine, yours = now.rows(first), now.rows(second)
    side = np.maximum(side_m[first], side_m[second])
    slow = futures.speed_mps[:, 0] < WALKS_MPS
    side = np.where((side <= SIDE_M) & slow[first] & slow[second], _TIGHT_SIDE_M, side)
    full = np.stack((np.full(len(first), GAP_M), side), axis=-1)
    room = np.zeros_like(full)
    for share in reversed(_SHARES):
        there = mine.gaps(yours, share * full) >= 0.0
        room[there] = share * full[there]
    return room, mine.gaps(yours, np.zeros_like(full)) < 0.0


def _ease(
    futures: Futures,
    before: Futures,
    path: PlannedPaths,
    row: int,
    others: IntArray,
    stop_m: float,
    side_m: FloatArray,
) -> tuple[bool, bool]:
    """Let *row* brake as mildly as keeps it clear of *others* as they were *before*, in place.

    Returns whether it is clear, and whether it changed.
    """
    driven = _ladder(before, row)  # (C, T)
    clear = driven[:, -1] <= stop_m
    free = np.full(len(driven), np.inf)
    if len(others):
        free = _clear_steps(before, path, row, others, driven, side_m)
        clear &= np.isinf(free)
    best = int(clear.argmax()) if clear.any() else int(np.argmax(free + 1e-3 * np.arange(len(free))))
    if not clear.any() and not len(others):
        best = len(driven) - 1
    if best == 0:
        return bool(clear[0]), False
    xy, yaw = path.at(row, driven[best])
    futures.put(row, xy, yaw, speeds_of_strides(np.diff(driven[best], prepend=0.0), futures.dt_s))
    return bool(clear[best]), True


def _ladder(futures: Futures, row: int) -> FloatArray:
    """Return distances driven (C, T): by the plan as it is, then by the plan or a deceleration, what is less."""
    planned = futures.travelled_m()[row, 1:]
    speed = futures.speed_mps[row, 0]
    time = futures.dt_s * np.arange(1, futures.steps + 1)
    rate = np.array(LADDER_MPS2)[:, None]
    moving = np.minimum(time, speed / np.maximum(rate, 1e-9))
    braked = speed * moving - 0.5 * rate * moving**2
    return np.vstack((planned, np.minimum(planned, braked)))


def _clear_steps(
    futures: Futures, path: PlannedPaths, row: int, others: IntArray, driven: FloatArray, side_m: FloatArray
) -> FloatArray:
    """Return (C,) the half step at which a ladder's rung first meets one of *others*; inf where it never does."""
    begin = np.hstack((np.zeros((len(driven), 1)), driven[:, :-1]))
    halves = np.empty((len(driven), 2 * futures.steps))
    halves[:, ::2], halves[:, 1::2] = 0.5 * (begin + driven), driven
    xy, yaw = path.at(row, halves)
    all_xy, all_yaw = futures.halves()
    room, _ = _room(futures, np.full(len(others), row), others, side_m)
    half = 0.5 * futures.size_m
    meets = np.zeros(halves.shape, dtype=np.bool_)
    for other, wide in zip(others.tolist(), room, strict=True):
        turned = np.broadcast_to(all_yaw[other], yaw.shape)
        meets |= axis_gaps(all_xy[other] - xy, yaw, half[row] + wide, turned, half[other])[0].max(-1) < 0.0
    return np.where(meets.any(axis=1), meets.argmax(axis=1), np.inf)
