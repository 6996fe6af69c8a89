"""Make seed scenes from driving logs, on a net that was converted from the log's own map."""

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

# SUMO may drive vehicles that first appear within these limits of a lane.
_ON_LANE_M, _ALONG_LANE_RAD = 1.5, 0.6
_ALIGNED_RAD = 0.1  # largest heading error at which SUMO takes the ego over
_MIN_FUTURE_S = 6.0  # log after a start
_SHORTEST_FUTURE_S = 1.5  # the same in logs that are too short for it
_BEYOND_LOG_M = 300.0  # random route beyond the driven one
_FIT_SHARE, _FIT_M = 0.8, 3.0  # share of the ego's positions that must be this near to a lane
_SAME_S = 1e-6
_NO_ROUTE = "no route of the net follows the ego"


@dataclass(frozen=True)
class LoggedTraffic:
    """Makes seed scenes from a log: one every ``stride_s`` or more of each drive that fits the net.

    Attributes:
        road: the net.
        reader: of the log.
        scene: the stride, and the ego's lowest speed.
        sim: steps and radii.
        seed: the source's node of the seed tree.
        late: whether starts with less than 6 s of log after them are allowed if there are no others.
    """

    road: RoadMap
    reader: LogReader
    scene: SceneOptions
    sim: SimOptions
    seed: SeedTree
    late: bool = True

    def scenes(self) -> Iterator[SeedScene]:
        """Yield the seed scenes in the log's order: the first starts of all drives, then their second starts, etc.

        Raises:
            SceneError: no drive of the log was on this net.
        """
        logged = list(self.reader.scenes())
        drives = [drive for drive in logged if fits(self.road, drive)]
        if not drives:
            problem = "none of the log's drives is on this net"
            raise SceneError(f"{self.road.path}: {problem}; convert the log's own map{_map_hint(logged)}")
        starts, standing = self._starts(drives)
        if not any(starts) and standing:
            raise SceneError(
                f"{self.road.path}: the log's ego is never faster than {self.scene.min_speed_mps:g} m/s where a scene "
                "could start; lower scene.min_speed_mps"
            )
        for number in range(max(len(s) for s in starts)):
            for drive, instants in zip(drives, starts, strict=True):
                if number < len(instants):
                    scene = self._scene(drive, instants[number])
                    if scene is not None:
                        yield scene

    def standing_starts(self) -> int:
        """Return how many starts are skipped because the ego is slower there than ``min_speed_mps``."""
        return self._starts([drive for drive in self.reader.scenes() if fits(self.road, drive)])[1]

    def _starts(self, drives: list[LogScene]) -> tuple[list[list[int]], int]:
        """Return each drive's starts at which the ego is fast enough, and the number of starts at which it is not.

        With ``late``, starts with less than ``_MIN_FUTURE_S`` of log after them count if no drive has another start.
        """
        moving, standing = [list[int]() for _ in drives], 0
        for future_s in (_MIN_FUTURE_S, _SHORTEST_FUTURE_S) if self.late else (_MIN_FUTURE_S,):
            takeovers = [self._takeover_instants(drive, future_s) for drive in drives]
            moving = [
                [k for k in instants if self._is_moving(drive, k)]
                for drive, instants in zip(drives, takeovers, strict=True)
            ]
            standing = sum(map(len, takeovers)) - sum(map(len, moving))
            if any(moving):
                break
        return moving, standing

    def _is_moving(self, drive: LogScene, now: int) -> bool:
        return bool(np.abs(drive.tracks.speed_mps[drive.ego, now]) >= self.scene.min_speed_mps)

    def why_none(self) -> str:
        """Return why the log gives no seed scene, and what helps, as the end of a sentence."""
        drives = [drive for drive in self.reader.scenes() if fits(self.road, drive)]
        obstacles = Counter(
            self._obstacle(drive, k)
            for drive in drives
            for k in self._possible_instants(drive, _MIN_FUTURE_S)
        )
        if not obstacles:
            longest_s = max((drive.tracks.steps - 1) * drive.tracks.dt_s for drive in drives)
            return (
                f"it has {longest_s:.1f} s at most, and {self.sim.history_s:g} s before a start and "
                f"{_SHORTEST_FUTURE_S:g} s after it are needed; give a longer log"
            )
        listed = ", ".join(
            f"{obstacle or _NO_ROUTE} (at {count} of {obstacles.total()} instants)"
            for obstacle, count in obstacles.most_common()
        )
        return (
            f"where one could start, {listed}; give a log whose ego drives along a lane "
            f"{self.sim.history_s:g} s after it appears and {_SHORTEST_FUTURE_S:g} s before the end"
        )

    def _possible_instants(self, drive: LogScene, least_future_s: float) -> range:
        """Return the instants with a whole history before them and enough of the drive after them.

        Enough is *least_future_s*, or what the drive has after its first history, but ``_SHORTEST_FUTURE_S`` at least.
        """
        dt = drive.tracks.dt_s
        first = self._history_instants(dt)
        future_s = min(least_future_s, max(_SHORTEST_FUTURE_S, (drive.tracks.steps - 1 - first) * dt))
        return range(first, drive.tracks.steps - round(future_s / dt))

    def _history_instants(self, dt_s: float) -> int:
        """Return how many instants before the present a history needs in a log of spacing *dt_s*."""
        return math.ceil(self.sim.history_s / dt_s - _SAME_S)

    def _takeover_instants(self, drive: LogScene, least_future_s: float) -> list[int]:
        """Return the instants, ``stride_s`` or more apart, at which SUMO can take over the ego."""
        stride = max(1, round(self.scene.stride_s / drive.tracks.dt_s))
        starts: list[int] = []
        for k in self._possible_instants(drive, least_future_s):
            is_due = not starts or k >= starts[-1] + stride
            if is_due and not self._obstacle(drive, k):
                starts.append(k)
        return starts

    def _obstacle(self, drive: LogScene, now: int) -> str:
        """Return why SUMO could not take over the ego without a jump at instant *now*, as a clause; "" if it can."""
        first = self._history_instants(drive.tracks.dt_s)
        if not drive.tracks.valid[drive.ego, now - first : now + 1].all():
            return "the ego was not there all the time before"
        xy, yaw = drive.tracks.xy_m[drive.ego, now], float(drive.tracks.yaw_rad[drive.ego, now])
        pose = self.road.locate(xy, yaw)
        if pose is None:
            return "the ego is off the lanes"
        lane = self.road.lanes[pose.lane_id]
        if lane.is_internal:
            return "the ego is on a junction"  # lanes overlap there, and SUMO may put it on another one
        is_in_lane = abs(pose.d_m) <= 0.5 * lane.width_m
        return (
            "" if is_in_lane and abs(pose.yaw_error_rad) <= _ALIGNED_RAD else "the ego is askew in its lane"
        )

    def _scene(self, drive: LogScene, now: int) -> SeedScene | None:
        """Return the seed scene of *drive* that starts at instant *now*; None if the net has no route for the ego."""
        tracks = drive.tracks
        first = now - self._history_instants(tracks.dt_s)
        log = tracks.window(first, tracks.steps)
        log = log.shifted(-tracks.t0_s - now * tracks.dt_s)
        is_near = _is_near_ego(log, drive.ego, self.sim.record_radius_m)
        log = log.rows(is_near)
        target = int(np.flatnonzero(np.flatnonzero(is_near) == drive.ego)[0])
        steps = now - first
        history = self._history(log.window(0, steps + 1).rows(log.valid[:, steps]))
        # vehicles that move before the scene may be parked during it
        parked = drive.parked[is_near] | parked_agents(log.xy_m, log.valid, log.dt_s)
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
            start=PlacedTraffic(_is_drivable(self.road, log, parked)),
            horizon_s=(tracks.steps - 1 - now) * tracks.dt_s,
        )

    def _history(self, past: Tracks) -> Tracks:
        """Return *past*, which ends at the start, at model steps; the log's own instants if these include them."""
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
        """Yield (id, edges) of the agents that drive: the route driven from *now* on, and a random continuation."""
        for row, name in enumerate(log.ids):
            if parked[row] or log.classes[row] == AgentClass.PEDESTRIAN:
                continue
            present = np.flatnonzero(log.valid[row, now:]) + now
            if len(present) == 0:
                continue
            driven = self.road.match_route(log.xy_m[row, present], log.yaw_rad[row, present])
            if driven:
                rng = self.seed.child("route", name, "target" if row == target else "").generator()
                yield name, (*driven[:-1], *self.road.random_route(driven[-1], _BEYOND_LOG_M, rng))


def _map_hint(drives: Sequence[LogScene]) -> str:
    """Return on which map *drives* were driven, if they say so, as the end of a sentence."""
    locations = sorted({drive.location for drive in drives} - {""})
    if locations:
        return f" ({', '.join(locations)})"
    records = [drive.source for drive in drives if drive.source.suffix == ".pkl"]
    return f" (advdiff-sumo convert {shlex.quote(str(records[0]))} -o NAME.net.xml)" if records else ""


def fits(road: RoadMap, drive: LogScene) -> bool:
    """Return whether *drive* was driven on *road*: whether the ego is near its lanes most of the time."""
    present = drive.tracks.valid[drive.ego]
    xy, yaw = drive.tracks.xy_m[drive.ego, present], drive.tracks.yaw_rad[drive.ego, present]
    lanes, *_ = road.locate_many(xy, yaw, max_distance_m=_FIT_M)
    return bool(np.mean([lane is not None for lane in lanes]) >= _FIT_SHARE)


def _is_drivable(road: RoadMap, log: Tracks, parked: BoolArray) -> BoolArray:
    """Return (A,) which agents first appear on a lane and along it, and are neither parked nor pedestrians."""
    first = log.valid.argmax(axis=1)
    rows = np.arange(log.agents)
    _, _, _, yaw_error = road.locate_many(
        log.xy_m[rows, first], log.yaw_rad[rows, first], max_distance_m=_ON_LANE_M
    )
    is_along_lane = np.abs(yaw_error) < _ALONG_LANE_RAD  # NaN off the lanes compares as False
    return np.asarray(is_along_lane & ~parked & (log.classes != AgentClass.PEDESTRIAN))


def _is_near_ego(log: Tracks, ego: int, radius_m: float) -> BoolArray:
    """Return (A,) which agents ever come within *radius_m* of the ego."""
    distance = np.linalg.norm(log.xy_m - log.xy_m[ego], axis=-1)
    return np.asarray((distance < radius_m).any(axis=1))
