"""Seed scenes out of driving logs, on a net that was converted from the log's own map."""

from __future__ import annotations

import math
import shlex
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray
from advdiff_sumo.core.errors import SceneError
from advdiff_sumo.core.resample import resample
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.data.log_reader import LogReader, LogScene
from advdiff_sumo.data.motion import parked_agents
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.seed_scene import PlacedTraffic, SeedScene
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions

_ON_LANE_M, _ALONG_LANE_RAD = 1.5, 0.6
_ALIGNED_RAD = 0.1
_MIN_FUTURE_S = 6.0
_SHORTEST_FUTURE_S = 1.5  # of logs that are too short for the whole of it
_BEYOND_LOG_M = 300.0
_FIT_SHARE, _FIT_M = 0.8, 3.0
_SAME_S = 1e-6
_NO_WAY = "no route of the net follows the ego"


@dataclass(frozen=True)
class LoggedTraffic:
    """A source of seed scenes: every ``stride_s`` or more of every drive that fits the net.

    Attributes:
        road: the net.
        reader: of the log.
        scene: the stride, and how fast the ego must be.
        sim: steps and radii.
        seed: the source's node of the seed tree.
        late: whether drives that give no start with 6 s of the log to come begin with less.
    """

    road: RoadMap
    reader: LogReader
    scene: SceneOptions
    sim: SimOptions
    seed: SeedTree
    late: bool = True

    def scenes(self) -> Iterator[SeedScene]:
        """Yield the seed scenes in the log's order; the first instants of all drives before the second ones.

        Raises:
            SceneError: no drive of the log was on this net.
        """
        logged = list(self.reader.scenes())
        drives = [drive for drive in logged if fits(self.road, drive)]
        if not drives:
            problem = "none of the log's drives is on this net"
            raise SceneError(f"{self.road.path}: {problem}; convert the log's own map{_own_map(logged)}")
        starts, standing = self._starts(drives)
        if not any(starts) and standing:
            raise SceneError(
                f"{self.road.path}: the log's ego is never faster than {self.scene.min_speed_mps:g} m/s where a scene "
                "could start; lower scene.min_speed_mps"
            )
        for turn in range(max(len(s) for s in starts)):
            for drive, instants in zip(drives, starts, strict=True):
                if turn < len(instants):
                    scene = self._scene(drive, instants[turn])
                    if scene is not None:
                        yield scene

    def standing_starts(self) -> int:
        """Return how many starts are passed over because the ego stands there, or nearly (``min_speed_mps``)."""
        return self._starts([drive for drive in self.reader.scenes() if fits(self.road, drive)])[1]

    def _starts(self, drives: list[LogScene]) -> tuple[list[list[int]], int]:
        """Return each drive's starts at which the ego is fast enough to be tested, and how many others there are.

        With ``late``, starts with less than ``_MIN_FUTURE_S`` of the log to come count where no drive has another one.
        """
        moving, standing = [list[int]() for _ in drives], 0
        for future_s in (_MIN_FUTURE_S, _SHORTEST_FUTURE_S) if self.late else (_MIN_FUTURE_S,):
            free = [self._free_instants(drive, future_s) for drive in drives]
            moving = [
                [k for k in instants if self._is_moving(drive, k)]
                for drive, instants in zip(drives, free, strict=True)
            ]
            standing = sum(map(len, free)) - sum(map(len, moving))
            if any(moving):
                break
        return moving, standing

    def _is_moving(self, drive: LogScene, now: int) -> bool:
        return bool(np.abs(drive.tracks.speed_mps[drive.ego, now]) >= self.scene.min_speed_mps)

    def why_none(self) -> str:
        """Return why the log gives no seed scene, and what helps, as the end of a sentence."""
        drives = [drive for drive in self.reader.scenes() if fits(self.road, drive)]
        reasons = Counter(
            self._hindrance(drive, k) for drive in drives for k in self._due(drive, _MIN_FUTURE_S)
        )
        if not reasons:
            longest_s = max((drive.tracks.steps - 1) * drive.tracks.dt_s for drive in drives)
            return (
                f"it has {longest_s:.1f} s at most, and {self.sim.history_s:g} s before a start and "
                f"{_SHORTEST_FUTURE_S:g} s after it are needed; give a longer log"
            )
        hindrances = ", ".join(
            f"{reason or _NO_WAY} (at {count} of {reasons.total()} instants)"
            for reason, count in reasons.most_common()
        )
        return (
            f"where one could start, {hindrances}; give a log whose ego drives along a lane "
            f"{self.sim.history_s:g} s after it appears and {_SHORTEST_FUTURE_S:g} s before the end"
        )

    def _due(self, drive: LogScene, least_future_s: float) -> range:
        """Return the instants with enough of the drive before them, and that much, or the whole of it, after them."""
        dt = drive.tracks.dt_s
        first = self._past_instants(dt)
        future_s = min(least_future_s, max(_SHORTEST_FUTURE_S, (drive.tracks.steps - 1 - first) * dt))
        return range(first, drive.tracks.steps - round(future_s / dt))

    def _past_instants(self, dt_s: float) -> int:
        """Return how many instants of a log of spacing *dt_s* a history needs before now."""
        return math.ceil(self.sim.history_s / dt_s - _SAME_S)

    def _free_instants(self, drive: LogScene, least_future_s: float) -> list[int]:
        """Return the instants, ``stride_s`` apart, at which SUMO can take the ego over."""
        stride = max(1, round(self.scene.stride_s / drive.tracks.dt_s))
        starts: list[int] = []
        for k in self._due(drive, least_future_s):
            due = not starts or k >= starts[-1] + stride
            if due and not self._hindrance(drive, k):
                starts.append(k)
        return starts

    def _hindrance(self, drive: LogScene, now: int) -> str:
        """Return why SUMO could not take the ego over without a jump, as a clause; "" where it can."""
        first = self._past_instants(drive.tracks.dt_s)
        if not drive.tracks.valid[drive.ego, now - first : now + 1].all():
            return "the ego was not there all the time before"
        xy, yaw = drive.tracks.xy_m[drive.ego, now], float(drive.tracks.yaw_rad[drive.ego, now])
        pose = self.road.locate(xy, yaw)
        if pose is None:
            return "the ego is off the lanes"
        lane = self.road.lanes[pose.lane_id]
        if lane.is_internal:
            return "the ego is on a junction"  # where lanes overlap, and SUMO may take another one
        beside = abs(pose.d_m) <= 0.5 * lane.width_m
        return "" if beside and abs(pose.yaw_error_rad) <= _ALIGNED_RAD else "the ego is askew in its lane"

    def _scene(self, drive: LogScene, now: int) -> SeedScene | None:
        tracks = drive.tracks
        first = now - self._past_instants(tracks.dt_s)
        log = tracks.window(first, tracks.steps)
        log = log.shifted(-tracks.t0_s - now * tracks.dt_s)
        near = _near_ego(log, drive.ego, self.sim.record_radius_m)
        log = log.rows(near)
        target = int(np.flatnonzero(np.flatnonzero(near) == drive.ego)[0])
        steps = now - first
        history = self._history(log.window(0, steps + 1).rows(log.valid[:, steps]))
        parked = drive.parked[near] | parked_agents(log.xy_m, log.valid, log.dt_s)  # or parks by now
        parked[target] = False
        routes = {name: route for name, route in self._routes(log, parked, target, steps) if route}
        name = f"{drive.name}-{now:03d}"
        if log.ids[target] not in routes:
            return None
        return SeedScene(
            name=name,
            net=self.road.path,
            seed=self.seed.child("log", name).integer(),
            history=history,
            target=log.ids[target],
            routes=routes,
            log=log,
            start=PlacedTraffic(_drivable(self.road, log, parked)),
            horizon_s=(tracks.steps - 1 - now) * tracks.dt_s,
        )

    def _history(self, past: Tracks) -> Tracks:
        """Return *past*, which ends now, at model steps: its own instants where these are among them."""
        step_s = self.sim.model_step_s
        stride = round(step_s / past.dt_s)
        if abs(stride * past.dt_s - step_s) < _SAME_S:
            return past.every(stride, (past.steps - 1) % stride)
        now_s = past.t0_s + past.dt_s * (past.steps - 1)
        count = int((now_s - past.t0_s) / step_s + _SAME_S) + 1
        return resample(past, step_s, t0_s=now_s - step_s * (count - 1), steps=count)

    def _routes(
        self, log: Tracks, parked: BoolArray, target: int, now: int
    ) -> Iterator[tuple[str, tuple[str, ...]]]:
        for row, name in enumerate(log.ids):
            if parked[row] or log.classes[row] == AgentClass.PEDESTRIAN:
                continue
            there = np.flatnonzero(log.valid[row, now:]) + now
            if len(there) == 0:
                continue
            driven = self.road.match_route(log.xy_m[row, there], log.yaw_rad[row, there])
            if driven:
                rng = self.seed.child("route", name, "target" if row == target else "").generator()
                yield name, (*driven[:-1], *self.road.random_route(driven[-1], _BEYOND_LOG_M, rng))


def _own_map(drives: Sequence[LogScene]) -> str:
    """Return which map *drives* were driven on, as far as they tell, as the end of a sentence."""
    places = sorted({drive.location for drive in drives} - {""})
    if places:
        return f" ({', '.join(places)})"
    records = [drive.source for drive in drives if drive.source.suffix == ".pkl"]
    return f" (advdiff-sumo convert {shlex.quote(str(records[0]))} -o NAME.net.xml)" if records else ""


def fits(road: RoadMap, drive: LogScene) -> bool:
    """Return whether *drive* was driven on *road*: the ego keeps to its lanes."""
    there = drive.tracks.valid[drive.ego]
    xy, yaw = drive.tracks.xy_m[drive.ego, there], drive.tracks.yaw_rad[drive.ego, there]
    lanes, *_ = road.locate_many(xy, yaw, max_distance_m=_FIT_M)
    return bool(np.mean([lane is not None for lane in lanes]) >= _FIT_SHARE)


def _drivable(road: RoadMap, log: Tracks, parked: BoolArray) -> BoolArray:
    """(A,) agents that first appear on a lane and along it, and are neither parked nor on foot."""
    first = log.valid.argmax(axis=1)
    rows = np.arange(log.agents)
    _, _, _, turned = road.locate_many(
        log.xy_m[rows, first], log.yaw_rad[rows, first], max_distance_m=_ON_LANE_M
    )
    along = np.abs(turned) < _ALONG_LANE_RAD  # NaN off the lanes compares as False
    return np.asarray(along & ~parked & (log.classes != AgentClass.PEDESTRIAN))


def _near_ego(log: Tracks, ego: int, radius_m: float) -> BoolArray:
    gap = np.linalg.norm(log.xy_m - log.xy_m[ego], axis=-1)
    return np.asarray((gap < radius_m).any(axis=1))
