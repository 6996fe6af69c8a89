"""Planned and predicted motions of all road users, as arrays for the safeguard."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.kinematic_states import KinematicStates
from advdiff_sumo.core.resample import with_middles
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.models.model_options import MODEL_STEP_S

if TYPE_CHECKING:
    from advdiff_sumo.models.decoder import Rollout

STANDS_MPS = 0.2
"""A slower vehicle counts as standing: its motion is noise."""
WALKS_MPS = 2.0
"""A slower vehicle creeps: it can halt at once, and needs long to pass others or to clear a junction."""


@dataclass(frozen=True)
class Futures(KinematicStates):
    """States of N road users now and at T future instants.

    Attributes:
        xy_m: (N, T + 1, 2) box centres; index 0 is now.
        yaw_rad: (N, T + 1) headings, continuous from one instant to the next.
        speed_mps: (N, T + 1) speeds.
        size_m: (N, 2) length and width.
        dt_s: spacing.
    """

    size_m: FloatArray
    dt_s: float

    @property
    def agents(self) -> int:
        """Number of road users N."""
        return len(self.size_m)

    @property
    def steps(self) -> int:
        """Number of future instants T."""
        return int(self.yaw_rad.shape[1]) - 1

    def put(self, row: int, xy_m: FloatArray, yaw_rad: FloatArray, speed_mps: FloatArray) -> None:
        """Overwrite the plan of *row* with positions (T, 2), headings (T,) and speeds (T,)."""
        self.xy_m[row, 1:], self.yaw_rad[row, 1:], self.speed_mps[row, 1:] = xy_m, yaw_rad, speed_mps

    def copy(self) -> Futures:
        """Return a copy with its own arrays."""
        return self.mapped(np.copy)

    def first(self, steps: int) -> Futures:
        """Return the present and the first *steps* instants."""
        return self.mapped(lambda part: part[:, : steps + 1])

    def lasting(self, steps: int) -> Futures:
        """Return the present and *steps* instants; beyond their ends, plans continue at their last velocity."""
        if steps <= self.steps:
            return self.first(steps)
        last = self.xy_m[:, -1], self.yaw_rad[:, -1], self.speed_mps[:, -1]
        tail = constant_velocity_futures(*last, self.size_m, steps - self.steps, self.dt_s)
        return replace(
            self,
            xy_m=np.concatenate((self.xy_m, tail.xy_m[:, 1:]), axis=1),
            yaw_rad=np.concatenate((self.yaw_rad, tail.yaw_rad[:, 1:]), axis=1),
            speed_mps=np.concatenate((self.speed_mps, tail.speed_mps[:, 1:]), axis=1),
        )

    def halves(self) -> tuple[FloatArray, FloatArray]:
        """Return positions (N, 2 T, 2) and headings (N, 2 T) at every future half step."""
        xy, yaw = with_middles(self.xy_m, self.yaw_rad)
        return xy[:, 1:].copy(), yaw[:, 1:].copy()

    def travelled_m(self) -> FloatArray:
        """Return the distances driven since now (N, T + 1)."""
        stride = np.linalg.norm(np.diff(self.xy_m, axis=1), axis=-1)
        return np.concatenate((np.zeros((self.agents, 1)), np.cumsum(stride, axis=1)), axis=1)


def futures_of(now: Tracks, rollout: Rollout) -> Futures:
    """Return the first scene of *rollout* in the world's frame, after the present states.

    Args:
        now: tracks whose last instant is the present; its first agent is the origin of the rollout.
        rollout: futures in the scene's frame.
    """
    origin = now.xy_m[0, -1]
    xy, yaw, speed = (
        part[0].detach().cpu().numpy().astype(np.float64) for part in (rollout.xy, rollout.yaw, rollout.speed)
    )
    return Futures(
        np.concatenate((now.xy_m[:, -1:], xy + origin), axis=1),
        np.concatenate((now.yaw_rad[:, -1:], yaw), axis=1),
        np.concatenate((now.speed_mps[:, -1:], speed), axis=1),
        now.size_m,
        MODEL_STEP_S,
    )


def constant_velocity_futures(
    xy_m: FloatArray, yaw_rad: FloatArray, speed_mps: FloatArray, size_m: FloatArray, steps: int, dt_s: float
) -> Futures:
    """Return the futures of N road users that keep their velocity.

    Args:
        xy_m: (N, 2) box centres now.
        yaw_rad: (N,) headings.
        speed_mps: (N,) speeds.
        size_m: (N, 2) length and width.
        steps: number of future instants T.
        dt_s: spacing.
    """
    time = dt_s * np.arange(steps + 1)
    xy = xy_m[:, None] + (speed_mps[:, None] * time)[..., None] * unit(yaw_rad)[:, None]
    return Futures(
        xy,
        np.repeat(yaw_rad[:, None], steps + 1, axis=1),
        np.repeat(speed_mps[:, None], steps + 1, axis=1),
        size_m,
        dt_s,
    )


def join(first: Futures, second: Futures) -> Futures:
    """Return the road users of *first*, then those of *second*."""
    return Futures(
        np.concatenate((first.xy_m, second.xy_m)),
        np.concatenate((first.yaw_rad, second.yaw_rad)),
        np.concatenate((first.speed_mps, second.speed_mps)),
        np.concatenate((first.size_m, second.size_m)),
        first.dt_s,
    )


def stand_still(futures: Futures, rows: BoolArray) -> None:
    """Let *rows* (N,) stay exactly where they are, in place."""
    futures.xy_m[rows, 1:] = futures.xy_m[rows, :1]
    futures.yaw_rad[rows, 1:] = futures.yaw_rad[rows, :1]
    futures.speed_mps[rows, 1:] = 0.0
