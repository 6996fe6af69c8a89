"""Planned motions of everybody around, as arrays that the safeguard works on."""

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
"""A vehicle that is slower stands: what it moves is noise, not a way that it drives."""
WALKS_MPS = 2.0
"""A vehicle that is slower creeps: it can halt at once, and gets past others, or off a junction, by inches."""


@dataclass(frozen=True)
class Futures(KinematicStates):
    """States of N road users now and at T instants to come.

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
        """Number of instants T to come."""
        return int(self.yaw_rad.shape[1]) - 1

    def put(self, row: int, xy_m: FloatArray, yaw_rad: FloatArray, speed_mps: FloatArray) -> None:
        """Overwrite the plan of *row*: (T, 2), (T,), (T,)."""
        self.xy_m[row, 1:], self.yaw_rad[row, 1:], self.speed_mps[row, 1:] = xy_m, yaw_rad, speed_mps

    def copy(self) -> Futures:
        """Return the same with arrays of its own."""
        return self.mapped(np.copy)

    def first(self, steps: int) -> Futures:
        """Return now and the first *steps* instants."""
        return self.mapped(lambda part: part[:, : steps + 1])

    def lasting(self, steps: int) -> Futures:
        """Return now and *steps* instants; who has no plan for so long goes on at its last velocity."""
        if steps <= self.steps:
            return self.first(steps)
        last = self.xy_m[:, -1], self.yaw_rad[:, -1], self.speed_mps[:, -1]
        rest = coasting(*last, self.size_m, steps - self.steps, self.dt_s)
        return replace(
            self,
            xy_m=np.concatenate((self.xy_m, rest.xy_m[:, 1:]), axis=1),
            yaw_rad=np.concatenate((self.yaw_rad, rest.yaw_rad[:, 1:]), axis=1),
            speed_mps=np.concatenate((self.speed_mps, rest.speed_mps[:, 1:]), axis=1),
        )

    def halves(self) -> tuple[FloatArray, FloatArray]:
        """Return positions (N, 2 T, 2) and headings (N, 2 T) at every half step from now on, now left out."""
        xy, yaw = with_middles(self.xy_m, self.yaw_rad)
        return xy[:, 1:].copy(), yaw[:, 1:].copy()

    def travelled_m(self) -> FloatArray:
        """Return the distance driven (N, T + 1) since now."""
        stride = np.linalg.norm(np.diff(self.xy_m, axis=1), axis=-1)
        return np.concatenate((np.zeros((self.agents, 1)), np.cumsum(stride, axis=1)), axis=1)


def futures_of(now: Tracks, rollout: Rollout) -> Futures:
    """Return the first scene of *rollout* in the world's frame, with the present, the last instant of *now*, first.

    The scene's origin is the first agent of *now*.
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


def coasting(
    xy_m: FloatArray, yaw_rad: FloatArray, speed_mps: FloatArray, size_m: FloatArray, steps: int, dt_s: float
) -> Futures:
    """Return the futures of N road users that keep their velocity: (N, 2), (N,), (N,), (N, 2)."""
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
    """Return both, *first* in front."""
    return Futures(
        np.concatenate((first.xy_m, second.xy_m)),
        np.concatenate((first.yaw_rad, second.yaw_rad)),
        np.concatenate((first.speed_mps, second.speed_mps)),
        np.concatenate((first.size_m, second.size_m)),
        first.dt_s,
    )


def standing(futures: Futures, rows: BoolArray) -> None:
    """Let *rows* (N,) stay exactly where they are, in place."""
    futures.xy_m[rows, 1:] = futures.xy_m[rows, :1]
    futures.yaw_rad[rows, 1:] = futures.yaw_rad[rows, :1]
    futures.speed_mps[rows, 1:] = 0.0
