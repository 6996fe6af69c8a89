"""What planners and policies return."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.kinematic_states import KinematicStates
from advdiff_sumo.core.scene import Tracks

MAX_SPEED_MPS = 90.0
"""No plan drives faster."""
SLACK_M = 0.5
"""How much farther than that speed allows a plan may move somebody in a step: the noise of annotated logs."""


@dataclass(frozen=True)
class Trajectory(KinematicStates):
    """Where the vehicle should be; a tracking controller drives it there through the bicycle model.

    Attributes:
        xy_m: (T, 2) box centres at now + dt, now + 2 dt, …
        yaw_rad: (T,) headings.
        speed_mps: (T,) speeds.
        dt_s: spacing.
    """

    dt_s: float


@dataclass(frozen=True)
class Controls:
    """Inputs of the bicycle model, each held for ``dt_s``.

    Attributes:
        accel_mps2: (T,) longitudinal acceleration.
        steer_rad: (T,) front-wheel angle, left positive.
        dt_s: how long each holds.
    """

    accel_mps2: FloatArray
    steer_rad: FloatArray
    dt_s: float


Plan: TypeAlias = Trajectory | Controls


@dataclass(frozen=True)
class AttackState:
    """What a policy that attacks the target was asked for, and who can do it now.

    Attributes:
        kind: of attack; "any": whichever.
        in_position: ids of the vehicles that are in a position for it.
        manoeuvres: id → what it does against the target now; None where the policy does not tell.
    """

    kind: str
    in_position: tuple[str, ...] = ()
    manoeuvres: Mapping[str, str] | None = None


@dataclass(frozen=True)
class JointPlan:
    """Futures of the background vehicles that a policy moves.

    Attributes:
        tracks: (A, T) states, first instant one ``dt_s`` after now. A vehicle not in the scene yet is
            inserted when it becomes valid; one that becomes invalid leaves.
        exact: poses are applied as they are (logs); otherwise through the bicycle model.
        attack: who can attack; None where the policy attacks nobody, or has not looked anew.
        routes: id → edges that a vehicle which is inserted is going to drive; without it they are guessed.
        safeguarded: of how many vehicles a safeguard changed what they drive next, and of how many it looked at.
    """

    tracks: Tracks
    exact: bool = False
    attack: AttackState | None = None
    routes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    safeguarded: tuple[int, int] = (0, 0)
