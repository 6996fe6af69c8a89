"""Independent checks of the states of an episode, with shapely and finite differences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import shapely

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.frames import bumper_from_centre, wrap_angle
from advdiff_sumo.maps import RoadMap
from soak_src.lane_seams import carried_m

#: Largest changes in a step: of the position beyond what the speed explains, of the speed, and of the heading.
JUMP_M, JUMP_MPS, JUMP_RAD = 0.8, 3.0, 0.35
#: Largest change of the heading of a vehicle driven by SUMO, which turns abruptly at bends of the lane's centre line.
SUMO_JUMP_RAD = 1.6
BESIDE_M = 0.3  # tolerated distance of the front bumper from the nearest lane
SEARCH_M = 5.0  # distance within which lanes are searched
WIDER_STEPS = 20  # see `_lane_was_wider`
TOUCH_M2 = 1e-3  # a larger overlap of boxes is a contact
TOUCH_M, TOUCH_STEPS = 0.6, 1  # tolerances of recorded contacts: gap of the boxes, and time


@dataclass(frozen=True)
class States:
    """The states of one episode; A agents, T steps.

    Attributes:
        ids: names of the A agents.
        target: row of the tested vehicle.
        length_m, width_m: (A,) sizes of the boxes.
        xy_m, yaw_rad, speed_mps: (A, T, 2), (A, T), (A, T); NaN where absent.
        by_sumo: (A, T) whether SUMO drove the agent.
        sumo_course: (A, T) whether SUMO determined its motion, now or in the traffic that is replayed.
        recorded: (A, T) whether it repeats a recording of SUMO (which can turn vehicles on the spot) or of real traffic
            (with jitter of the annotation).
        walks: (A,) whether it is a pedestrian.
        step_s: duration of a step.
    """

    ids: tuple[str, ...]
    target: int
    length_m: FloatArray
    width_m: FloatArray
    xy_m: FloatArray
    yaw_rad: FloatArray
    speed_mps: FloatArray
    by_sumo: BoolArray
    sumo_course: BoolArray
    recorded: BoolArray
    walks: BoolArray
    step_s: float

    @staticmethod
    def of(
        columns: Mapping[str, Any], step_s: float = 0.1, *, replay: bool = False, log: bool = False
    ) -> States:
        """Return columns of ``states.parquet`` (NumPy arrays of one episode) as arrays over agents and steps.

        Args:
            columns: values by column name.
            step_s: duration of a step.
            replay: whether the others repeat the motion of the seed scene.
            log: whether the seed scene comes from a driving log; else from SUMO traffic.
        """
        ids, row = np.unique(columns["agent"].astype(str), return_inverse=True)
        shape, step = (len(ids), int(columns["step"].max()) + 1), columns["step"]

        def grid(name: str) -> FloatArray:
            values = np.full(shape, np.nan)
            values[row, step] = columns[name]
            return values

        def driven_by(controller: str) -> BoolArray:
            steps = np.zeros(shape, dtype=np.bool_)
            steps[row, step] = columns["controller"] == controller
            return steps

        by_sumo, repeated = driven_by("sumo"), driven_by("replayed")
        others = ~np.isin(ids, columns["agent"][columns["is_target"]].astype(str))[:, None]
        first = np.unique(row, return_index=True)[1]
        return States(
            tuple(ids.tolist()),
            int(row[np.flatnonzero(columns["is_target"])[0]]),
            columns["length_m"][first],
            columns["width_m"][first],
            np.stack((grid("x_m"), grid("y_m")), axis=-1),
            grid("yaw_rad"),
            grid("speed_mps"),
            by_sumo,
            by_sumo | (others & (replay and not log)),
            repeated | (others & replay),
            columns["class"][first] == "pedestrian",
            step_s,
        )


def problems(states: States, road: RoadMap, contacts: list[Mapping[str, Any]]) -> Iterator[str]:
    """Yield a sentence for every fault in the states of an episode.

    Args:
        states: of the episode.
        road: its map.
        contacts: the episode's rows of ``collisions.parquet``.
    """
    is_present = np.isfinite(states.yaw_rad)
    incomplete = is_present & ~(np.isfinite(states.xy_m).all(-1) & np.isfinite(states.speed_mps))
    if incomplete.any():
        yield f"NaN in a state of '{states.ids[int(np.argwhere(incomplete)[0, 0])]}'"
    yield from _jumps(states, road)
    yield from _off_lanes(states, road)
    yield from _contacts(states, contacts)


def _jumps(states: States, road: RoadMap) -> Iterator[str]:
    """Yield a sentence for the first jump in position, speed or heading of a vehicle.

    A vehicle driven by SUMO may jump as far as the geometry of its lanes explains it (:func:`carried_m`).
    """
    before, after = states.xy_m[:, :-1], states.xy_m[:, 1:]
    moved_m = np.hypot(*np.moveaxis(after - before, -1, 0))
    fastest = np.fmax(np.abs(states.speed_mps[:, :-1]), np.abs(states.speed_mps[:, 1:]))
    by_sumo = states.by_sumo[:, 1:] & states.by_sumo[:, :-1]
    turn = np.abs(wrap_angle(np.diff(states.yaw_rad, axis=1)))
    # SUMO turns a vehicle about its front bumper, so that its centre moves sideways; recordings of SUMO do the same
    sumo_turns = states.by_sumo[:, 1:] | states.recorded[:, 1:]
    swing_m = np.where(sumo_turns, 0.5 * states.length_m[:, None] * turn, 0.0)
    is_vehicle = ~states.walks[:, None]
    # recorded speeds may jump, but must agree with the distance travelled
    mean = 0.5 * (states.speed_mps[:, 1:] + states.speed_mps[:, :-1])
    speed_change = np.abs(np.diff(states.speed_mps, axis=1))
    speed_error = np.maximum(np.abs(np.abs(mean) - moved_m / states.step_s) - swing_m / states.step_s, 0.0)
    handed_over = (
        states.by_sumo[:, 1:] != states.by_sumo[:, :-1]
    )  # SUMO may have driven differently this time
    speed_change = np.where(states.recorded[:, 1:] & ~handed_over, speed_error, speed_change)
    most_rad = np.where(sumo_turns, SUMO_JUMP_RAD, JUMP_RAD)
    most_rad[by_sumo] = np.pi  # SUMO turns a vehicle around within a step where its lanes do
    limits = (
        ("position", moved_m - fastest * states.step_s - swing_m, JUMP_M, "m"),
        ("speed", speed_change, JUMP_MPS, "m/s"),
        ("heading", turn, most_rad, "rad"),
    )
    for quantity, change, most, unit in limits:
        jumps = np.argwhere((change > most) & is_vehicle)  # NaN compares as False
        if quantity != "heading":
            slack_m = most if quantity == "position" else most * states.step_s
            jumps = np.array(
                [jump for jump in jumps.tolist() if not _is_carried(states, road, *jump, moved_m, slack_m)]
            )
        if len(jumps):
            row, step = jumps[0].tolist()
            size = f"{change[row, step]:.2f} {unit}"
            yield f"jump in {quantity} of '{states.ids[row]}' by {size} after step {step}"


def _is_carried(
    states: States, road: RoadMap, row: int, step: int, moved_m: FloatArray, slack_m: float
) -> bool:
    """Return whether the geometry of SUMO's lanes explains how far *row* moves after *step*.

    Args:
        states: of the episode.
        road: its map.
        row: agent.
        step: instant before the movement.
        moved_m: (A, T − 1) distances moved in each step.
        slack_m: tolerance.
    """
    if not states.sumo_course[row, step : step + 2].all():
        return False
    speeds_mps = np.abs(states.speed_mps[row, step : step + 2])
    if states.recorded[
        row, step + 1
    ]:  # its speeds follow from its positions, and are 0 where SUMO moved it backwards
        speeds_mps = np.full(2, np.nanmax(np.abs(states.speed_mps[row, max(step - 2, 0) : step + 4])))
    if np.ptp(speeds_mps) > JUMP_MPS:
        return False
    bumper = bumper_from_centre(states.xy_m[row, step], states.yaw_rad[row, step], states.length_m[row])
    slowest_m, fastest_m = float(speeds_mps.min()) * states.step_s, float(speeds_mps.max()) * states.step_s
    least, most = carried_m(road, bumper, slowest_m)[0], carried_m(road, bumper, fastest_m)[1]
    return bool(slowest_m + least - slack_m <= moved_m[row, step] <= fastest_m + most + slack_m)


def _off_lanes(states: States, road: RoadMap) -> Iterator[str]:
    """Yield a sentence for the first vehicle that SUMO drives with its front bumper beside all lanes."""
    row, step = np.nonzero(states.by_sumo & ~states.walks[:, None])
    if not len(row):
        return
    yaw = states.yaw_rad[row, step]
    bumper = bumper_from_centre(states.xy_m[row, step], yaw, states.length_m[row])
    near = road.index.candidates(bumper, 0.5 * float(road.index.width_m.max()) + SEARCH_M)
    excess = np.full(len(row), np.inf)
    np.minimum.at(excess, near.point, np.abs(near.d_m) - 0.5 * road.index.width_m[near.lane])
    outside = np.flatnonzero(excess > BESIDE_M)
    wrong = [k for k in outside if not _lane_was_wider(states, road, row[k], step[k])]
    if wrong:
        k = int(wrong[0])
        distance = f"{excess[k]:.2f} m beside" if np.isfinite(excess[k]) else "far from"
        yield f"'{states.ids[row[k]]}' is driven by SUMO {distance} all lanes at step {step[k]}"


def _lane_was_wider(states: States, road: RoadMap, row: int, step: int) -> bool:
    """Return whether the lateral offset of *row* lies within a wider lane on which it was shortly before *step*.

    With sublanes, SUMO lets a vehicle keep its lateral offset if its lane becomes narrower.
    """
    since = max(step - WIDER_STEPS, 0)
    yaw, length_m = states.yaw_rad[row, since : step + 1], np.full(step + 1 - since, states.length_m[row])
    bumper = bumper_from_centre(states.xy_m[row, since : step + 1], yaw, length_m)
    ids, _, aside_m, _ = road.locate_many(bumper, yaw, max_distance_m=float(road.index.width_m.max()))
    widest_m = max((road.lanes[lane].width_m for lane in ids[:-1] if lane is not None), default=0.0)
    return ids[-1] is not None and abs(float(aside_m[-1])) <= 0.5 * widest_m + BESIDE_M


def _contacts(states: States, contacts: list[Mapping[str, Any]]) -> Iterator[str]:
    """Yield a sentence for each contact of the target that is not recorded, or is recorded although boxes are apart."""
    boxes = _boxes(states)
    steps = states.yaw_rad.shape[1]
    recorded = {
        name: round(row["time_s"] / states.step_s)
        for row in contacts
        for name in [row["second"]]
        if row["with_target"] and row["second"]
    }
    for other, name in enumerate(states.ids):
        if other == states.target:
            continue
        overlap_m2 = shapely.area(shapely.intersection(boxes[states.target], boxes[other]))
        contact_steps = np.flatnonzero(overlap_m2 > TOUCH_M2)
        first = int(contact_steps[0]) if len(contact_steps) else None
        if first is not None and name not in recorded:
            yield f"the boxes of target and '{name}' overlap at step {first}, which is not recorded"
        elif first is not None and abs(recorded[name] - first) > TOUCH_STEPS:
            yield f"contact of target and '{name}' is recorded at step {recorded[name]}, the boxes overlap at {first}"
    for name, step in recorded.items():
        if name in states.ids:
            around = slice(max(step - 1, 0), min(step + 2, steps))
            gap = shapely.distance(boxes[states.target, around], boxes[states.ids.index(name), around])
            if not np.nanmin(gap, initial=np.inf) <= TOUCH_M:
                yield f"contact of target and '{name}' is recorded at step {step}, where the boxes are apart"


def _boxes(states: States) -> Any:
    """Return (A, T) the boxes as polygons; None where absent."""
    half = 0.5 * np.stack((states.length_m, states.width_m), axis=-1)
    corners = half[:, None, :] * np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])  # (A, 4, 2)
    cos, sin = np.cos(states.yaw_rad), np.sin(states.yaw_rad)
    turn = np.stack((np.stack((cos, -sin), -1), np.stack((sin, cos), -1)), -2)  # (A, T, 2, 2)
    ring = np.einsum("atij,akj->atki", turn, corners) + states.xy_m[:, :, None, :]
    boxes = np.full(states.yaw_rad.shape, None, dtype=object)
    is_present = np.isfinite(ring).all((-1, -2))
    boxes[is_present] = shapely.polygons(ring[is_present])
    return boxes


def runs_of(episode: IntArray) -> Iterator[tuple[int, slice]]:
    """Yield (episode number, its rows) from the column of episode numbers of a sorted table."""
    starts = np.flatnonzero(np.diff(episode, prepend=-1))
    for start, stop in pairwise([*starts.tolist(), len(episode)]):
        yield int(episode[start]), slice(start, stop)
