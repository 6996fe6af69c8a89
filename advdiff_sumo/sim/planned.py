"""Reduce plans, and the course of events without attack, to the model step for the record."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.bicycle import Limits
from advdiff_sumo.core.plan import JointPlan, Plan, Trajectory
from advdiff_sumo.core.record import MadePlans
from advdiff_sumo.core.resample import SAME_S, resample
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.core.tracking import drive_controls
from advdiff_sumo.sim.sim_options import SimOptions

#: Plans are recorded up to this time ahead.
AHEAD_S = 6.0


def made_plans(scene: Scene, own: Plan | None, joint: JointPlan | None, sim: SimOptions) -> MadePlans | None:
    """Return the plans made in *scene*, up to ``AHEAD_S`` ahead; None if there is none.

    Args:
        scene: when the plans were made.
        own: the target's; None if SUMO drives it.
        joint: the background's.
        sim: spacing, and how many vehicles' plans are recorded: the nearest ones, in the order of their distance.
    """
    planned: dict[str, FloatArray] = {}
    if sim.record_plans and own is not None:
        planned[scene.target_id] = _at_model_step(_own_tracks(scene, own, sim), scene.time_s, sim)[0]
    if sim.record_plans and joint is not None and joint.tracks.agents:
        nearest = _nearest(scene, joint.tracks, sim.record_plans)
        planned |= zip(nearest.ids, _at_model_step(nearest, scene.time_s, sim), strict=True)
    non_empty = {name: xy for name, xy in planned.items() if np.isfinite(xy).any()}
    if not non_empty:
        return None
    return MadePlans(scene.time_s, sim.model_step_s, tuple(non_empty), np.stack(list(non_empty.values())))


def natural_course(log: Tracks, dt_s: float) -> Tracks:
    """Return *log* from the episode's start on, every *dt_s*, without road users that are absent then."""
    steps = max(0, int(np.floor((log.times_s[-1] if log.steps else -1.0) / dt_s + 1e-6)) + 1)
    course = resample(log, dt_s, t0_s=0.0, steps=steps)
    return course.rows(np.flatnonzero(course.valid.any(axis=1)))


def _at_model_step(tracks: Tracks, now_s: float, sim: SimOptions) -> FloatArray:
    """Return (A, T, 2) positions at every model step after *now_s*; NaN where *tracks* has no valid state."""
    dt = sim.model_step_s
    steps = max(1, round(AHEAD_S / dt))
    at_s = now_s + dt * (1.0 + np.arange(steps))
    columns = np.rint((at_s - tracks.t0_s) / tracks.dt_s).astype(np.int64)
    if np.abs(tracks.t0_s + tracks.dt_s * columns - at_s).max() > SAME_S:
        return resample(tracks, dt, t0_s=now_s + dt, steps=steps).xy_m
    xy_m = np.full((tracks.agents, steps, 2), np.nan)
    is_covered = np.flatnonzero((columns >= 0) & (columns < tracks.steps))
    valid = tracks.valid[:, columns[is_covered], None]
    xy_m[:, is_covered] = np.where(valid, tracks.xy_m[:, columns[is_covered]], np.nan)
    return xy_m


def _own_tracks(scene: Scene, plan: Plan, sim: SimOptions) -> Tracks:
    """Return the target's plan as a track that begins now."""
    now = scene.history.rows([scene.target]).window(scene.history.steps - 1, scene.history.steps)
    if isinstance(plan, Trajectory):
        states, dt = (plan.xy_m, plan.yaw_rad, plan.speed_mps), plan.dt_s
    else:
        steps, dt = round(min(len(plan.accel_mps2) * plan.dt_s, AHEAD_S) / sim.step_s), sim.step_s
        state = now.xy_m[0, 0], now.yaw_rad[0, 0], now.speed_mps[0, 0]
        states = drive_controls(state, plan, now.size_m[0, 0], dt, max(steps, 1), Limits())
    xy, yaw, speed = (
        np.concatenate((start, ahead[None]), axis=1)
        for start, ahead in zip((now.xy_m, now.yaw_rad, now.speed_mps), states, strict=True)
    )
    valid = np.isfinite(yaw)
    return Tracks(now.ids, now.classes, now.size_m, xy, yaw, speed, valid, scene.time_s, dt)


def _nearest(scene: Scene, tracks: Tracks, most: int) -> Tracks:
    """Return the *most* agents of *tracks* that are nearest to the target now; absent ones come last."""
    now = scene.history
    rows = [now.index.get(name, -1) for name in tracks.ids]
    distance = np.linalg.norm(now.xy_m[rows, -1] - now.xy_m[scene.target, -1], axis=-1)
    distance[np.array(rows) < 0] = np.inf
    return tracks.rows(np.argsort(np.nan_to_num(distance, nan=np.inf), kind="stable")[:most])
