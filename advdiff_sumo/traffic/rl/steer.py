"""Applies an attacker's actions: bounded deviations from the behaviour model, through the same bicycle model."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from advdiff_sumo.core.bicycle import WHEELBASE_PER_LENGTH
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.geometry import wrap_angle
from advdiff_sumo.models.model_options import MODEL_STEP_S, ModelOptions
from advdiff_sumo.models.tensor_bicycle import step

ACCEL_SPAN_MPS2 = 4.0
"""Deviation of acceleration for an action of 1."""
LATERAL_SPAN_MPS2 = 3.0
"""Deviation of lateral acceleration for an action of 1 …"""
CURVATURE_SPAN_1PM = 0.1
"""… but a deviation of curvature of no more than this, which matters for slow vehicles."""
_CORRECTED_SHARE = 0.5
"""Share of the deviation from the natural heading that is corrected in each later step."""
_MIN_SPEED_MPS = 1.0
"""Lowest speed by which accelerations and yaw rates are divided."""


def steered_futures(
    natural: Rollout, batch: SceneBatch, rows: Tensor, residuals: Tensor, options: ModelOptions
) -> Rollout:
    """Return *natural* with changed futures for *rows*.

    In the first step an agent's acceleration and curvature differ from the natural ones by its residual. Afterwards
    it takes its natural actions again and turns back to the natural heading. A residual of zero leaves the plan
    unchanged, bit by bit. All actions stay within the limits of *options*.

    Args:
        natural: futures by the behaviour model, one scene.
        batch: the scene.
        rows: (R,) rows of the agents.
        residuals: (R, 2) deviations of acceleration and curvature (left positive), in [−1, 1].
        options: options of the model, with the limits.
    """
    if not len(rows):
        return natural
    pose, length = batch.pose[0, rows], batch.size[0, rows, 0]
    motion = pose[:, :2], pose[:, 2], pose[:, 3].clamp(min=0.0)
    deviation = residuals.clamp(-1.0, 1.0).to(pose.dtype)
    states = []
    for k in range(natural.accel.shape[2]):
        accel, curvature = natural.accel[0, rows, k], natural.curvature[0, rows, k]
        if k == 0:
            accel = accel + ACCEL_SPAN_MPS2 * deviation[:, 0]
            curvature = curvature + curvature_span(motion[2]) * deviation[:, 1]
        else:
            curvature = curvature - _heading_correction(motion[1] - natural.yaw[0, rows, k - 1], motion[2])
        accel, curvature = _bounded(accel, curvature, motion[2], length, options)
        motion = step(*motion, accel, curvature, MODEL_STEP_S)
        states.append((*motion, accel, curvature))
    columns = [torch.stack(column, dim=1) for column in zip(*states, strict=True)]
    originals = (natural.xy, natural.yaw, natural.speed, natural.accel, natural.curvature)
    return Rollout(*(_put(old, rows, new) for old, new in zip(originals, columns, strict=True)))


def curvature_span(speed: Tensor) -> Tensor:
    """Return the deviation of curvature in 1/m for an action of 1 at *speed* (…,)."""
    return (LATERAL_SPAN_MPS2 / speed.clamp(min=_MIN_SPEED_MPS) ** 2).clamp(max=CURVATURE_SPAN_1PM)


def _heading_correction(deviation: Tensor, speed: Tensor) -> Tensor:
    """Return the curvature that corrects a share of a heading's *deviation* within one step."""
    return _CORRECTED_SHARE * wrap_angle(deviation) / (speed.clamp(min=_MIN_SPEED_MPS) * MODEL_STEP_S)


def _bounded(
    accel: Tensor, curvature: Tensor, speed: Tensor, length: Tensor, options: ModelOptions
) -> tuple[Tensor, Tensor]:
    """Return both clipped to the bounds that ``models.tensor_bicycle.controls`` keeps by construction."""
    tightest = math.tan(options.steer_rad) / (WHEELBASE_PER_LENGTH * length.clamp(min=0.5))
    bound = torch.minimum(tightest, options.lateral_mps2 / speed.clamp(min=0.1) ** 2)
    accel = accel.clamp(-options.brake_mps2, options.accel_mps2)
    return accel, torch.maximum(torch.minimum(curvature, bound), -bound)


def _put(old: Tensor, rows: Tensor, new: Tensor) -> Tensor:
    values = old.clone()
    values[0, rows] = new
    return values
