"""Move the background vehicles: ask the policy for plans and turn them into states every 0.1 s."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.bicycle import Limits
from advdiff_sumo.core.errors import PlanRefusedError
from advdiff_sumo.core.kinematic_states import KinematicStates
from advdiff_sumo.core.plan import JointPlan
from advdiff_sumo.core.resample import resample
from advdiff_sumo.core.scene import AgentClass, Scene, Tracks
from advdiff_sumo.core.tracking import State, densify, track
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.entries import completed, presence
from advdiff_sumo.sim.heartbeat import Heartbeat, ProcessPhase
from advdiff_sumo.sim.plan_memo import PlanSource
from advdiff_sumo.sim.plan_validation import check_joint_form, check_joint_plan
from advdiff_sumo.sim.plug_in_guard import PlugInGuard
from advdiff_sumo.sim.world import World
from advdiff_sumo.traffic.sumo_traffic import plans_nothing


@dataclass(frozen=True)
class MovedMotion(KinematicStates):
    """States of the moved vehicles until the next plan; M vehicles, n substeps.

    Attributes:
        xy_m, yaw_rad, speed_mps: (M, n, 2), (M, n), (M, n) states after each substep.
        rows: (M,) rows of the world.
        valid: (M, n) whether the vehicle is present.
    """

    rows: IntArray
    valid: BoolArray

    def keep(self, mask: BoolArray) -> MovedMotion:
        """Return the vehicles for which *mask* (M,) is True."""
        kept = self.mapped(lambda part: part[mask])
        return replace(kept, rows=self.rows[mask], valid=self.valid[mask])

    def span(self, start: int, stop: int) -> MovedMotion:
        """Return substeps *start* to *stop* (exclusive)."""
        return replace(self.mapped(lambda part: part[:, start:stop]), valid=self.valid[:, start:stop])

    @staticmethod
    def join(first: MovedMotion, second: MovedMotion) -> MovedMotion:
        """Return the vehicles of both; of a row in both, the motion in *first* applies."""
        only_second = second.keep(~np.isin(second.rows, first.rows))
        pairs = (
            (getattr(first, name), getattr(only_second, name)) for name in MovedMotion.__dataclass_fields__
        )
        return MovedMotion(*(np.concatenate(pair) for pair in pairs))

    @staticmethod
    def none(steps: int) -> MovedMotion:
        """Return the motion of no vehicle, *steps* substeps long."""
        return MovedMotion(
            np.zeros((0, steps, 2)),
            np.zeros((0, steps)),
            np.zeros((0, steps)),
            np.zeros(0, dtype=np.int64),
            np.zeros((0, steps), dtype=np.bool_),
        )


@dataclass
class Background:
    """The policy of an episode, and what it has planned and done so far.

    Attributes:
        source: makes the plans with the policy.
        road: the map.
        world: rows and states.
        log: of the seed scene.
        rng: the policy's own random numbers.
        limits: of vehicles that are driven through the bicycle model.
        step_s: SUMO's step.
        name: for messages.
        heartbeat: of the episode.
        planning_s: wall-clock seconds of each plan; empty if SUMO drives all background vehicles.
        skipped: ids that a log would have moved, but which SUMO has driven too far away from it.
        planned: the last plan that was not refused.
        attack: kind of attack that was requested of the policy; None if it does not attack.
        in_position: whether any vehicle was ever in a position to carry the attack out.
        manoeuvres: id → its last manoeuvre against the target, and its time; None if the policy does not report them.
        safeguarded: number of vehicle plans that a safeguard changed until the next plan, and of all that it checked.
    """

    source: PlanSource
    road: RoadMap
    world: World
    log: Tracks
    rng: np.random.Generator
    step_s: float
    name: str
    heartbeat: Heartbeat = field(default_factory=Heartbeat)
    limits: Limits = field(default_factory=Limits)
    planning_s: list[float] = field(default_factory=list)
    skipped: set[str] = field(default_factory=set)
    planned: JointPlan | None = None
    attack: str | None = None
    in_position: bool = False
    manoeuvres: dict[str, tuple[str, float]] | None = None
    safeguarded: tuple[int, int] = (0, 0)

    def start(self, scene: Scene) -> None:
        """Let the policy prepare for an episode that begins in *scene*."""
        self._guard.call(lambda: self.source.start(self.road, scene, self.log, self.rng))

    def replan(self, scene: Scene, steps: int) -> MovedMotion:
        """Return the policy's motion for the coming *steps*.

        Raises:
            PlannerError: the policy raised.
            PlanRefusedError: its plan holds NaN or a jump.
        """
        return self._guard.call(lambda: self._plan(scene, steps))

    @property
    def routes(self) -> Mapping[str, tuple[str, ...]]:
        """Id → edges of the vehicles that the last plan inserts."""
        return self.planned.routes if self.planned is not None else {}

    @property
    def _guard(self) -> PlugInGuard:
        return PlugInGuard(
            self.source.policy, f"background '{self.name}'", ProcessPhase.BACKGROUND, self.heartbeat
        )

    def _plan(self, scene: Scene, steps: int) -> MovedMotion:
        plan, wall_s = self.source.plan(self.road, scene, self.rng, f"background '{self.name}'")
        if not plans_nothing(self.source.policy):
            self.planning_s.append(wall_s)
        motion = self.motion(plan, scene.target_id, steps)
        self.planned = plan
        self.safeguarded = (
            self.safeguarded[0] + plan.safeguarded[0],
            self.safeguarded[1] + plan.safeguarded[1],
        )
        if plan.attack is not None:
            self.attack = plan.attack.kind
            self.in_position |= bool(plan.attack.in_position)
            if plan.attack.manoeuvres is not None:
                manoeuvres_now = {name: (kind, scene.time_s) for name, kind in plan.attack.manoeuvres.items()}
                self.manoeuvres = {**(self.manoeuvres or {}), **manoeuvres_now}
        return motion

    def motion(self, plan: JointPlan, target_id: str, steps: int) -> MovedMotion:
        """Check *plan* and return it as states after each of *steps* substeps."""
        tracks = plan.tracks
        check_joint_form(plan, f"background '{self.name}'")
        if tracks.agents == 0:
            return MovedMotion.none(steps)
        if target_id in tracks.index:
            raise PlanRefusedError(f"background '{self.name}' planned for the target '{target_id}'")
        rows = np.array([self.row_for(tracks, k) for k in range(tracks.agents)])
        is_too_far = check_joint_plan(plan, self.world.xy_m[rows], f"background '{self.name}'")
        if is_too_far.any() and not plan.exact:
            raise PlanRefusedError(
                f"background '{self.name}' planned a jump for '{tracks.ids[int(is_too_far.argmax())]}'"
            )
        self.skipped.update(name for name, too_far in zip(tracks.ids, is_too_far, strict=True) if too_far)
        dense = self._exact(tracks, rows, steps) if plan.exact else self._driven(tracks, rows, steps)
        return MovedMotion(*dense[:3], rows, dense[3]).keep(~is_too_far)

    def row_for(self, tracks: Tracks, k: int) -> int:
        """Return the world's row of agent *k* of *tracks*; add one if the agent is new."""
        row = self.world.row_of(tracks.ids[k])
        if row is not None:
            return row
        length, width = tracks.size_m[k].tolist()
        return self.world.add(tracks.ids[k], AgentClass(tracks.classes[k]), length, width)

    def _exact(
        self, tracks: Tracks, rows: IntArray, steps: int
    ) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
        """Return states and presence at every substep as the plan has them, resampled if its spacing is another."""
        if abs(tracks.dt_s - self.step_s) > 1e-9:
            t0_s = tracks.t0_s - tracks.dt_s + self.step_s
            tracks = resample(self._from_now(tracks, rows), self.step_s, t0_s=t0_s)
        cut = tracks.window(0, min(steps, tracks.steps))
        if cut.steps < steps:
            raise PlanRefusedError(
                f"background '{self.name}' planned {cut.steps} steps of {self.step_s:g} s, not {steps}"
            )
        return cut.xy_m, cut.yaw_rad, cut.speed_mps, cut.valid

    def _from_now(self, tracks: Tracks, rows: IntArray) -> Tracks:
        """Return *tracks* preceded by the present states of *rows*."""
        world = self.world
        xy, yaw, speed = world.xy_m[rows], world.yaw_rad[rows], world.speed_mps[rows]
        return replace(
            tracks,
            xy_m=np.concatenate((xy[:, None], tracks.xy_m), axis=1),
            yaw_rad=np.concatenate((yaw[:, None], tracks.yaw_rad), axis=1),
            speed_mps=np.concatenate((speed[:, None], tracks.speed_mps), axis=1),
            valid=np.concatenate((np.isfinite(yaw)[:, None], tracks.valid), axis=1),
            t0_s=tracks.t0_s - tracks.dt_s,
        )

    def _driven(
        self, tracks: Tracks, rows: IntArray, steps: int
    ) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
        """Return states and presence at every substep of vehicles that follow the plan through the bicycle model."""
        if tracks.steps * tracks.dt_s < steps * self.step_s - 1e-9:
            raise PlanRefusedError(
                f"background '{self.name}' planned {tracks.steps} × {tracks.dt_s:g} s, too short"
            )
        world = self.world
        now: State = world.xy_m[rows], world.yaw_rad[rows], world.speed_mps[rows]
        state, dense = completed(tracks, now)
        if abs(tracks.dt_s - self.step_s) > 1e-9:
            dense = densify(state, dense, tracks.dt_s, self.step_s, steps)
        reference: State = dense[0][:, :steps], dense[1][:, :steps], dense[2][:, :steps]
        driven = track(state, reference, world.size_m[rows, 0], self.step_s, self.limits)
        return *driven, presence(tracks, np.isnan(now[1]), self.step_s, steps)


def planned_ends(motion: MovedMotion) -> Mapping[int, tuple[FloatArray, float]]:
    """Return row → last valid position (2,) and heading of *motion*."""
    ends = {}
    for k, row in enumerate(motion.rows.tolist()):
        valid_steps = np.flatnonzero(motion.valid[k])
        if len(valid_steps):
            ends[row] = motion.xy_m[k, valid_steps[-1]], float(motion.yaw_rad[k, valid_steps[-1]])
    return ends
