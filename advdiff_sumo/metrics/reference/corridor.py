"""Project other road users onto a reference driver's way and predict when they will occupy its corridor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.metrics.reference.driver_models import CRITICAL_TTC_S, HUMAN, TIE_M, DriverModel, Situation
from advdiff_sumo.metrics.reference.others_paths import LOOK_STEP_S, PERCEPTION_S, Prediction, look_times
from advdiff_sumo.metrics.reference.own_way import OwnWay

#: Least time gap at a conflict area between the ego and a road user with the right of way.
YIELD_GAP_S = 1.0


@dataclass(frozen=True)
class Corridor:
    """N other road users in the frame of the way, at K instants and at H look-ahead instants after each.

    Attributes:
        rows: (N,) rows of the record.
        along_m: (K, N, H) predicted centres along the way.
        half_m: (K, N, H) half the extent of the boxes along the way.
        clear_m: (K, N, H) gap across the way between the box and a box that drives on the way; negative: overlap.
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
    """The ego and each of N others at one instant, extrapolated with their present motion.

    Attributes:
        situation: (N,) the one-dimensional encounters.
        inside: (N,) whether the other overlaps with the corridor now, ahead of the ego.
        crossing: (N,) whether it does not overlap with the corridor yet, but will when the ego is there.
        meet_s: (N,) time until the boxes meet; inf if they do not within the look-ahead.
        conflict: (N,) whether it will be in the corridor at about the time at which the ego is there.
    """

    situation: Situation
    inside: BoolArray
    crossing: BoolArray
    meet_s: FloatArray
    conflict: BoolArray


def corridor_of(way: OwnWay, tracks: Tracks, rows: IntArray, future: Prediction, width_m: float) -> Corridor:
    """Return agents *rows* (N,) of *tracks* (K instants) in the frame of *way*.

    Args:
        way: the way.
        tracks: the agents at the K instants.
        rows: rows of the others.
        future: their predicted motion.
        width_m: width of the ego.
    """
    half_size = 0.5 * tracks.size_m[rows]
    along, across, relative_yaw = _in_frame(way, future)
    cos, sin = np.abs(np.cos(relative_yaw)), np.abs(np.sin(relative_yaw))
    half_along = half_size[:, None, 0] * cos + half_size[:, None, 1] * sin
    half_across = half_size[:, None, 0] * sin + half_size[:, None, 1] * cos
    clear = np.abs(across) - half_across - 0.5 * width_m
    present = clear[:, :, 0]
    change = np.diff(present, axis=0, append=present[-1:])  # forward difference: from an instant to the next
    rate = np.where(np.isfinite(change), change, 0.0) / tracks.dt_s
    if len(rate) > 1:
        rate[-1] = rate[-2]
    speed = tracks.speed_mps[rows].T * np.cos(relative_yaw[:, :, 0])
    return Corridor(rows, along, half_along, clear, speed, -rate, tracks.size_m[rows, 0])


def _in_frame(way: OwnWay, future: Prediction) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return positions along and across *way* and headings relative to it, (K, N, H) each.

    Every second look-ahead instant is projected. The instants between are interpolated.
    """
    along, across = way.line.project(future.xy_m[:, :, ::2], extrapolate=True)
    relative_yaw = future.yaw_rad[:, :, ::2] - way.line.at(along)[1]
    return _with_midpoints(along), _with_midpoints(across), _with_midpoints(np.unwrap(relative_yaw, axis=-1))


def _with_midpoints(values: FloatArray) -> FloatArray:
    """Return *values* (…, M) with the means of neighbours inserted between them, (…, 2 M − 1)."""
    result = np.empty((*values.shape[:-1], 2 * values.shape[-1] - 1))
    result[..., ::2] = values
    result[..., 1::2] = 0.5 * (values[..., 1:] + values[..., :-1])
    return result


def meeting_at(corridor: Corridor, instant: int, ego: tuple[float, float, float], length_m: float) -> Meeting:
    """Return the relation of the ego to each other road user at *instant*.

    Args:
        corridor: the others.
        instant: index of one of the K instants.
        ego: position of its centre along the way, speed, acceleration.
        length_m: its length.
    """
    s, v, a = ego
    times = look_times()
    along, half, clear = corridor.along_m[instant], corridor.half_m[instant], corridor.clear_m[instant]
    gap = along - half - (s + v * times + 0.5 * length_m)  # (N, H) the ego's front to the other's rear
    gap_behind = s + v * times - 0.5 * length_m - (along + half)  # the other's front to the ego's rear
    in_corridor = clear <= TIE_M
    with np.errstate(invalid="ignore"):
        is_ahead = along[:, 0] + half[:, 0] > s + 0.5 * length_m
    meet_s = _first_overlap_s((clear - TIE_M, gap, gap_behind))
    inside = in_corridor[:, 0] & is_ahead
    crossing = ~in_corridor[:, 0] & np.isfinite(meet_s) & _in_front(meet_s, along - (s + v * times))
    speed = corridor.speed_mps[instant]
    closing = np.maximum(v - np.maximum(speed, 0.0), 1e-3)
    situation = Situation(
        ego_mps=np.full(len(gap), v),
        ego_accel_mps2=np.full(len(gap), a),
        other_mps=np.where(crossing, np.maximum(speed, 0.0), speed),
        gap_m=np.where(crossing, closing * np.where(crossing, meet_s, 0.0), gap[:, 0]),
        lateral_gap_m=np.where(crossing, 0.0, clear[:, 0]),
        lateral_mps=np.where(crossing, 0.0, corridor.approach_mps[instant]),
        lengths_m=corridor.length_m + length_m,
    )
    margin_m = YIELD_GAP_S * v
    conflict = (in_corridor & (gap <= margin_m) & (gap_behind <= margin_m)).any(-1)
    return Meeting(situation, inside, crossing, meet_s, conflict)


def _first_overlap_s(gaps_m: tuple[FloatArray, ...]) -> FloatArray:
    """Return (N,) the first time at which all *gaps_m* (N, H) are 0 or less; inf if there is none.

    NaN counts as a gap above 0. Gaps are interpolated linearly between two look-ahead instants, so that the time does
    not depend on where these lie.
    """
    begin, end = np.zeros_like(gaps_m[0][:, 1:]), np.ones_like(gaps_m[0][:, 1:])
    for gap in gaps_m:
        before, after = gap[:, :-1], gap[:, 1:]
        with np.errstate(invalid="ignore", divide="ignore"):
            root = before / (before - after)
            begin = np.maximum(begin, np.where(before <= 0.0, 0.0, np.where(after <= 0.0, root, np.inf)))
            end = np.minimum(end, np.where(after <= 0.0, 1.0, np.where(before <= 0.0, root, -np.inf)))
    overlaps = begin <= end
    first = np.argmax(overlaps, axis=-1)
    return np.where(overlaps.any(-1), LOOK_STEP_S * (first + begin[np.arange(len(first)), first]), np.inf)


def _in_front(meet_s: FloatArray, ahead_m: FloatArray) -> BoolArray:
    """Return (N,) whether the other's centre is ahead of the ego's when they meet, so that braking may help.

    Args:
        meet_s: (N,) time until they meet; inf for never.
        ahead_m: (N, H) distance of its centre ahead of the ego's.
    """
    position = np.where(np.isfinite(meet_s), meet_s, 0.0) / LOOK_STEP_S
    index = np.minimum(position.astype(np.int64), ahead_m.shape[-1] - 2)
    row, share = np.arange(len(index)), position - index
    return np.asarray((1.0 - share) * ahead_m[row, index] + share * ahead_m[row, index + 1] > 0.0)


def required_braking_mps2(
    driver: DriverModel, meetings: Meeting, reacting: bool = False, leader_s: float = PERCEPTION_S
) -> FloatArray:
    """Return (N,) the deceleration in m/s² that *driver* requires for each other; 0 where the situation is safe.

    The human driver follows the regulation's criteria. A road user that is about to cross or enter is critical if the
    time until they meet is at most ``CRITICAL_TTC_S``. One ahead in the lane is a risk once it is perceived, until the
    ego no longer closes in.

    Args:
        driver: the model.
        meetings: relation of the ego to the others.
        reacting: whether the driver has begun to react.
        leader_s: time to a meeting from which the human driver perceives a road user ahead in its lane.
    """
    demand = driver.demand(meetings.situation)
    if driver is not HUMAN:
        return demand
    closing = meetings.inside & (meetings.situation.closing_mps > 0.0)
    perceived = (meetings.meet_s <= leader_s) | (reacting & closing)
    return np.where(np.where(meetings.crossing, meetings.meet_s <= CRITICAL_TTC_S, perceived), demand, 0.0)
