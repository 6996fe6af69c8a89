"""Run the loop of an episode: observe, plan, move, let SUMO step, record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.errors import NotInsertedError
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.record import Controller, EndReason, EpisodeRecord, Failure
from advdiff_sumo.core.scene import AgentClass, Scene, Tracks
from advdiff_sumo.metrics.target_contact import standing_overlaps, target_contact
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
from advdiff_sumo.sim.target_route import remaining_route
from advdiff_sumo.sim.world import Frame, World, read, register
from advdiff_sumo.traffic.policy_protocol import moves_everywhere

# The policy also sees road users beyond its radius that are near a moved vehicle: within the larger of this distance
# and of this time at the moved vehicle's speed, and at most so far behind it.
_SIGHT_M, _SIGHT_S, _BEHIND_M = 40.0, 3.0, 10.0
_BRAKING_MPS2 = 4.0


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
            log=_log_for_policy(episode.scene),
            rng=episode.seed.child("background").generator(),
            step_s=self.sim.step_s,
            name=episode.names[1],
            heartbeat=episode.heartbeat,
        )
        self.context = EpisodeContext(self.background, episode.scene)
        self.handover = Handover(self.world, self.actuator, self.road, self.sim)
        self.policy_moves_all = moves_everywhere(episode.policy)
        self.target = 0
        self.old_overlaps: BoolArray | None = None
        self.signals: Mapping[str, str] = {}
        self.target_left = False
        self.entering: set[int] = set()
        self.is_on_lane: BoolArray = np.zeros((0, 0), dtype=np.bool_)
        self.replayed: IntArray = np.zeros(0, dtype=np.int64)
        self.awaited_from_demand: set[int] = set()
        self.steps = 0

    # --- start -------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Bring SUMO to instant 0 and start target and policy."""
        heartbeat = self.episode.heartbeat
        heartbeat.note(ProcessPhase.SIMULATOR)
        watch_signals(self.api)
        scene = self.episode.scene
        if isinstance(scene.start, PlacedTraffic):
            self._play_history()
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
        self.old_overlaps = standing_overlaps(None, frame.xy_m, frame.xy_m, frame.yaw_rad, size, self.target)
        self.recorder.add(frame, self.signals, self.drive.visible())
        scene_now = self.scene_now()
        self.drive.start(self._seen_by_target(scene_now))
        self.background.start(scene_now)
        heartbeat.note(ProcessPhase.SIMULATOR, 0)

    def _make_drive(self) -> None:
        """Create what drives the target: SUMO, or the planner."""
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

    def _play_history(self) -> None:
        """Play a log's history, so that at instant 0 all its vehicles are in SUMO and at speed."""
        motion = part = self.context.history(self.sim)
        self.replayed = self.context.rows()
        for k in range(motion.valid.shape[1]):
            substep = k % self.sim.substeps
            if substep == 0:
                part = motion.span(k, k + self.sim.substeps)
                self._note_entering(part)
            self._move(part, substep)
            self._advance()

    # --- stepping ----------------------------------------------------------------------------------------

    def run(self, steps: int) -> EndReason:
        """Run until *steps* steps are done, at most, and return why it ended."""
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
        """Return whether the horizon or the log ended after *steps*."""
        horizon_steps = round(self.episode.horizon_s / self.sim.step_s)
        return EndReason.LOG_END if steps < horizon_steps else EndReason.HORIZON

    def _plan_background(self, scene: Scene, period: int) -> MovedMotion:
        """Let the policy plan, and return the motion of all background vehicles that are moved until the next plan."""
        planned = self.background.replan(scene, period)
        planned = planned.keep(~np.isin(planned.rows, list(self.world.on_foot)) & self._may_appear(planned))
        self.handover.note_routes(self.background.routes)
        logged = self.context.motion(scene, period)
        self.replayed = np.setdiff1d(logged.rows, planned.rows)
        motion = MovedMotion.join(planned, logged)
        self._leave_scene(self.actuator.refused & self.actuator.outside - set(motion.rows.tolist()))
        routes = self.episode.scene.routes
        plans = self.background.planned.tracks if self.background.planned is not None else None
        motion = self.handover.release_or_align(motion, self.target, period, routes, self.signals, plans)
        self.handover.predict(planned_ends(motion), routes)
        self._note_entering(motion)
        return motion

    def _may_appear(self, motion: MovedMotion) -> BoolArray:
        """Return (M,) which vehicles of *motion* are present, appear in the policy's view, or have room to appear."""
        world = self.world
        follows_log = self.background.planned is not None and self.background.planned.exact
        is_present = np.isfinite(world.yaw_rad[motion.rows])
        may_appear = is_present | ~motion.valid.any(axis=1) | self.policy_moves_all | follows_log
        if may_appear.all():
            return np.asarray(may_appear)
        new = motion.keep(~may_appear)
        first = new.valid.argmax(axis=1)
        rows = np.arange(len(first))
        states = new.xy_m[rows, first], new.yaw_rad[rows, first], new.speed_mps[rows, first]
        in_view = np.linalg.norm(states[0] - world.xy_m[self.target], axis=-1) <= self.sim.observe_radius_m
        count = len(world)
        present_states = world.xy_m[:count], world.yaw_rad[:count], world.speed_mps[:count]
        may_appear[~may_appear] = in_view | have_room(states, present_states)
        return np.asarray(may_appear)

    def _leave_scene(self, rows: set[int]) -> None:
        """Remove *rows* from the scene: vehicles that SUMO refused and that are no longer moved."""
        for row in sorted(rows):
            self.actuator.remove(row)
        self.world.remove(sorted(rows))

    def _step(self, motion: MovedMotion, k: int) -> EndReason | None:
        """Move all vehicles by substep *k*, let SUMO step and record; return the reason if the episode ends."""
        self._move(motion, k)
        self.drive.move(k)
        self._advance()
        self.steps += 1
        self.signals = read_signals(self.api)
        if self.target_left:
            return EndReason.ARRIVED
        frame = self.world.frame()
        collides = self._target_collides(self.recorder.frames[-1], frame)
        self.recorder.add(frame, self.signals, self.drive.visible())
        self.episode.heartbeat.note(ProcessPhase.SIMULATOR, self.steps)
        if collides and self.sim.stop_at_collision:
            return EndReason.COLLISION
        return EndReason.ARRIVED if self.drive.arrived() else None

    def _move(self, motion: MovedMotion, k: int) -> None:
        """Put all moved vehicles where *motion* has them at substep *k*; remove those that are gone by then."""
        valid = motion.valid[:, k]
        controlled = self.actuator.controlled_rows
        for row in motion.rows[~valid].tolist():
            if row in controlled:
                self.actuator.remove(row)
                self.world.remove([row])
        if self.awaited_from_demand:
            valid = valid & ~np.isin(motion.rows, list(self.awaited_from_demand - self.world.had_in_sumo))
        rows = motion.rows[valid]
        controllers = np.where(np.isin(rows, self.replayed), Controller.REPLAYED, Controller.POLICY)
        self.world.set_state(
            rows, motion.xy_m[valid, k], motion.yaw_rad[valid, k], motion.speed_mps[valid, k], controllers
        )
        for row in rows.tolist():
            if row not in self.actuator.moved:
                self._take_or_insert(row)
        self.actuator.move(rows, motion.xy_m[valid, k], motion.yaw_rad[valid, k], self.is_on_lane[valid, k])

    def _take_or_insert(self, row: int) -> None:
        """Begin to move *row*: take it from SUMO, insert it, or keep it outside SUMO while it is off the lanes."""
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

    def _note_entering(self, motion: MovedMotion) -> None:
        """Note when vehicles are on a lane during *motion*, and which SUMO's demand or the loop will insert."""
        self.is_on_lane = self.actuator.is_on_lane(motion.rows, motion.xy_m, motion.yaw_rad)
        if isinstance(self.episode.scene.start, SavedTraffic):
            demand_ids = self.episode.scene.log.index
            new_rows = set(motion.rows.tolist()) - self.world.had_in_sumo
            self.awaited_from_demand = {row for row in new_rows if self.world.ids[row] in demand_ids}
        is_outside = ~np.isin(motion.rows, [*self.actuator.moved, *self.actuator.refused]) & motion.valid.any(
            axis=1
        )
        rows, valid = motion.rows[is_outside], motion.valid[is_outside]
        first, last = valid.argmax(axis=1), valid.shape[1] - 1 - valid[:, ::-1].argmax(axis=1)
        ends = np.take_along_axis(self.is_on_lane[is_outside], np.stack((first, last), axis=1), axis=1)
        self.entering = set(rows[ends.any(axis=1)].tolist())

    def _advance(self) -> None:
        """Let SUMO step and read the result; for vehicles that are moved, the package's own states apply."""
        self.session.step()
        departed = register(self.world, self.api, self.api.simulation.getDepartedIDList())
        self.actuator.take_inserted(departed)
        moved, controlled = self.actuator.moved, self.actuator.controlled_rows
        lost_rows = read(self.world, self.api, controlled).tolist()
        self.target_left = self.target in lost_rows and self.target not in self.actuator.outside
        self.world.remove([row for row in lost_rows if row not in controlled])
        for row in lost_rows:
            if row in moved and moved[row].inserted:  # past its lane's end it has left SUMO, not the scene
                moved.pop(row)
                self.actuator.outside.add(row)
        rows = self.actuator.remove_off_lanes()
        if len(rows):
            self.entering |= self.actuator.on_lanes(rows, self.world.xy_m[rows], self.world.yaw_rad[rows])
        self.recorder.note(self.api)

    def _target_collides(self, before: Frame, now: Frame) -> bool:
        """Return whether the target touches a road user in this step; overlaps that a log begins with do not count."""
        n = len(now.yaw_rad)
        size = self.world.size_m[:n]
        xy0, yaw0 = _padded(before, n)
        ignored = self._overlaps_to_ignore(n)
        contact = target_contact(
            xy0, yaw0, now.xy_m, now.yaw_rad, size, self.target, ignore=ignored, dt_s=self.sim.step_s
        )
        self.old_overlaps = standing_overlaps(
            ignored, xy0, now.xy_m, now.yaw_rad, size, self.target, dt_s=self.sim.step_s
        )
        return contact is not None

    def _overlaps_to_ignore(self, n: int) -> BoolArray:
        """Return (n,) which rows have overlapped the target since the start; the mask is extended for new rows."""
        known = self.old_overlaps if self.old_overlaps is not None else np.zeros(0, dtype=np.bool_)
        return np.concatenate((known, np.zeros(n - len(known), dtype=np.bool_)))

    # --- observations ------------------------------------------------------------------------------------

    def scene_now(self) -> Scene:
        """Return the present scene around the target, as the policy sees it."""
        world, target = self.world, self.target
        distance = np.linalg.norm(world.xy_m[: len(world)] - world.xy_m[target], axis=-1)
        is_seen = np.isfinite(distance)
        if not self.policy_moves_all:
            is_seen &= (distance <= self.sim.observe_radius_m) | self._near_moved_vehicles()
        rows = np.flatnonzero(is_seen)
        history = self.recorder.history(rows, self.time_s)
        return Scene(
            history=history,
            target=int(np.flatnonzero(rows == target)[0]),
            movable=self._movable(rows, distance[rows]),
            routes=tuple(self._route(row) for row in rows.tolist()),
            signals=self.signals,
        )

    def _seen_by_target(self, scene: Scene) -> Scene:
        """Return *scene* limited to the target's radius of observation."""
        now = scene.history.xy_m[:, -1]
        distance = np.linalg.norm(now - now[scene.target], axis=-1)
        return scene.without(distance > self.sim.observe_radius_m)

    def _near_moved_vehicles(self) -> BoolArray:
        """Return (n,) which rows may come into conflict with a moved vehicle, at any distance from the target."""
        world = self.world
        moved = np.array(self._moved_background(), dtype=np.int64)
        offset = world.xy_m[: len(world), None] - world.xy_m[moved]
        ahead_m = (offset * unit(world.yaw_rad[moved])).sum(axis=-1)
        sight_m = np.maximum(_SIGHT_M, _SIGHT_S * world.speed_mps[moved])
        near = (np.linalg.norm(offset, axis=-1) <= sight_m) & (ahead_m >= -_BEHIND_M)  # NaN compares as False
        return np.asarray(near.any(axis=1))

    def _movable(self, rows: IntArray, distance_m: FloatArray) -> BoolArray:
        """Return (N,) which of *rows*, at distances (N,) from the target, the policy may move."""
        is_background: BoolArray = (rows != self.target) & ~np.isin(rows, list(self.world.on_foot))
        if self.policy_moves_all:
            return is_background
        controlled = self.actuator.controlled_rows
        is_moved = np.array([row in controlled for row in rows.tolist()], dtype=np.bool_)
        radius = np.where(is_moved, self.sim.release_factor, 1.0) * self.sim.control_radius_m
        radius[np.isin(rows, self._inside_junctions())] = np.inf
        is_on_lane = np.array([bool(self.world.lane[row]) for row in rows.tolist()], dtype=np.bool_)
        is_not_logged = ~np.isin(rows, self.context.rows())
        movable = np.asarray(is_background & (distance_m <= radius) & (is_on_lane | is_moved) & is_not_logged)
        for k in np.flatnonzero(movable & ~is_moved).tolist():
            movable[k] = not self._arrives_soon(int(rows[k]))
        return movable

    def _arrives_soon(self, row: int) -> bool:
        """Return whether *row* reaches its goal, where SUMO removes it, before it could stop.

        SUMO's drivers ignore what lies beyond their goal.
        """
        vehicle, name = self.api.vehicle, self.world.sumo_ids[row]
        goal = vehicle.getRoute(name)[-1]
        remaining_m = float(vehicle.getDrivingDistance(name, goal, self.api.lane.getLength(f"{goal}_0")))
        return bool(0.0 <= remaining_m < 0.5 * self.world.speed_mps[row] ** 2 / _BRAKING_MPS2)

    def _moved_background(self) -> list[int]:
        """Return the rows of background vehicles that are moved in SUMO."""
        return sorted(self.actuator.moved.keys() - {self.target})

    def _inside_junctions(self) -> IntArray:
        """Return the rows of moved vehicles inside a junction, where no vehicle is handed back."""
        lanes = self.road.lanes
        lane_of_row = ((row, self.world.lane[row]) for row in self._moved_background())
        inside = [row for row, lane in lane_of_row if lane in lanes and lanes[lane].is_internal]
        return np.array(inside, dtype=np.int64)

    def _route(self, row: int) -> tuple[str, ...]:
        """Return the edges that *row* is expected to drive, whoever moves it."""
        if row == self.target:
            return self.drive.route_ahead()
        if row in self.actuator.controlled_rows:
            return self.handover.route(row, self.episode.scene.routes)
        if row in self.world.on_foot:
            return ()
        return remaining_route(self.api, self.world.sumo_ids[row], self.road.beyond_rim)

    @property
    def time_s(self) -> float:
        """Time since the episode's start."""
        return self.steps * self.sim.step_s

    # --- end ---------------------------------------------------------------------------------------------

    def record(self, end: EndReason, failure: Failure | None) -> EpisodeRecord:
        """Return the record of the episode."""
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
            rough_handovers=len(self.handover.misaligned_ids),
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
        """Tell the target's planner that the episode is over."""
        drive, failure = getattr(self, "drive", None), record.failure
        if drive is not None:
            drive.end(str(record.end), self.time_s, failure.message if failure is not None else "")

    def planning_s(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return the wall-clock seconds of each plan of the target, and of the policy."""
        drive = getattr(self, "drive", None)
        return tuple(drive.planning_s) if drive else (), tuple(self.background.planning_s)


def _log_for_policy(scene: SeedScene) -> Tracks:
    """Return the log that the policy may follow; without pedestrians in SUMO traffic, as SUMO's model moves them."""
    if isinstance(scene.start, PlacedTraffic):
        return scene.log
    return scene.log.rows(scene.log.classes != AgentClass.PEDESTRIAN)


def _padded(frame: Frame, n: int) -> tuple[FloatArray, FloatArray]:
    """Return positions and headings of *frame*, extended to *n* rows with NaN."""
    missing = n - len(frame.yaw_rad)
    if not missing:
        return frame.xy_m, frame.yaw_rad
    xy = np.concatenate((frame.xy_m, np.full((missing, 2), np.nan)))
    return xy, np.concatenate((frame.yaw_rad, np.full(missing, np.nan)))
