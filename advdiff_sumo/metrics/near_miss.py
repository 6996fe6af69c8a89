"""Critical near misses, in which a careful driver would have had to brake hard, and which party resolved them.

1. A reference driver takes over from the target where the careful and competent driver would.
2. It responds after the regulation's 0.75 s and then brakes evenly.
3. It follows the driven path until the instant of the least time to collision, then the lanes of the target's route,
   so that it need not steer.
4. The other moves as recorded until that instant and then keeps its speed on its recorded way, since the driver could
   not rely on its braking afterwards.
5. The near miss is critical if the driver must brake at more than 4 m/s² for the boxes not to meet.

It is not critical if braking does not help: the target stands, or the other comes from behind or, at any braking, into
its side.
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
from advdiff_sumo.metrics.criticality import time_to_collision
from advdiff_sumo.metrics.encounter import LEAST_SPEED_MPS
from advdiff_sumo.metrics.kept_motion import (
    BRAKES_MPS2,
    Poses,
    braked_s_m,
    continued_poses,
    first_contact_step,
    with_speed_kept,
    with_velocity_kept,
)
from advdiff_sumo.metrics.reference import ReferenceDrive, ReferenceDrivers
from advdiff_sumo.metrics.reference.drive_contact import is_behind
from advdiff_sumo.metrics.reference.own_way import OwnWay, joined_way, way_from
from advdiff_sumo.metrics.reference.reference_drive import instant_as_collision
from advdiff_sumo.metrics.target_contact import standing_overlaps

#: Encounters with a least time to collision below this are near misses.
NEAR_MISS_TTC_S = 2.5
#: Motion is extrapolated for this long after the instant of the least time to collision.
_AFTER_S = 4.0
#: Required length of the driver's way.
_WAY_LENGTH_M = 150.0


class ResolvedBy(StrEnum):
    """The party that avoided a collision in a near miss."""

    TARGET = "target"
    OTHER = "other"
    BOTH = "both"


@dataclass(frozen=True)
class NearMiss:
    """An encounter without a collision.

    Attributes:
        row: row of the other.
        time_s: time of the least time to collision with it, since the episode's start.
        brake_mps2: deceleration that a reference driver would have needed; 0 if none, or if braking does not help.
        resolved_by: the party that avoided the collision; None if the record ends before it is resolved.
    """

    row: int
    time_s: float
    brake_mps2: float
    resolved_by: ResolvedBy | None

    @property
    def critical(self) -> bool:
        """Whether the needed deceleration is more than what is to be expected of a driver."""
        return self.brake_mps2 > EXPECTED_BRAKE_MPS2


def near_miss(record: EpisodeRecord, road: RoadMap) -> NearMiss | None:
    """Return the near miss of an episode without a collision that needs the hardest braking; None without one.

    Of several that need the same braking, it is the one with the least time to collision.

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


def careful_driver_drive(record: EpisodeRecord, road: RoadMap, missed: NearMiss) -> ReferenceDrive | None:
    """Return the drive of the careful and competent driver in the near miss *missed*.

    None if it is at the first instant, or if the target was absent before.
    """
    step = round((missed.time_s - record.tracks.t0_s) / record.tracks.dt_s)
    return _drive(record, road, missed.row, step)


def resolution_clause(by: str | None) -> str:
    """Return which party resolved a near miss, as part of a sentence; *by* is a :class:`ResolvedBy` value or None."""
    return "the record ends before it is resolved" if by is None else f"resolved by: {by}"


def _candidates(record: EpisodeRecord) -> list[tuple[int, int]]:
    """Return (row, instant) of each other's least time to collision below ``NEAR_MISS_TTC_S``, the shortest first.

    Instants at which the target stands, or the other is behind it, do not count, since braking does not help then.
    Neither do those at which the other appeared in contact with the target and still touches it.
    """
    tracks, target = record.tracks, record.target
    ttc = time_to_collision(tracks, target)
    stands = np.abs(tracks.speed_mps[target]) <= LEAST_SPEED_MPS
    behind = is_behind(tracks.xy_m, tracks.xy_m[target], tracks.yaw_rad[target], tracks.size_m[target, 0])
    counts = np.isfinite(ttc) & ~stands & ~behind
    if (ttc == 0.0).any():
        counts &= ~_initial_contacts(record)
    ttc = np.where(counts, ttc, np.inf)
    steps = ttc.argmin(1)
    least_ttc = ttc.min(1)
    near = np.flatnonzero(least_ttc < NEAR_MISS_TTC_S)
    return [(int(row), int(steps[row])) for row in near[np.argsort(least_ttc[near], kind="stable")]]


def _initial_contacts(record: EpisodeRecord) -> BoolArray:
    """Return (A, T) whether the other has touched the target ever since it appeared."""
    tracks = record.tracks
    contacts: list[BoolArray] = []
    for step in range(tracks.steps):
        overlaps = standing_overlaps(
            contacts[-1] if contacts else None,
            tracks.xy_m[:, max(0, step - 1)],
            tracks.xy_m[:, step],
            tracks.yaw_rad[:, step],
            tracks.size_m,
            record.target,
            dt_s=tracks.dt_s,
        )
        contacts.append(overlaps)
    return np.stack(contacts, axis=1)


def _drive(record: EpisodeRecord, road: RoadMap, row: int, step: int) -> ReferenceDrive | None:
    if step == 0 or not record.tracks.valid[record.target, : step + 1].all():
        return None
    return ReferenceDrivers(record, road, instant_as_collision(record, row, step)).drive()


def _needed_brake_mps2(record: EpisodeRecord, road: RoadMap, row: int, step: int) -> float:
    """Return the deceleration that a reference driver needs to avoid *row*; 0 if braking does not help."""
    tracks, target, count = record.tracks, record.target, round(_AFTER_S / record.tracks.dt_s)
    other = with_speed_kept(record, row, step, step, count)
    unbraked = _driven_poses(record, _own_way(record, road, step, step), step, 0.0, len(other))
    if first_contact_step(unbraked, other, *tracks.size_m[[target, row]]) is None:
        return 0.0  # they do not meet on their ways, only when extrapolated straight
    drive = _drive(record, road, row, step)
    if drive is None:
        return 0.0
    start = drive.takeover_step
    way = _own_way(record, road, start, step)
    return _least_brake_mps2(record, way, row, start, with_speed_kept(record, row, start, step, count))


def _own_way(record: EpisodeRecord, road: RoadMap, start: int, step: int) -> OwnWay:
    """Return the target's driven path from *start* to *step*, and its route's lanes beyond."""
    if start == step:
        return way_from(record, road, step, _WAY_LENGTH_M)
    return joined_way(record, road, start, step, _WAY_LENGTH_M)


def _driven_poses(record: EpisodeRecord, way: OwnWay, start: int, brake_mps2: float, count: int) -> Poses:
    """Return *count* poses of a driver on *way* who brakes from instant *start* on as in :func:`.braked_s_m`."""
    tracks, target = record.tracks, record.target
    start_s_m = float(way.line.project(tracks.xy_m[target, start])[0])
    speed = max(float(tracks.speed_mps[target, start]), 0.0)
    return Poses(*way.poses(start_s_m + braked_s_m(speed, brake_mps2, count, tracks.dt_s)))


def _least_brake_mps2(record: EpisodeRecord, way: OwnWay, row: int, start: int, other: Poses) -> float:
    """Return the least even deceleration, after a response from *start* on, with which the boxes do not meet.

    0 if the other drives into the target: from behind if the target does not brake, or at the hardest braking.
    """
    tracks, target = record.tracks, record.target
    half_length, ahead, moved = 0.5 * float(tracks.size_m[target, 0]), 0.0, 0.0
    for brake in BRAKES_MPS2:
        own = _driven_poses(record, way, start, float(brake), len(other))
        contact = first_contact_step(own, other, *tracks.size_m[[target, row]])
        if contact is None:
            return float(brake)
        ahead = _ahead_m(own, other, contact)
        moved = float(np.hypot(*(own.xy_m[contact + 1] - own.xy_m[contact])))
        if brake == 0.0 and ahead < -half_length:
            return 0.0
    still_moves = moved > LEAST_SPEED_MPS * tracks.dt_s
    return float(BRAKES_MPS2[-1]) if ahead > half_length and still_moves else 0.0


def _ahead_m(own: Poses, other: Poses, step: int) -> float:
    """Return the distance of the centre of *other* ahead of that of *own* at instant *step*."""
    return float((other.xy_m[step] - own.xy_m[step]) @ unit(own.yaw_rad[step]))


def _resolved_by(record: EpisodeRecord, row: int, step: int) -> ResolvedBy | None:
    """Return the party that avoided the collision: they would have met if it alone had kept its speed from *step* on.

    If neither or only both would have met so, the test is repeated with the velocity kept, as a party may have steered.
    None if they meet after the record's end when they continue their last motion.
    """
    count = round(_AFTER_S / record.tracks.dt_s)
    rows = record.target, row
    sizes = record.tracks.size_m[list(rows)]
    actual = [continued_poses(record, x, step, count) for x in rows]
    if first_contact_step(actual[0], actual[1], *sizes) is not None:
        return None
    for unchanged in (
        [with_speed_kept(record, x, step, step, count) for x in rows],
        [with_velocity_kept(record, x, step, count) for x in rows],
    ):
        target_acted = first_contact_step(unchanged[0], actual[1], *sizes) is not None
        other_acted = first_contact_step(actual[0], unchanged[1], *sizes) is not None
        if target_acted != other_acted:
            return ResolvedBy.TARGET if target_acted else ResolvedBy.OTHER
        if target_acted:
            break
    return ResolvedBy.BOTH
