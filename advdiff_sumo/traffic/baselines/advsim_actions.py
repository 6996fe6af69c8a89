"""Drives the action sequences of AdvSim's search: changes of initial actions, feasible by construction.

A change is a number in [−1, 1] for each acceleration and curvature. Every result keeps the limits of the bicycle
model and limits on how fast actions change. Where the initial sequence itself exceeds the latter, these are widened
as far as needed, so that a change of zero gives exactly the initial sequence.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from advdiff_sumo.core.bicycle import WHEELBASE_PER_LENGTH
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Rollout, rollout_of
from advdiff_sumo.models.geometry import wrap_angle
from advdiff_sumo.models.model_options import MODEL_STEP_S, ModelOptions
from advdiff_sumo.models.tensor_bicycle import step
from advdiff_sumo.traffic.baselines.baseline_options import AdvSimOptions

_SWERVE_MIN_MPS, _LATERAL_MIN_MPS = 2.0, 0.1
"""Lowest speeds in the limits on the change of curvature, and on lateral acceleration."""


@dataclass(frozen=True)
class Initial:
    """Present state and initial actions of R attackers.

    Attributes:
        pose: (R, 4) x, y, yaw, speed now.
        length: (R,) lengths of their boxes.
        accel: (R, T) initial accelerations.
        curvature: (R, T) initial curvatures.
        last: (R, 2) acceleration and curvature in the step up to now.
    """

    pose: Tensor
    length: Tensor
    accel: Tensor
    curvature: Tensor
    last: Tensor


def initial_of(rollout: Rollout, batch: SceneBatch, rows: Tensor) -> Initial:
    """Return state and initial actions of attackers *rows* (R,), whose initial futures are *rollout* (1, A, T)."""
    past, valid = batch.past[0, rows], batch.past_valid[0, rows]
    accel, curvature = rollout.accel[0, rows], rollout.curvature[0, rows]
    distance = (past[:, -1, :2] - past[:, -2, :2]).norm(dim=-1)
    turn = wrap_angle(past[:, -1, 2] - past[:, -2, 2])
    observed = torch.stack(
        ((past[:, -1, 3] - past[:, -2, 3]) / MODEL_STEP_S, turn / distance.clamp(min=0.5)), dim=-1
    )
    planned = torch.stack((accel[:, 0], curvature[:, 0]), dim=-1)
    last = torch.where(valid[:, -2:].all(-1)[:, None], observed, planned)
    return Initial(batch.pose[0, rows], batch.size[0, rows, 0], accel, curvature, last)


def drive(
    changes: Tensor, initial: Initial, options: AdvSimOptions, model: ModelOptions, steps: int | None = None
) -> Rollout:
    """Return the futures (P, R, T) under *changes* (P, R, H, 2), followed by the initial actions if T exceeds H.

    Args:
        changes: changes in [−1, 1].
        initial: state and initial actions of the attackers.
        options: bounds of the changes.
        model: bounds of the actions.
        steps: number of instants T; None: that of the initial actions.
    """
    count, steps = len(changes), initial.accel.shape[1] if steps is None else steps
    changes = _resized(changes, steps)
    pose = initial.pose.expand(count, -1, -1)
    xy, yaw, speed = pose[..., :2], pose[..., 2], pose[..., 3].clamp(min=0.0)
    accel, curvature = initial.last[:, 0].expand(count, -1), initial.last[:, 1].expand(count, -1)
    wanted_accel = initial.accel[:, :steps] + options.accel_mps2 * changes[..., 0]
    accel_change = _step_changes(initial.accel, initial.last[:, 0]).clamp(
        min=options.jerk_mps3 * MODEL_STEP_S
    )
    added_curvature = options.steer_share * changes[..., 1]
    curvature_change = _step_changes(initial.curvature, initial.last[:, 1])
    tightest = tightest_curvature(initial.length, model)
    base_curvature = initial.curvature[:, :steps]
    actions = (wanted_accel, added_curvature, base_curvature, accel_change, curvature_change)
    states = []
    for wanted_k, added_k, base_k, accel_change_k, curvature_change_k in zip(
        *(values.unbind(-1) for values in actions), strict=False
    ):
        accel = _within(wanted_k, accel, accel_change_k).clamp(-model.brake_mps2, model.accel_mps2)
        limit = torch.minimum(tightest, model.lateral_mps2 / speed.clamp(min=_LATERAL_MIN_MPS) ** 2)
        swerve = options.swerve_mps3 * MODEL_STEP_S / speed.clamp(min=_SWERVE_MIN_MPS) ** 2
        max_change = torch.maximum(curvature_change_k, swerve)
        curvature = _within(base_k + limit * added_k, curvature, max_change)
        curvature = torch.minimum(torch.maximum(curvature, -limit), limit)
        xy, yaw, speed = step(xy, yaw, speed, accel, curvature, MODEL_STEP_S)
        states.append((xy, yaw, speed, accel, curvature))
    return rollout_of(states)


def _resized(changes: Tensor, steps: int) -> Tensor:
    """Return *changes* (P, R, H, 2) cut to *steps* instants, or padded with zeros."""
    missing = steps - changes.shape[2]
    if missing <= 0:
        return changes[:, :, :steps]
    return torch.cat((changes, changes.new_zeros(*changes.shape[:2], missing, 2)), dim=2)


def _within(desired: Tensor, previous: Tensor, max_change: Tensor) -> Tensor:
    return torch.minimum(torch.maximum(desired, previous - max_change), previous + max_change)


def _step_changes(values: Tensor, last: Tensor) -> Tensor:
    """Return (R, T) the size of the change of *values* (R, T) at each step, from *last* (R,) on."""
    return torch.diff(values, dim=1, prepend=last[:, None]).abs()


def tightest_curvature(length: Tensor, model: ModelOptions) -> Tensor:
    """Return (R,) the largest curvatures that the steering angle allows."""
    return math.tan(model.steer_rad) / (WHEELBASE_PER_LENGTH * length.clamp(min=0.5))
