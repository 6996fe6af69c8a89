"""The others in the frame of a reference driver's way: along it, across it, and when they will be in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.metrics.reference.driver_models import CRITICAL_TTC_S, HUMAN, TIE_M, DriverModel, Situation
from advdiff_sumo.metrics.reference.others_paths import LOOK_STEP_S, PERCEPTION_S, Expected, look_times
from advdiff_sumo.metrics.reference.own_way import OwnWay

#: Time that must lie between the ego and somebody with the right of way at a conflict area.
YIELD_GAP_S = 1.0


@dataclass(frozen=True)
class Corridor:
    """N others at K instants, and at the H instants ahead of each, in the frame of the way.

    Attributes:
        rows: (N,) rows of the record.
        along_m: (K, N, H) expected centres along the way.
        half_m: (K, N, H) half the extent of the boxes along the way.
        clear_m: (K, N, H) gap across the way between the box and a box that drives on it; negative: overlap.
        speed_mps: (K, N) speed along the way.
        approach_mps: (K, N) speed at which the lateral gap closes.
        length_m: (N,) lengths of the boxes.
    """

    rows: IntArray
    along_m: FloatArray
    half_m: FloatArray
    clear_m: FloatArray
    speed_mps: FloatArray
    approach_mps: FloatArray
    length_m: FloatArray


@dataclass(frozen=True)
class Meeting:
    """The ego and each of N others at one instant, if all went on as they do.

    Attributes:
        situation: (N,) the one-dimensional encounters.
        inside: (N,) overlaps with the corridor now, ahead of the ego.
        crossing: (N,) does not overlap with it yet, but will when the ego is there.
        meet_s: (N,) time until the boxes meet; inf for never within the look-ahead.
        conflict: (N,) will be in the corridor at about the time at which the ego is there.
    """

    situation: Situation
    inside: BoolArray
    crossing: BoolArray
    meet_s: FloatArray
    conflict: BoolArray


def corridor_of(way: OwnWay, tracks: Tracks, rows: IntArray, future: Expected, width_m: float) -> Corridor:
    """Return agents *rows* (N,) of *tracks* (K instants) in the frame of *way*.

    Args:
        way: the way.
        tracks: the agents at the K instants.
        rows: whom to look at.
        future: what is expected of them.
        width_m: width of the ego.
    """
    half = 0.5 * tracks.size_m[rows]
    along, across, turn = _in_frame(way, future)
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    extent = half[:, None, 0] * cos + half[:, None, 1] * sin
    breadth = half[:, None, 0] * sin + half[:, None, 1] * cos
    clear = np.abs(across) - breadth - 0.5 * width_m
    now = clear[:, :, 0]
    ahead = np.diff(now, axis=0, append=now[-1:])  # a lateral speed holds from its instant on
    rate = np.where(np.isfinite(ahead), ahead, 0.0) / tracks.dt_s
    if len(rate) > 1:
        rate[-1] = rate[-2]
    speed = tracks.speed_mps[rows].T * np.cos(turn[:, :, 0])
    return Corridor(rows, along, extent, clear, speed, -rate, tracks.size_m[rows, 0])


def _in_frame(way: OwnWay, future: Expected) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return places along and across *way* and headings against it, (K, N, H) each.

    Every other instant ahead is projected, those between lie halfway.
    """
    along, across = way.line.project(future.xy_m[:, :, ::2], extrapolate=True)
    turn = future.yaw_rad[:, :, ::2] - way.line.at(along)[1]
    return _halved(along), _halved(across), _halved(np.unwrap(turn, axis=-1))


def _halved(values: FloatArray) -> FloatArray:
    """Return *values* (…, M) with the means of neighbours between them, (…, 2 M − 1)."""
    out = np.empty((*values.shape[:-1], 2 * values.shape[-1] - 1))
    out[..., ::2] = values
    out[..., 1::2] = 0.5 * (values[..., 1:] + values[..., :-1])
    return out


def meeting(corridor: Corridor, instant: int, ego: tuple[float, float, float], length_m: float) -> Meeting:
    """Return how the ego stands to each other at *instant*.

    Args:
        corridor: the others.
        instant: which of the K instants.
        ego: place of its centre along the way, speed, acceleration.
        length_m: its length.
    """
    s, v, a = ego
    times = look_times()
    along, half, clear = corridor.along_m[instant], corridor.half_m[instant], corridor.clear_m[instant]
    gap = along - half - (s + v * times + 0.5 * length_m)  # (N, H) bumper to bumper if all go on
    behind = s + v * times - 0.5 * length_m - (along + half)
    across = clear <= TIE_M
    with np.errstate(invalid="ignore"):
        ahead = along[:, 0] + half[:, 0] > s + 0.5 * length_m
    meet = _meeting_s((clear - TIE_M, gap, behind))
    lateral, d = clear[:, 0], gap[:, 0]
    inside = across[:, 0] & ahead
    crossing = ~across[:, 0] & np.isfinite(meet) & _in_front(meet, along - (s + v * times))
    closing = np.maximum(v - np.maximum(corridor.speed_mps[instant], 0.0), 1e-3)
    situation = Situation(
        ego_mps=np.full(len(d), v),
        ego_accel_mps2=np.full(len(d), a),
        other_mps=np.where(
            crossing, np.maximum(corridor.speed_mps[instant], 0.0), corridor.speed_mps[instant]
        ),
        gap_m=np.where(crossing, closing * np.where(crossing, meet, 0.0), d),
        lateral_gap_m=np.where(crossing, 0.0, lateral),
        lateral_mps=np.where(crossing, 0.0, corridor.approach_mps[instant]),
        lengths_m=corridor.length_m + length_m,
    )
    slack = YIELD_GAP_S * v
    conflict = (across & (gap <= slack) & (behind <= slack)).any(-1)
    return Meeting(situation, inside, crossing, meet, conflict)


def _meeting_s(excesses_m: tuple[FloatArray, ...]) -> FloatArray:
    """Return (N,) the first time at which all *excesses_m* (N, H) are 0 or less; inf for never, NaN counts as above.

    They are taken to change evenly between two instants looked at, so that the time does not hang on where
    those lie.
    """
    begin, end = np.zeros_like(excesses_m[0][:, 1:]), np.ones_like(excesses_m[0][:, 1:])
    for excess in excesses_m:
        before, after = excess[:, :-1], excess[:, 1:]
        with np.errstate(invalid="ignore", divide="ignore"):
            root = before / (before - after)
            begin = np.maximum(begin, np.where(before <= 0.0, 0.0, np.where(after <= 0.0, root, np.inf)))
            end = np.minimum(end, np.where(after <= 0.0, 1.0, np.where(before <= 0.0, root, -np.inf)))
    meets = begin <= end
    first = np.argmax(meets, axis=-1)
    return np.where(meets.any(-1), LOOK_STEP_S * (first + begin[np.arange(len(first)), first]), np.inf)


def _in_front(meet_s: FloatArray, ahead_m: FloatArray) -> BoolArray:
    """Return (N,) whether the other's centre is ahead when they meet: braking may help.

    Args:
        meet_s: (N,) when they meet; inf for never.
        ahead_m: (N, H) how far its centre is ahead of the ego's.
    """
    place = np.where(np.isfinite(meet_s), meet_s, 0.0) / LOOK_STEP_S
    first = np.minimum(place.astype(np.int64), ahead_m.shape[-1] - 2)
    row, share = np.arange(len(first)), place - first
    return np.asarray((1.0 - share) * ahead_m[row, first] + share * ahead_m[row, first + 1] > 0.0)


def demands(
    driver: DriverModel, met: Meeting, reacting: bool = False, leader_s: float = PERCEPTION_S
) -> FloatArray:
    """Return (N,) the braking in m/s² that *driver* wants for each other; 0 where it calls the situation safe.

    The human driver's criteria are those of the regulation: somebody who is about to cross or enter is critical
    from ``CRITICAL_TTC_S`` on; somebody ahead in its lane is a risk once perceived, until it no longer closes in.

    Args:
        driver: the model.
        met: how the ego stands to the others.
        reacting: whether the driver has begun to react.
        leader_s: from what time to a meeting on the human driver perceives somebody ahead in its lane.
    """
    demand = driver.demand(met.situation)
    if driver is not HUMAN:
        return demand
    closing = met.inside & (met.situation.closing_mps > 0.0)
    leading = (met.meet_s <= leader_s) | (reacting & closing)
    return np.where(np.where(met.crossing, met.meet_s <= CRITICAL_TTC_S, leading), demand, 0.0)
