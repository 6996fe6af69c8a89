"""The loop of an episode, step by step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.errors import NotInsertedError
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.record import Controller, EndReason, EpisodeRecord, Failure
from advdiff_sumo.core.scene import AgentClass, Scene, Tracks
from advdiff_sumo.metrics.contact import standing_overlaps, target_contact
from advdiff_sumo.planners.planner_protocol import SumoDriver
from advdiff_sumo.sim.actuate import Actuator
from advdiff_sumo.sim.background_control import Background, MovedMotion, planned_ends
from advdiff_sumo.sim.entries import have_room
from advdiff_sumo.sim.episode_context import EpisodeContext
from advdiff_sumo.sim.episode_setup import EpisodeSetup
from advdiff_sumo.sim.handover import Handover
from advdiff_sumo.sim.heartbeat import ProcessPhase
from advdiff_sumo.sim.plan_memo import PlanSource
from advdiff_sumo.sim.planned import natural_course
from advdiff_sumo.sim.recorder import Recorder
from advdiff_sumo.sim.seed_scene import PlacedTraffic, SavedTraffic, SeedScene
from advdiff_sumo.sim.session import Session
from advdiff_sumo.sim.start import TARGET_TYPE
from advdiff_sumo.sim.sumo_perception import read_signals, watch_signals
from advdiff_sumo.sim.target import PlannerDrive, SumoDrive
from advdiff_sumo.sim.target_choice import remaining_route
from advdiff_sumo.sim.world import Frame, World, read, register
from advdiff_sumo.traffic.policy_protocol import moves_everywhere

_SIGHT_M, _SIGHT_S, _BEHIND_M = 40.0, 3.0, 10.0
"""Who is so near a vehicle that we move, and not far behind it, is looked at beyond the radius, too."""
_STOPS_MPS2 = 4.0


class Loop:
    """State of a running episode; made by :class:`~advdiff_sumo.sim.episode.Episode`."""

    def __init__(
        self, episode: EpisodeSetup, session: Session, type_of_class: Mapping[AgentClass, str]
    ) -> None:
        self.episode, self.session, self.types = episode, session, type_of_class
        self.sim, self.road, self.api = episode.sim, episode.road, session.api
        self.world = World(beyond_rim=self.road.beyond_rim)
        self.actuator = Actuator(self.api, self.world, self.road)
        self.recorder = Recorder(self.world, self.sim)
        self.background = Background(
            source=PlanSource(episode.policy, episode.memo),
            road=self.road,
            world=self.world,
            log=_to_follow(episode.scene),
            rng=episode.seed.child("background").generator(),
            step_s=self.sim.step_s,
            name=episode.names[1],
            heartbeat=episode.heartbeat,
        )
        self.context = EpisodeContext(self.background, episode.scene)
        self.handover = Handover(self.world, self.actuator, self.road, self.sim)
        self.everywhere = moves_everywhere(episode.policy)
        self.target = 0
        self.ignored: BoolArray | None = None
        self.standing: BoolArray | None = None
        self.signals: Mapping[str, str] = {}
        self.target_left = False
        self.entering: set[int] = set()
        self.replayed: IntArray = np.zeros(0, dtype=np.int64)
        self.demand_brings: set[int] = set()
        self.steps = 0

    # --- the beginning -----------------------------------------------------------------------------------

    def start(self) -> None:
        """Bring SUMO to instant 0 and let target and policy prepare."""
        heartbeat = self.episode.heartbeat
        heartbeat.note(ProcessPhase.SIMULATOR)
        watch_signals(self.api)
        scene = self.episode.scene
        if isinstance(scene.start, PlacedTraffic):
            self._roll_in()
        else:
            register(self.world, self.api, self.api.vehicle.getIDList())
            self.world.remove(read(self.world, self.api, ()))
        row = self.world.row_of(scene.target)
        if row is None or row not in self.world.in_sumo:
            raise NotInsertedError(f"the target '{scene.target}' did not get into SUMO")
        self.target = row
        self.signals = read_signals(self.api)
        self.recorder.begin(scene.history)
        self._make_drive()
        frame = self.world.frame()
        size = self.world.size_m[: len(self.world)]
        self.standing = standing_overlaps(None, frame.xy_m, frame.xy_m, frame.yaw_rad, size, self.target)
        self.recorder.add(frame, self.signals, self.drive.visible())
        now = self.scene_now()
        self.drive.start(self._seen_by_target(now))
        self.background.start(now)
        heartbeat.note(ProcessPhase.SIMULATOR, 0)

    def _make_drive(self) -> None:
        episode = self.episode
        route = episode.scene.routes.get(episode.scene.target, ())
        if isinstance(episode.target, SumoDriver):
            if self.target in self.actuator.moved:
                self.actuator.release(self.target, route)
            self.drive: SumoDrive | PlannerDrive = SumoDrive(self.api, self.world, self.target)
        else:
            if self.target not in self.actuator.moved:
                self.actuator.take(self.target)
            self.drive = PlannerDrive(
                episode.target,
                self.road,
                self.actuator,
                self.target,
                route,
                episode.seed.child("target").generator(),
                episode.names[0],
                self.sim,
                episode.heartbeat,
            )

    def _roll_in(self) -> None:
        """Play a log's history, so that everybody is in SUMO, at speed, at instant 0."""
        motion = self.context.history(self.sim)
        self.replayed = self.context.rows()
        for k in range(motion.valid.shape[1]):
            if k % self.sim.substeps == 0:
                self._let_in(motion.span(k, k + self.sim.substeps))
            self._move(motion, k)
            self._advance()

    # --- the middle --------------------------------------------------------------------------------------

    def run(self, steps: int) -> EndReason:
        """Run at most *steps* and return why it ended."""
        period = self.sim.substeps * self.sim.replan_every
        while self.steps < steps:
            scene = self.scene_now()
            self.drive.replan(self._seen_by_target(scene), period)
            motion = self._plan_background(scene, period)
            self.recorder.add_plans(scene, self.drive.planned, self.background.planned)
            for k in range(min(period, steps - self.steps)):
                end = self._step(motion, k)
                if end is not None:
                    return end
        return self._end_of_time(steps)

    def _end_of_time(self, steps: int) -> EndReason:
        asked = round(self.episode.horizon_s / self.sim.step_s)
        return EndReason.LOG_END if steps < asked else EndReason.HORIZON

    def _plan_background(self, scene: Scene, period: int) -> MovedMotion:
        planned = self.background.replan(scene, period)
        planned = planned.keep(~np.isin(planned.rows, list(self.world.on_foot)) & self._have_room(planned))
        self.handover.note_routes(self.background.routes)
        logged = self.context.motion(scene, period)
        self.replayed = np.setdiff1d(logged.rows, planned.rows)
        motion = MovedMotion.join(planned, logged)
        self._leave_scene(self.actuator.refused & self.actuator.outside - set(motion.rows.tolist()))
        routes = self.episode.scene.routes
        plans = self.background.planned.tracks if self.background.planned is not None else None
        motion = self.handover.settle(motion, self.target, period, routes, self.signals, plans)
        self.handover.predict(planned_ends(motion), routes)
        self._let_in(motion)
        return motion

    def _have_room(self, motion: MovedMotion) -> BoolArray:
        """Return (M,) who of *motion* is there already, or comes in where the policy sees, or where there is room."""
        world = self.world
        logged = self.background.planned is not None and self.background.planned.exact
        out = np.isfinite(world.yaw_rad[motion.rows]) | ~motion.valid.any(axis=1) | self.everywhere | logged
        if out.all():
            return np.asarray(out)
        new = motion.keep(~out)
        k = new.valid.argmax(axis=1)
        each = np.arange(len(k))
        pose = new.xy_m[each, k], new.yaw_rad[each, k], new.speed_mps[each, k]
        seen = np.linalg.norm(pose[0] - world.xy_m[self.target], axis=-1) <= self.sim.observe_radius_m
        count = len(world)
        there = world.xy_m[:count], world.yaw_rad[:count], world.speed_mps[:count]
        out[~out] = seen | have_room(pose, there)
        return np.asarray(out)

    def _leave_scene(self, rows: set[int]) -> None:
        """Take *rows* off the scene: those that SUMO refused, once nobody moves them any more."""
        for row in sorted(rows):
            self.actuator.remove(row)
        self.world.remove(sorted(rows))

    def _step(self, motion: MovedMotion, k: int) -> EndReason | None:
        self._move(motion, k)
        self.drive.move(k)
        self._advance()
        self.steps += 1
        self.signals = read_signals(self.api)
        if self.target_left:
            return EndReason.ARRIVED
        frame = self.world.frame()
        hit = self._touches(self.recorder.frames[-1], frame)
        self.recorder.add(frame, self.signals, self.drive.visible())
        self.episode.heartbeat.note(ProcessPhase.SIMULATOR, self.steps)
        if hit and self.sim.stop_at_collision:
            return EndReason.COLLISION
        return EndReason.ARRIVED if self.drive.arrived() else None

    def _move(self, motion: MovedMotion, k: int) -> None:
        rows = motion.valid[:, k]
        for row in motion.rows[~rows].tolist():
            if row in self.actuator.ours:
                self.actuator.remove(row)
                self.world.remove([row])
        if self.demand_brings:
            rows = rows & ~np.isin(motion.rows, list(self.demand_brings - self.world.had_in_sumo))
        there = motion.rows[rows]
        who = np.where(np.isin(there, self.replayed), Controller.REPLAYED, Controller.POLICY)
        self.world.set_state(
            there, motion.xy_m[rows, k], motion.yaw_rad[rows, k], motion.speed_mps[rows, k], who
        )
        for row in there.tolist():
            if row not in self.actuator.moved:
                self._take_or_insert(row)
        self.actuator.move(there, motion.xy_m[rows, k], motion.yaw_rad[rows, k])

    def _take_or_insert(self, row: int) -> None:
        if row in self.world.in_sumo:
            self.handover.note_own_route(
                row, remaining_route(self.api, self.world.sumo_ids[row], self.road.beyond_rim)
            )
            self.actuator.take(row)
        elif row not in self.entering:
            self.actuator.outside.add(row)
        else:
            self.entering.discard(row)
            is_target = self.world.ids[row] == self.episode.scene.target
            agent_class = AgentClass(int(self.world.classes[row]))
            if is_target:
                self.actuator.insert(row, TARGET_TYPE)
            else:
                self.actuator.try_insert(row, self.types[agent_class])

    def _let_in(self, motion: MovedMotion) -> None:
        """Note which of the vehicles outside SUMO get onto a lane during *motion*, and which SUMO will bring."""
        if isinstance(self.episode.scene.start, SavedTraffic):
            of_demand = self.episode.scene.log.index
            waited = set(motion.rows.tolist()) - self.world.had_in_sumo
            self.demand_brings = {row for row in waited if self.world.ids[row] in of_demand}
        waiting = ~np.isin(motion.rows, [*self.actuator.moved, *self.actuator.refused]) & motion.valid.any(
            axis=1
        )
        rows, valid = motion.rows[waiting], motion.valid[waiting]
        self.entering = set()
        if len(rows):
            every = np.arange(len(rows))
            for k in (valid.argmax(axis=1), valid.shape[1] - 1 - valid[:, ::-1].argmax(axis=1)):
                poses = motion.xy_m[waiting][every, k], motion.yaw_rad[waiting][every, k]
                self.entering |= self.actuator.on_lanes(rows, *poses)

    def _advance(self) -> None:
        """Let SUMO step and read what it did; our own states win for vehicles that we move."""
        self.session.step()
        departed = register(self.world, self.api, self.api.simulation.getDepartedIDList())
        self.actuator.settle(departed)
        moved, ours = self.actuator.moved, self.actuator.ours
        gone = read(self.world, self.api, ours).tolist()
        self.target_left = self.target in gone and self.target not in self.actuator.outside
        self.world.remove([row for row in gone if row not in ours])
        for row in gone:
            if row in moved and moved[row].inserted:  # past its lane's end it has left SUMO, not the scene
                moved.pop(row)
                self.actuator.outside.add(row)
        beside = self.actuator.leave_lanes()
        self.entering |= self.actuator.on_lanes(beside, self.world.xy_m[beside], self.world.yaw_rad[beside])
        self.recorder.note(self.api)

    def _touches(self, before: Frame, now: Frame) -> bool:
        """Return whether the target touches anybody in this step; overlaps that a log begins with do not count."""
        n = len(now.yaw_rad)
        size = self.world.size_m[:n]
        xy0, yaw0 = _padded(before, n)
        ignore = self._grown(n)
        contact = target_contact(
            xy0, yaw0, now.xy_m, now.yaw_rad, size, self.target, ignore=ignore, dt_s=self.sim.step_s
        )
        self.standing = standing_overlaps(
            ignore, xy0, now.xy_m, now.yaw_rad, size, self.target, dt_s=self.sim.step_s
        )
        return contact is not None

    def _grown(self, n: int) -> BoolArray:
        old = self.standing if self.standing is not None else np.zeros(0, dtype=np.bool_)
        return np.concatenate((old, np.zeros(n - len(old), dtype=np.bool_)))

    # --- what planners see -------------------------------------------------------------------------------

    def scene_now(self) -> Scene:
        """Return the scene around the target now, as the policy sees it."""
        world, target = self.world, self.target
        gap = np.linalg.norm(world.xy_m[: len(world)] - world.xy_m[target], axis=-1)
        seen = np.isfinite(gap)
        if not self.everywhere:
            seen &= (gap <= self.sim.observe_radius_m) | self._in_the_way()
        rows = np.flatnonzero(seen)
        history = self.recorder.history(rows, self.time_s)
        return Scene(
            history=history,
            target=int(np.flatnonzero(rows == target)[0]),
            movable=self._movable(rows, gap[rows]),
            routes=tuple(self._route(row) for row in rows.tolist()),
            signals=self.signals,
        )

    def _seen_by_target(self, scene: Scene) -> Scene:
        """Return *scene* as far as the target sees."""
        now = scene.history.xy_m[:, -1]
        gap = np.linalg.norm(now - now[scene.target], axis=-1)
        return scene.without(gap > self.sim.observe_radius_m)

    def _in_the_way(self) -> BoolArray:
        """Return (n,) whom a vehicle that we move may meet, however far from the target both are."""
        world = self.world
        moved = np.array(self._others_moved(), dtype=np.int64)
        offset = world.xy_m[: len(world), None] - world.xy_m[moved]
        ahead_m = (offset * unit(world.yaw_rad[moved])).sum(axis=-1)
        sight_m = np.maximum(_SIGHT_M, _SIGHT_S * world.speed_mps[moved])
        near = (np.linalg.norm(offset, axis=-1) <= sight_m) & (ahead_m >= -_BEHIND_M)  # NaN compares as False
        return np.asarray(near.any(axis=1))

    def _movable(self, rows: IntArray, gap_m: FloatArray) -> BoolArray:
        others: BoolArray = (rows != self.target) & ~np.isin(rows, list(self.world.on_foot))
        if self.everywhere:
            return others
        ours = self.actuator.ours
        moved = np.array([row in ours for row in rows.tolist()], dtype=np.bool_)
        radius = np.where(moved, self.sim.release_factor, 1.0) * self.sim.control_radius_m
        radius[np.isin(rows, self._inside_junctions())] = np.inf
        on_lane = np.array([bool(self.world.lane[row]) for row in rows.tolist()], dtype=np.bool_)
        free = ~np.isin(rows, self.context.rows())
        movable = np.asarray(others & (gap_m <= radius) & (on_lane | moved) & free)
        for k in np.flatnonzero(movable & ~moved).tolist():
            movable[k] = not self._arrives(int(rows[k]))
        return movable

    def _arrives(self, row: int) -> bool:
        """Return whether SUMO takes *row* off the net before it could stop: it looks at nobody beyond its goal."""
        vehicle, name = self.api.vehicle, self.world.sumo_ids[row]
        goal = vehicle.getRoute(name)[-1]
        left_m = float(vehicle.getDrivingDistance(name, goal, self.api.lane.getLength(f"{goal}_0")))
        return bool(0.0 <= left_m < 0.5 * self.world.speed_mps[row] ** 2 / _STOPS_MPS2)

    def _others_moved(self) -> list[int]:
        """Return the rows that we move in SUMO, without the target."""
        return sorted(self.actuator.moved.keys() - {self.target})

    def _inside_junctions(self) -> IntArray:
        """Return the rows of moved vehicles inside a junction, where nobody changes hands."""
        lanes = self.road.lanes
        names = ((row, self.world.lane[row]) for row in self._others_moved())
        inside = [row for row, name in names if name in lanes and lanes[name].is_internal]
        return np.array(inside, dtype=np.int64)

    def _route(self, row: int) -> tuple[str, ...]:
        if row == self.target:
            return self.drive.route_ahead()
        if row in self.actuator.ours:
            return self.handover.route(row, self.episode.scene.routes)
        if row in self.world.on_foot:
            return ()
        return remaining_route(self.api, self.world.sumo_ids[row], self.road.beyond_rim)

    @property
    def time_s(self) -> float:
        """Time since the episode's start."""
        return self.steps * self.sim.step_s

    # --- the end -----------------------------------------------------------------------------------------

    def record(self, end: EndReason, failure: Failure | None) -> EpisodeRecord:
        """Return everything that happened."""
        episode = self.episode
        record = self.recorder.finish(self.target)
        return replace(
            record,
            episode=episode.number,
            seed=episode.scene.seed,
            scene=episode.scene.name,
            route=episode.scene.routes.get(episode.scene.target, ()),
            end=end,
            visible=record.visible if isinstance(episode.target, SumoDriver) else None,
            rough_handovers=len(self.handover.rough),
            skipped_agents=len(self.background.skipped),
            refused_insertions=len(self.actuator.refused),
            attack=self.background.attack,
            in_position=self.background.in_position if self.background.attack is not None else None,
            manoeuvres=self.background.manoeuvres,
            implausible=self.drive.implausible if isinstance(self.drive, PlannerDrive) else (0, ""),
            safeguarded=self.background.safeguarded,
            failure=failure,
            natural=natural_course(episode.scene.log, self.sim.model_step_s)
            if self.sim.record_natural
            else None,
        )

    def leave(self, record: EpisodeRecord) -> None:
        """Let the target's planner know that the episode is over."""
        drive, failure = getattr(self, "drive", None), record.failure
        if drive is not None:
            drive.end(str(record.end), self.time_s, failure.message if failure is not None else "")

    def planning_s(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return the wall-clock of every plan of target and policy."""
        drive = getattr(self, "drive", None)
        return tuple(drive.planning_s) if drive else (), tuple(self.background.planning_s)


def _to_follow(scene: SeedScene) -> Tracks:
    """Return the log that the policy may follow; in SUMO's traffic people walk by SUMO's own model."""
    if isinstance(scene.start, PlacedTraffic):
        return scene.log
    return scene.log.rows(scene.log.classes != AgentClass.PEDESTRIAN)


def _padded(frame: Frame, n: int) -> tuple[FloatArray, FloatArray]:
    """Return positions and headings of *frame* with absent rows up to *n*."""
    more = n - len(frame.yaw_rad)
    if not more:
        return frame.xy_m, frame.yaw_rad
    xy = np.concatenate((frame.xy_m, np.full((more, 2), np.nan)))
    return xy, np.concatenate((frame.yaw_rad, np.full(more, np.nan)))
