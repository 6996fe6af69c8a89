"""Critical near misses: a careful driver would have had to brake hard, and who resolved it.

An encounter without a collision is critical when a reference driver in the target's place, who reacts in the
regulation's 0.75 s and then brakes evenly, would have had to brake at more than 4 m/s² for the boxes not to meet.
It takes over where the careful and competent driver would, on the driven path, and from the instant of the least
time to collision on follows the lanes of the target's route: steering is not asked for. The other is taken to move
as recorded up to that instant, and to keep its speed on its recorded way from there on: that it braked afterwards
nobody could rely on. Where the target stands, where the other comes from behind, or into its side at any braking,
braking is not the answer, and the near miss is not critical.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from advdiff_sumo.core.arrays import BoolArray
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.breaches.striking_rules import EXPECTED_BRAKE_MPS2
from advdiff_sumo.metrics.collision import Collision
from advdiff_sumo.metrics.contact import standing_overlaps
from advdiff_sumo.metrics.criticality import time_to_collision
from advdiff_sumo.metrics.encounter import LEAST_SPEED_MPS
from advdiff_sumo.metrics.kept_motion import (
    BRAKES_MPS2,
    Poses,
    braked_s_m,
    contact_at,
    gone_on,
    kept,
    kept_straight,
    velocity_mps,
)
from advdiff_sumo.metrics.reference import ReferenceDrive, ReferenceDrivers
from advdiff_sumo.metrics.reference.own_way import OwnWay, joined_way, way_from

#: A near miss is looked at where the least time to collision is below this.
NEAR_MISS_TTC_S = 2.5
_AFTER_S = 4.0
_REACH_M = 150.0


class ResolvedBy(StrEnum):
    """Who kept a near miss from becoming a collision."""

    TARGET = "target"
    OTHER = "other"
    BOTH = "both"


@dataclass(frozen=True)
class NearMiss:
    """An encounter without a collision.

    Attributes:
        row: the other.
        time_s: instant of the least time to collision with it, since the episode's start.
        brake_mps2: how hard a reference driver would have had to brake; 0 where it needed not, or where braking is
            not the answer.
        resolved_by: who acted so that it did not come to a collision; None where the record ends before it is
            resolved.
    """

    row: int
    time_s: float
    brake_mps2: float
    resolved_by: ResolvedBy | None

    @property
    def critical(self) -> bool:
        """Whether that is more than one may be expected to brake."""
        return self.brake_mps2 > EXPECTED_BRAKE_MPS2


def near_miss(record: EpisodeRecord, road: RoadMap) -> NearMiss | None:
    """Return the near miss of an episode without a collision that asks for the hardest braking; None without one.

    Of several that ask for as much it is the one of the least time to collision.

    Args:
        record: the episode, in which the target did not collide.
        road: its map.
    """
    candidates = [
        (_needed_brake_mps2(record, road, row, step), row, step) for row, step in _candidates(record)
    ]
    if not candidates:
        return None
    brake, row, step = max(candidates, key=lambda x: x[0])
    time_s = record.tracks.t0_s + step * record.tracks.dt_s
    return NearMiss(row, time_s, brake, _resolved_by(record, row, step))


def careful_drive(record: EpisodeRecord, road: RoadMap, missed: NearMiss) -> ReferenceDrive | None:
    """Return what the careful and competent driver would have done in the near miss *missed*; None at the start."""
    step = round((missed.time_s - record.tracks.t0_s) / record.tracks.dt_s)
    return _drive(record, road, missed.row, step)


def resolved(by: str | None) -> str:
    """Return who resolved a near miss as part of a sentence; *by* is a value of :class:`ResolvedBy` or None."""
    return "the record ends before it is resolved" if by is None else f"resolved by: {by}"


def _candidates(record: EpisodeRecord) -> list[tuple[int, int]]:
    """Return (row, instant) of each other's least time to collision that is short, the shortest first.

    Instants at which the target stands, or the other is behind it, do not count: braking is not the answer there.
    Neither do those at which the other, which appeared where the target was, still touches it.
    """
    seconds = time_to_collision(record.tracks, record.target)
    stands = np.abs(record.tracks.speed_mps[record.target]) <= LEAST_SPEED_MPS
    counts = np.isfinite(seconds) & ~stands & ~_behind(record)
    if (seconds == 0.0).any():
        counts &= ~_initial_contacts(record)
    seconds = np.where(counts, seconds, np.inf)
    steps = seconds.argmin(1)
    least = seconds.min(1)
    near = np.flatnonzero(least < NEAR_MISS_TTC_S)
    return [(int(row), int(steps[row])) for row in near[np.argsort(least[near], kind="stable")]]


def _initial_contacts(record: EpisodeRecord) -> BoolArray:
    """Return (A, T) whether the other has touched the target ever since it appeared."""
    tracks = record.tracks
    touches: list[BoolArray] = []
    for step in range(tracks.steps):
        overlaps = standing_overlaps(
            touches[-1] if touches else None,
            tracks.xy_m[:, max(0, step - 1)],
            tracks.xy_m[:, step],
            tracks.yaw_rad[:, step],
            tracks.size_m,
            record.target,
            dt_s=tracks.dt_s,
        )
        touches.append(overlaps)
    return np.stack(touches, axis=1)


def _behind(record: EpisodeRecord) -> BoolArray:
    """Return (A, T) whether the other's centre is behind the target's rear."""
    tracks, target = record.tracks, record.target
    along = ((tracks.xy_m - tracks.xy_m[target]) * unit(tracks.yaw_rad[target])).sum(-1)
    return np.asarray(along < -0.5 * tracks.size_m[target, 0])


def _drive(record: EpisodeRecord, road: RoadMap, row: int, step: int) -> ReferenceDrive | None:
    if step == 0 or not record.tracks.valid[record.target, : step + 1].all():
        return None
    return ReferenceDrivers(record, road, _closest(record, row, step)).drive()


def _closest(record: EpisodeRecord, row: int, step: int) -> Collision:
    """Return what :class:`ReferenceDrivers` takes for the encounter: who, and when it was closest."""
    tracks, rows = record.tracks, [record.target, row]
    offset = tracks.xy_m[row, step] - tracks.xy_m[record.target, step]
    return Collision(
        rows=(record.target, row),
        step=step,
        fraction=0.0,
        time_s=tracks.t0_s + step * tracks.dt_s,
        point_m=tracks.xy_m[record.target, step] + 0.5 * offset,
        penetration_m=0.0,
        initial=False,
        xy_m=tracks.xy_m[rows, step],
        yaw_rad=tracks.yaw_rad[rows, step],
        velocity_mps=np.stack([velocity_mps(tracks, x, step) for x in rows]),
        normal=offset / max(float(np.hypot(*offset)), 1e-9),
        faces=("front", "rear"),
    )


def _needed_brake_mps2(record: EpisodeRecord, road: RoadMap, row: int, step: int) -> float:
    """Return how hard a reference driver would have had to brake for *row*; 0 where braking is not the answer."""
    tracks, target, count = record.tracks, record.target, round(_AFTER_S / record.tracks.dt_s)
    other = kept(record, row, step, step, count)
    going = _driven_poses(record, _own_way(record, road, step, step), step, 0.0, len(other))
    if contact_at(going, other, *tracks.size_m[[target, row]]) is None:
        return 0.0  # only straight on they would have met
    drive = _drive(record, road, row, step)
    if drive is None:
        return 0.0
    start = drive.takeover_step
    way = _own_way(record, road, start, step)
    return _least_brake_mps2(record, way, row, start, kept(record, row, start, step, count))


def _own_way(record: EpisodeRecord, road: RoadMap, start: int, step: int) -> OwnWay:
    """Return the target's driven path from *start* to *step*, and its route's lanes from there on."""
    if start == step:
        return way_from(record, road, step, _REACH_M)
    return joined_way(record, road, start, step, _REACH_M)


def _driven_poses(record: EpisodeRecord, way: OwnWay, start: int, brake_mps2: float, count: int) -> Poses:
    """Return *count* poses of a driver on *way* from instant *start* on, as ``braked_s_m`` says."""
    tracks, target = record.tracks, record.target
    begin = float(way.line.project(tracks.xy_m[target, start])[0])
    speed = max(float(tracks.speed_mps[target, start]), 0.0)
    return Poses(*way.poses(begin + braked_s_m(speed, brake_mps2, count, tracks.dt_s)))


def _least_brake_mps2(record: EpisodeRecord, way: OwnWay, row: int, start: int, other: Poses) -> float:
    """Return the least even braking after the response from *start* on with which the boxes do not meet.

    0 where it is the other who would drive into the target: from behind without any braking, or at the hardest one.
    """
    tracks, target = record.tracks, record.target
    front, ahead, moved = 0.5 * float(tracks.size_m[target, 0]), 0.0, 0.0
    for brake in BRAKES_MPS2:
        own = _driven_poses(record, way, start, float(brake), len(other))
        met = contact_at(own, other, *tracks.size_m[[target, row]])
        if met is None:
            return float(brake)
        ahead, moved = _ahead_m(own, other, met), float(np.hypot(*(own.xy_m[met + 1] - own.xy_m[met])))
        if brake == 0.0 and ahead < -front:
            return 0.0
    return float(BRAKES_MPS2[-1]) if ahead > front and moved > LEAST_SPEED_MPS * tracks.dt_s else 0.0


def _ahead_m(own: Poses, other: Poses, step: int) -> float:
    """Return how far the centre of *other* is ahead of that of *own* at instant *step*."""
    return float((other.xy_m[step] - own.xy_m[step]) @ unit(own.yaw_rad[step]))


def _resolved_by(record: EpisodeRecord, row: int, step: int) -> ResolvedBy | None:
    """Return whose doing it was: had one alone kept its speed from *step* on, would the boxes have met?

    Where that tells of nobody, the velocity is kept instead: they steered. None where nobody had done enough by the
    record's end: going on as they last did, they meet.
    """
    count = round(_AFTER_S / record.tracks.dt_s)
    rows = record.target, row
    sizes = record.tracks.size_m[list(rows)]
    on = [gone_on(record, x, step, count) for x in rows]
    if contact_at(on[0], on[1], *sizes) is not None:
        return None
    for ways in (
        [kept(record, x, step, step, count) for x in rows],
        [kept_straight(record, x, step, count) for x in rows],
    ):
        without_target = contact_at(ways[0], on[1], *sizes) is not None
        without_other = contact_at(on[0], ways[1], *sizes) is not None
        if without_target != without_other:
            return ResolvedBy.TARGET if without_target else ResolvedBy.OTHER
        if without_target:
            break
    return ResolvedBy.BOTH
