"""What AdvSim searches over: changes of an initial action sequence, feasible by construction.

A change is a number in [−1, 1] for each acceleration and curvature. The bicycle model's limits hold for every
result, and so do limits on how fast actions change, but where the initial sequence itself goes beyond the latter:
there they are as wide as it needs, so that no change gives the initial sequence exactly.
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

_CRAWL_MPS, _SLOW_MPS = 2.0, 0.1


@dataclass(frozen=True)
class Initial:
    """R attackers before the search.

    Attributes:
        pose: (R, 4) x, y, yaw, speed now.
        length: (R,) of their boxes.
        accel: (R, T) initial accelerations.
        curvature: (R, T) initial curvatures.
        last: (R, 2) acceleration and curvature until now.
    """

    pose: Tensor
    length: Tensor
    accel: Tensor
    curvature: Tensor
    last: Tensor


def initial_of(rollout: Rollout, batch: SceneBatch, rows: Tensor) -> Initial:
    """Return the attackers *rows* (R,) of a scene that goes on as *rollout* (1, A, T)."""
    past, known = batch.past[0, rows], batch.past_valid[0, rows]
    accel, curvature = rollout.accel[0, rows], rollout.curvature[0, rows]
    driven = (past[:, -1, :2] - past[:, -2, :2]).norm(dim=-1)
    turned = wrap_angle(past[:, -1, 2] - past[:, -2, 2])
    before = torch.stack(
        ((past[:, -1, 3] - past[:, -2, 3]) / MODEL_STEP_S, turned / driven.clamp(min=0.5)), dim=-1
    )
    first = torch.stack((accel[:, 0], curvature[:, 0]), dim=-1)
    last = torch.where(known[:, -2:].all(-1)[:, None], before, first)
    return Initial(batch.pose[0, rows], batch.size[0, rows, 0], accel, curvature, last)


def driven(
    changes: Tensor, initial: Initial, options: AdvSimOptions, model: ModelOptions, steps: int | None = None
) -> Rollout:
    """Return the futures (P, R, T) of *changes* (P, R, H, 2); where T is more than H, with the initial actions again.

    Args:
        changes: in [−1, 1].
        initial: the attackers before the search.
        options: bounds of the changes.
        model: bounds of the actions.
        steps: T; None: all that the initial actions have.
    """
    count, steps = len(changes), initial.accel.shape[1] if steps is None else steps
    wish = _filled(changes, steps)
    pose = initial.pose.expand(count, -1, -1)
    xy, yaw, speed = pose[..., :2], pose[..., 2], pose[..., 3].clamp(min=0.0)
    accel, curvature = initial.last[:, 0].expand(count, -1), initial.last[:, 1].expand(count, -1)
    push = initial.accel[:, :steps] + options.accel_mps2 * wish[..., 0]
    jump = _jumps(initial.accel, initial.last[:, 0]).clamp(min=options.jerk_mps3 * MODEL_STEP_S)
    turn, bent = options.steer_share * wish[..., 1], _jumps(initial.curvature, initial.last[:, 1])
    tightest = tightest_curvature(initial.length, model)
    rows = (part.unbind(-1) for part in (push, turn, initial.curvature[:, :steps], jump, bent))
    states = []
    for push_k, turn_k, curvature_k, jump_k, bent_k in zip(*rows, strict=False):
        accel = _within(push_k, accel, jump_k).clamp(-model.brake_mps2, model.accel_mps2)
        limit = torch.minimum(tightest, model.lateral_mps2 / speed.clamp(min=_SLOW_MPS) ** 2)
        swerve = options.swerve_mps3 * MODEL_STEP_S / speed.clamp(min=_CRAWL_MPS) ** 2
        curvature = _within(curvature_k + limit * turn_k, curvature, torch.maximum(bent_k, swerve))
        curvature = torch.minimum(torch.maximum(curvature, -limit), limit)
        xy, yaw, speed = step(xy, yaw, speed, accel, curvature, MODEL_STEP_S)
        states.append((xy, yaw, speed, accel, curvature))
    return rollout_of(states)


def _filled(changes: Tensor, steps: int) -> Tensor:
    """Return *changes* (P, R, H, 2) with as many instants as *steps*, no change in those that are added."""
    more = steps - changes.shape[2]
    if more <= 0:
        return changes[:, :, :steps]
    return torch.cat((changes, changes.new_zeros(*changes.shape[:2], more, 2)), dim=2)


def _within(wanted: Tensor, before: Tensor, most: Tensor) -> Tensor:
    return torch.minimum(torch.maximum(wanted, before - most), before + most)


def _jumps(values: Tensor, last: Tensor) -> Tensor:
    """Return (R, T) how much the initial sequence itself changes at each step."""
    return torch.diff(values, dim=1, prepend=last[:, None]).abs()


def tightest_curvature(length: Tensor, model: ModelOptions) -> Tensor:
    """Return the bound that the steering angle sets."""
    return math.tan(model.steer_rad) / (WHEELBASE_PER_LENGTH * length.clamp(min=0.5))
