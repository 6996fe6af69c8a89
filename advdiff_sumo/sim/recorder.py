"""Record an episode's frames and what SUMO reports about them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import IntArray
from advdiff_sumo.core.plan import JointPlan, Plan
from advdiff_sumo.core.record import Controller, EndReason, EpisodeRecord, MadePlans, SumoCollision
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.maps.lanes import edge_of_lane
from advdiff_sumo.sim.planned import made_plans
from advdiff_sumo.sim.sim_options import SimOptions
from advdiff_sumo.sim.world import PERSON, Frame, World, stack


class Recorder:
    """Frames at SUMO's step for the record, and at the model step for histories."""

    def __init__(self, world: World, sim: SimOptions) -> None:
        self.world, self.sim = world, sim
        self.frames: list[Frame] = []
        self.model_frames: list[Frame] = []
        self.signals: list[Mapping[str, str]] = []
        self.visible: list[frozenset[str]] = []
        self.collisions: list[SumoCollision] = []
        self.plans: list[MadePlans] = []
        self.teleports = 0
        self._is_running = False

    def begin(self, history: Tracks) -> None:
        """Take the past from *history*, whose last instant is the present, and begin to record."""
        for k in range(history.steps - 1):
            self.model_frames.append(_frame_of(self.world, history, k))
        self._is_running = True

    def add(self, frame: Frame, signals: Mapping[str, str], visible: frozenset[str] | None) -> None:
        """Record the present instant."""
        if len(self.frames) % self.sim.substeps == 0:
            self.model_frames.append(frame)
        self.frames.append(frame)
        self.signals.append(signals)
        if visible is not None:
            self.visible.append(visible)

    def add_plans(self, scene: Scene, own: Plan | None, joint: JointPlan | None) -> None:
        """Record what target and background have planned in *scene*."""
        plans = made_plans(scene, own, joint, self.sim)
        if plans is not None:
            self.plans.append(plans)

    def note(self, api: Any) -> None:
        """Record what SUMO reports about its last step."""
        if not self._is_running:
            return
        self.teleports += api.simulation.getStartingTeleportNumber()
        for collision in api.simulation.getCollisions():
            pair = self._name(collision.collider), self._name(collision.victim)
            if edge_of_lane(collision.lane) not in self.world.beyond_rim:
                self.collisions.append(SumoCollision(len(self.frames), *pair, collision.type, collision.lane))

    def _name(self, sumo_id: str) -> str:
        """Return the record's name of the road user that SUMO calls *sumo_id*."""
        row = self.world.row_of(sumo_id)
        row = self.world.row_of(PERSON + sumo_id) if row is None else row
        return sumo_id if row is None else self.world.ids[row]

    def history(self, rows: IntArray, now_s: float) -> Tracks:
        """Return the states of *rows* at the last model steps, the present included."""
        frames = self.model_frames[-self.sim.history_steps :]
        span_s = self.sim.model_step_s * (len(frames) - 1)
        return stack(self.world, frames, rows, now_s - span_s, self.sim.model_step_s)[0]

    def finish(self, target: int) -> EpisodeRecord:
        """Return the record; the caller sets names, route and end."""
        rows = self._near(target)
        tracks, controller = stack(self.world, self.frames, rows, 0.0, self.sim.step_s)
        return EpisodeRecord(
            episode=0,
            seed=0,
            scene="",
            tracks=tracks,
            target=int(np.flatnonzero(rows == target)[0]) if len(rows) else 0,
            controller=controller,
            route=(),
            end=EndReason.HORIZON,
            visible=tuple(self.visible),
            signals=tuple(self.signals),
            sumo_collisions=tuple(
                collision for collision in self.collisions if collision.step < len(self.frames)
            ),
            teleports=self.teleports,
            plans=tuple(self.plans),
        )

    def _near(self, target: int) -> IntArray:
        """Return the rows that come within the record's radius of the target, and the target."""
        if not self.frames:
            return np.zeros(0, dtype=np.int64)
        is_near = np.zeros(len(self.world), dtype=np.bool_)
        is_near[target] = True
        for frame in self.frames:
            distance = np.linalg.norm(frame.xy_m - frame.xy_m[target], axis=-1)
            is_near[: len(distance)] |= distance < self.sim.record_radius_m  # NaN compares as False
        return np.flatnonzero(is_near)


def _frame_of(world: World, history: Tracks, k: int) -> Frame:
    """Return instant *k* of *history* as a frame."""
    n = len(world)
    frame = Frame(
        np.full((n, 2), np.nan), np.full(n, np.nan), np.full(n, np.nan), np.full(n, Controller.ABSENT)
    )
    for column, name in enumerate(history.ids):
        row = world.row_of(name)
        if row is None or not history.valid[column, k]:
            continue
        frame.xy_m[row] = history.xy_m[column, k]
        frame.yaw_rad[row] = history.yaw_rad[column, k]
        frame.speed_mps[row] = history.speed_mps[column, k]
        frame.controller[row] = Controller.SUMO
    return frame
