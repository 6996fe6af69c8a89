"""What must hold of the states of any episode, looked at from outside: with shapely and plain differences."""

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

#: Beyond what speed and step explain: of a position, of a speed in a step, and of a heading in a step.
JUMP_M, JUMP_MPS, JUMP_RAD = 0.8, 3.0, 0.35
#: A bend of a lane's centre line turns a vehicle that SUMO drives at once, so its heading may change by this.
SUMO_JUMP_RAD = 1.6
BESIDE_M, SEARCH_M, WIDER_STEPS = 0.3, 5.0, 20
TOUCH_M2, TOUCH_M, TOUCH_STEPS = 1e-3, 0.6, 1


@dataclass(frozen=True)
class States:
    """The states of one episode; A agents, T steps.

    Attributes:
        ids: A names.
        target: row of the tested vehicle.
        length_m, width_m: (A,) boxes.
        xy_m, yaw_rad, speed_mps: (A, T, 2), (A, T), (A, T); NaN where absent.
        by_sumo: (A, T) whether SUMO drove the agent.
        sumo_course: (A, T) whether it moves as SUMO moved it, then or in the traffic that is replayed.
        recorded: (A, T) whether it repeats a recording, of SUMO (which turns vehicles round on the spot) or of real
            traffic (with the jitter of its annotation).
        walks: (A,) whether it is a pedestrian.
        step_s: spacing.
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
            columns: by name.
            step_s: spacing.
            replay: the others do what they do in the seed scene.
            log: the seed scene is one of a driving log, not of SUMO traffic.
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
    """Yield a sentence for everything that may not be.

    Args:
        states: of the episode.
        road: its map.
        contacts: the episode's rows of ``collisions.parquet``.
    """
    there = np.isfinite(states.yaw_rad)
    holes = there & ~(np.isfinite(states.xy_m).all(-1) & np.isfinite(states.speed_mps))
    if holes.any():
        yield f"NaN in a state of '{states.ids[int(np.argwhere(holes)[0, 0])]}'"
    yield from _jumps(states, road)
    yield from _off_lanes(states, road)
    yield from _contacts(states, contacts)


def _jumps(states: States, road: RoadMap) -> Iterator[str]:
    """Yield where somebody moves, speeds up or turns as nothing on wheels does.

    A vehicle of SUMO's may be carried as far as the lanes' drawing does that (:func:`carried_m`).
    """
    before, after = states.xy_m[:, :-1], states.xy_m[:, 1:]
    way = np.hypot(*np.moveaxis(after - before, -1, 0))
    fastest = np.fmax(np.abs(states.speed_mps[:, :-1]), np.abs(states.speed_mps[:, 1:]))
    sumo = states.by_sumo[:, 1:] & states.by_sumo[:, :-1]
    turn = np.abs(wrap_angle(np.diff(states.yaw_rad, axis=1)))
    # the centre of a vehicle swings about its front bumper where SUMO turns it, or did when it was recorded
    drawn = states.by_sumo[:, 1:] | states.recorded[:, 1:]
    swing = np.where(drawn, 0.5 * states.length_m[:, None] * turn, 0.0)
    wheels = ~states.walks[:, None]
    # a recording's speeds may leap as those of no car do, but must be those of its way
    mean = 0.5 * (states.speed_mps[:, 1:] + states.speed_mps[:, :-1])
    leap = np.abs(np.diff(states.speed_mps, axis=1))
    off_its_way = np.maximum(np.abs(np.abs(mean) - way / states.step_s) - swing / states.step_s, 0.0)
    handed = states.by_sumo[:, 1:] != states.by_sumo[:, :-1]  # by as much as SUMO drove otherwise this time
    leap = np.where(states.recorded[:, 1:] & ~handed, off_its_way, leap)
    most_rad = np.where(drawn, SUMO_JUMP_RAD, JUMP_RAD)
    most_rad[sumo] = np.pi  # SUMO turns round within a step where its lanes do
    limits = (
        ("position", way - fastest * states.step_s - swing, JUMP_M, "m"),
        ("speed", leap, JUMP_MPS, "m/s"),
        ("heading", turn, most_rad, "rad"),
    )
    for what, change, most, unit in limits:
        wrong = np.argwhere((change > most) & wheels)  # NaN compares as False
        if what != "heading":
            slack_m = most if what == "position" else most * states.step_s
            wrong = np.array(
                [spot for spot in wrong.tolist() if not _carried(states, road, *spot, way, slack_m)]
            )
        if len(wrong):
            row, step = wrong[0].tolist()
            yield f"jump in {what} of '{states.ids[row]}' by {change[row, step]:.2f} {unit} after step {step}"


def _carried(states: States, road: RoadMap, row: int, step: int, way_m: FloatArray, slack_m: float) -> bool:
    """Return whether SUMO's lanes explain, but for *slack_m*, that *row* comes *way_m* (A, T − 1) far after *step*."""
    if not states.sumo_course[row, step : step + 2].all():
        return False
    speeds_mps = np.abs(states.speed_mps[row, step : step + 2])
    if states.recorded[row, step + 1]:  # its speeds are those of its way, and 0 where SUMO carried it back
        speeds_mps = np.full(2, np.nanmax(np.abs(states.speed_mps[row, max(step - 2, 0) : step + 4])))
    if np.ptp(speeds_mps) > JUMP_MPS:
        return False
    bumper = bumper_from_centre(states.xy_m[row, step], states.yaw_rad[row, step], states.length_m[row])
    slowest_m, fastest_m = float(speeds_mps.min()) * states.step_s, float(speeds_mps.max()) * states.step_s
    least, most = carried_m(road, bumper, slowest_m)[0], carried_m(road, bumper, fastest_m)[1]
    return bool(slowest_m + least - slack_m <= way_m[row, step] <= fastest_m + most + slack_m)


def _off_lanes(states: States, road: RoadMap) -> Iterator[str]:
    """Yield who is driven by SUMO and has its front bumper on no lane."""
    row, step = np.nonzero(states.by_sumo & ~states.walks[:, None])
    if not len(row):
        return
    yaw = states.yaw_rad[row, step]
    bumper = bumper_from_centre(states.xy_m[row, step], yaw, states.length_m[row])
    near = road.index.candidates(bumper, 0.5 * float(road.index.width_m.max()) + SEARCH_M)
    excess = np.full(len(row), np.inf)
    np.minimum.at(excess, near.point, np.abs(near.d_m) - 0.5 * road.index.width_m[near.lane])
    wrong = [k for k in np.flatnonzero(excess > BESIDE_M) if not _from_wider(states, road, row[k], step[k])]
    if wrong:
        k = int(wrong[0])
        beside = f"{excess[k]:.2f} m beside" if np.isfinite(excess[k]) else "far from"
        yield f"'{states.ids[row[k]]}' is driven by SUMO {beside} all lanes at step {step[k]}"


def _from_wider(states: States, road: RoadMap, row: int, step: int) -> bool:
    """Return whether *row* is no farther aside than the lane reached on which it was shortly before *step*.

    With sublanes SUMO lets a vehicle keep its place across where its lane becomes narrower.
    """
    since = max(step - WIDER_STEPS, 0)
    yaw, length_m = states.yaw_rad[row, since : step + 1], np.full(step + 1 - since, states.length_m[row])
    bumper = bumper_from_centre(states.xy_m[row, since : step + 1], yaw, length_m)
    ids, _, aside_m, _ = road.locate_many(bumper, yaw, max_distance_m=float(road.index.width_m.max()))
    widest_m = max((road.lanes[lane].width_m for lane in ids[:-1] if lane is not None), default=0.0)
    return ids[-1] is not None and abs(float(aside_m[-1])) <= 0.5 * widest_m + BESIDE_M


def _contacts(states: States, contacts: list[Mapping[str, Any]]) -> Iterator[str]:
    """Yield contacts of the target that the record lacks, and recorded ones that no boxes show."""
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
        mine, theirs = boxes[states.target], boxes[other]
        touch = np.flatnonzero(shapely.area(shapely.intersection(mine, theirs)) > TOUCH_M2)
        first = int(touch[0]) if len(touch) else None
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
    """Return (A, T) polygons; None where absent."""
    half = 0.5 * np.stack((states.length_m, states.width_m), axis=-1)
    corners = half[:, None, :] * np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])  # (A, 4, 2)
    cos, sin = np.cos(states.yaw_rad), np.sin(states.yaw_rad)
    turn = np.stack((np.stack((cos, -sin), -1), np.stack((sin, cos), -1)), -2)  # (A, T, 2, 2)
    ring = np.einsum("atij,akj->atki", turn, corners) + states.xy_m[:, :, None, :]
    boxes = np.full(states.yaw_rad.shape, None, dtype=object)
    there = np.isfinite(ring).all((-1, -2))
    boxes[there] = shapely.polygons(ring[there])
    return boxes


def runs_of(episode: IntArray) -> Iterator[tuple[int, slice]]:
    """Yield episode numbers with the rows that they have in a table that is sorted by them."""
    starts = np.flatnonzero(np.diff(episode, prepend=-1))
    for start, stop in pairwise([*starts.tolist(), len(episode)]):
        yield int(episode[start]), slice(start, stop)
