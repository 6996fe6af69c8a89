"""Find every collision between any two agents in a recorded episode."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.boxes import axis_gaps
from advdiff_sumo.core.record import Controller, EpisodeRecord
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.metrics.continuous_collision import TOUCH_M, BoxMotion, first_contact, may_touch
from advdiff_sumo.metrics.kinematics import unbroken_steps
from advdiff_sumo.metrics.target_contact import SEPARATED_M, contact_of

#: Steps searched at once: in so short a time few pairs of agents come near each other.
_CHUNK = 20
#: A face was hit flat, not at a corner, if its normal differs by at most this from the contact normal.
SAME_AXIS_RAD = 0.17


@dataclass(frozen=True)
class Collision:
    """One collision of two agents, from first contact until they separate.

    Attributes:
        rows: their rows; the target first if it takes part, else in ascending order.
        step: instant before the contact.
        fraction: share of the step from there to the contact, in [0, 1).
        time_s: time of the contact since the episode's start.
        point_m: (2,) centroid of the contact region.
        penetration_m: deepest overlap within the step of the contact.
        initial: whether the agents overlapped already when they were first present together (logs, insertions).
        xy_m: (2, 2) centres at the contact, in the order of *rows*.
        yaw_rad: (2,) headings at the contact.
        velocity_mps: (2, 2) velocities over the step of the contact.
        normal: (2,) unit contact normal, from the first agent to the second.
        faces: side of each agent at the contact: "front", "rear", "left", "right".
    """

    rows: tuple[int, int]
    step: int
    fraction: float
    time_s: float
    point_m: FloatArray
    penetration_m: float
    initial: bool
    xy_m: FloatArray
    yaw_rad: FloatArray
    velocity_mps: FloatArray
    normal: FloatArray
    faces: tuple[str, str]

    @property
    def relative_speed_mps(self) -> float:
        """Norm of the difference of the velocities."""
        return float(np.hypot(*(self.velocity_mps[0] - self.velocity_mps[1])))

    @property
    def closing_speed_mps(self) -> float:
        """Relative speed along the contact normal, positive when the boxes approach."""
        return float((self.velocity_mps[0] - self.velocity_mps[1]) @ self.normal)

    @cached_property
    def heading_difference_rad(self) -> float:
        """Absolute difference of the headings, in [0, π]."""
        return float(abs(np.angle(np.exp(1j * (self.yaw_rad[1] - self.yaw_rad[0])))))


@dataclass(frozen=True)
class Touches:
    """Steps in which pairs are in contact, sorted by pair and step; M entries.

    Attributes:
        first: (M,) lower row.
        second: (M,) higher row.
        step: (M,) instant at which the step begins.
        fraction: (M,) share of the step until contact; 0 if they overlap already.
        end_gap_m: (M,) gap at the end of the step, negative where the boxes overlap.
    """

    first: IntArray
    second: IntArray
    step: IntArray
    fraction: FloatArray
    end_gap_m: FloatArray


def collisions(record: EpisodeRecord, touches: Touches | None = None) -> list[Collision]:
    """Return every collision of any two agents, sorted by time, then rows.

    A lasting collision counts once until the boxes are ``SEPARATED_M`` apart. Steps in which an agent jumps or is
    absent are not searched; the next step starts anew. SUMO lets pedestrians pass through each other: if it moves both,
    that is no collision. Pass *touches* if they have been found already.
    """
    contacts = tracks_collisions(record.tracks, record.target, touches)
    return [c for c in contacts if not both_walk(record, c.rows[0], c.rows[1], c.step)]


def both_walk(record: EpisodeRecord, i: int, j: int, step: int) -> bool:
    """Return whether rows *i* and *j* are pedestrians moved by SUMO at instant *step*."""
    pair = [i, j]
    are_pedestrians = (record.tracks.classes[pair] == AgentClass.PEDESTRIAN).all()
    return bool(are_pedestrians and (record.controller[pair, step] == Controller.SUMO).all())


def tracks_collisions(tracks: Tracks, target: int, touches: Touches | None = None) -> list[Collision]:
    """Return every collision of *tracks*, recorded or planned, as :func:`collisions` does; *target* is a row."""
    usable = unbroken_steps(tracks)
    touches = touches if touches is not None else find_touches(tracks)
    contacts = [
        _collision(tracks, target, usable, touches, i) for i in _first_touches(tracks, usable, touches)
    ]
    return sorted(contacts, key=lambda c: (c.time_s, c.rows))


def target_collision(record: EpisodeRecord, collisions: list[Collision]) -> Collision | None:
    """Return the target's first collision among *collisions* that is not ``initial``; None without one."""
    return next((c for c in collisions if c.rows[0] == record.target and not c.initial), None)


def overlapping_steps(touches: Touches) -> set[tuple[int, int, int]]:
    """Return (instant, row, row) of every pair that overlaps at the instant or came into contact in the step before.

    A check once per step, such as SUMO's, should have reported these. Rows ascend within a pair. Instant 0, before the
    first step, is left out.
    """
    first, second, step = touches.first, touches.second, touches.step
    begins = touches.fraction > 0.0
    at_end = begins | (touches.end_gap_m < -TOUCH_M)
    entries = zip(
        np.concatenate((step[~begins], step[at_end] + 1)).tolist(),
        np.concatenate((first[~begins], first[at_end])).tolist(),
        np.concatenate((second[~begins], second[at_end])).tolist(),
        strict=True,
    )
    return {entry for entry in entries if entry[0] > 0}


def find_touches(tracks: Tracks) -> Touches:
    """Return every step in which two agents of *tracks* are in contact."""
    parts = [_touches_of(tracks, *chunk) for chunk in _candidates(tracks, unbroken_steps(tracks))]
    first, second, step, fraction = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.lexsort((step, second, first))
    first, second, step = first[order], second[order], step[order]
    return Touches(first, second, step, fraction[order], _gaps(tracks, first, second, step + 1))


def _gaps(tracks: Tracks, i: IntArray, j: IntArray, k: IntArray) -> FloatArray:
    """Return the gaps (M,) of agents *i* and *j* at instants *k*, each (M,)."""
    half = 0.5 * tracks.size_m
    offset = tracks.xy_m[j, k] - tracks.xy_m[i, k]
    gaps, _, _ = axis_gaps(offset, tracks.yaw_rad[i, k], half[i], tracks.yaw_rad[j, k], half[j])
    return np.asarray(gaps.max(-1))


def _candidates(tracks: Tracks, usable: BoolArray) -> Iterator[tuple[IntArray, IntArray, IntArray]]:
    """Yield pairs and steps whose circles may meet; the first yield is empty, so that there is always one."""
    empty = np.zeros(0, dtype=np.int64)
    yield empty, empty, empty
    first, second = np.triu_indices(tracks.agents, 1)
    half = 0.5 * tracks.size_m[:, None, :]
    for start in range(0, usable.shape[1], _CHUNK):
        usable_here = usable[:, start : start + _CHUNK]
        stop = start + usable_here.shape[1]
        near_pairs = _bounds_overlap(tracks, start, stop, first, second)
        i, j = first[near_pairs], second[near_pairs]
        begin, end = tracks.xy_m[:, start:stop], tracks.xy_m[:, start + 1 : stop + 1]
        yaw = tracks.yaw_rad[:, start:stop]
        motion = BoxMotion(begin, yaw, end - begin, yaw, half)  # may_touch ignores headings and turns
        near = may_touch(motion.rows(i), motion.rows(j)) & usable_here[i] & usable_here[j]
        pair, step = np.nonzero(near)
        yield i[pair], j[pair], step + start


def _bounds_overlap(tracks: Tracks, start: int, stop: int, first: IntArray, second: IntArray) -> BoolArray:
    """Return (P,) whether the bounding rectangles of two agents over the steps *start* to *stop* overlap."""
    xy = tracks.xy_m[:, start : stop + 1]
    radius = 0.5 * np.hypot(tracks.size_m[:, 0], tracks.size_m[:, 1])[:, None] + TOUCH_M
    low, high = np.fmin.reduce(xy, axis=1) - radius, np.fmax.reduce(xy, axis=1) + radius
    return np.asarray(((low[first] <= high[second]) & (low[second] <= high[first])).all(-1))


def _touches_of(
    tracks: Tracks, first: IntArray, second: IntArray, step: IntArray
) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
    fraction = first_contact(BoxMotion.of(tracks, first, step), BoxMotion.of(tracks, second, step))
    hit = ~np.isnan(fraction)
    return first[hit], second[hit], step[hit], fraction[hit]


def _first_touches(tracks: Tracks, usable: BoolArray, touches: Touches) -> list[int]:
    """Return the indices in *touches* at which a new collision begins."""
    same_pair = (np.diff(touches.first) == 0) & (np.diff(touches.second) == 0)
    near = same_pair & (touches.end_gap_m[:-1] <= SEPARATED_M)
    continues = near & (np.diff(touches.step) == 1)
    for index in np.flatnonzero(near & ~continues):
        i, j = int(touches.first[index]), int(touches.second[index])
        continues[index] = _stay_near(tracks, usable, i, j, touches.step[index], touches.step[index + 1])
    return [0, *(np.flatnonzero(~continues) + 1).tolist()] if len(touches.step) else []


def _stay_near(tracks: Tracks, usable: BoolArray, i: int, j: int, since: int, until: int) -> bool:
    """Return whether a pair that touched in step *since* was never separated before step *until*."""
    if not (usable[i, since : until + 1] & usable[j, since : until + 1]).all():
        return False
    instants = np.arange(since + 1, until + 1)
    pair = np.full(len(instants), i), np.full(len(instants), j)
    return bool((_gaps(tracks, *pair, instants) <= SEPARATED_M).all())


def _collision(tracks: Tracks, target: int, usable: BoolArray, touches: Touches, index: int) -> Collision:
    """Return the collision that begins at *index* of *touches*."""
    i, j, step = int(touches.first[index]), int(touches.second[index]), int(touches.step[index])
    rows = (j, i) if j == target else (i, j)
    fraction = float(touches.fraction[index])
    pair = BoxMotion.of(tracks, np.array(rows), np.array([step, step]))
    a, b = pair.rows(np.array([0])), pair.rows(np.array([1]))
    contact = contact_of(a, b, fraction, rows[1])
    xy, yaw = pair.pose(fraction)
    normal, faces = _contact_geometry(xy, yaw, pair.half_m, contact.point_m)
    present_before = step > 0 and bool(usable[i, step - 1] and usable[j, step - 1])
    return Collision(
        rows=rows,
        step=step,
        fraction=fraction,
        time_s=tracks.t0_s + (step + fraction) * tracks.dt_s,
        point_m=contact.point_m,
        penetration_m=contact.penetration_m,
        initial=not present_before and fraction == 0.0,
        xy_m=xy,
        yaw_rad=yaw,
        velocity_mps=pair.move_m / tracks.dt_s,
        normal=normal,
        faces=faces,
    )


def _contact_geometry(
    xy_m: FloatArray, yaw_rad: FloatArray, half_m: FloatArray, point_m: FloatArray
) -> tuple[FloatArray, tuple[str, str]]:
    """Return the contact normal (2,) from the first box to the second, and the side at which each box was hit.

    The normal is the separating axis of the largest gap. A box that has this axis itself (within ``SAME_AXIS_RAD``) was
    hit on that face. A box that touched with a corner was hit at its front or rear, whichever is nearer.
    """
    gaps, along, axes = axis_gaps(xy_m[1] - xy_m[0], yaw_rad[0], half_m[0], yaw_rad[1], half_m[1])
    axis = int(np.argmax(gaps))
    normal = np.copysign(1.0, along[axis]) * axes[axis]
    outward = (normal, -normal)
    faces = tuple(
        _face(point_m - xy_m[box], outward[box], axes[2 * box], axes[2 * box + 1]) for box in (0, 1)
    )
    return np.asarray(normal), (faces[0], faces[1])


def _face(arm_m: FloatArray, outward: FloatArray, ahead: FloatArray, left: FloatArray) -> str:
    """Return the side of a box that was hit.

    Args:
        arm_m: (2,) contact point from the centre.
        outward: (2,) contact normal, away from the box.
        ahead: (2,) unit vector to the front.
        left: (2,) unit vector to the left.
    """
    outward_ahead, outward_left = float(outward @ ahead), float(outward @ left)
    if abs(outward_ahead) >= np.cos(SAME_AXIS_RAD):
        return "front" if outward_ahead > 0.0 else "rear"
    if abs(outward_left) >= np.cos(SAME_AXIS_RAD):
        return "left" if outward_left > 0.0 else "right"
    return "front" if float(arm_m @ ahead) > 0.0 else "rear"
