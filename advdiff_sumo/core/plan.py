"""Plans of planners and policies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.kinematic_states import KinematicStates
from advdiff_sumo.core.scene import Tracks

MAX_SPEED_MPS = 90.0
"""Greatest speed of a plan."""
SLACK_M = 0.5
"""A plan may move a vehicle this much farther per step than that speed allows, because annotated logs are noisy."""


@dataclass(frozen=True)
class Trajectory(KinematicStates):
    """Planned states of the vehicle; a tracking controller follows them with the bicycle model.

    Attributes:
        xy_m: (T, 2) box centres at now + dt, now + 2 dt, …
        yaw_rad: (T,) headings.
        speed_mps: (T,) speeds.
        dt_s: spacing of the states.
    """

    dt_s: float


@dataclass(frozen=True)
class Controls:
    """Inputs of the bicycle model, each held for ``dt_s``.

    Attributes:
        accel_mps2: (T,) longitudinal acceleration.
        steer_rad: (T,) front-wheel angle, left positive.
        dt_s: time for which each is held.
    """

    accel_mps2: FloatArray
    steer_rad: FloatArray
    dt_s: float


Plan: TypeAlias = Trajectory | Controls


@dataclass(frozen=True)
class AttackState:
    """The kind of attack requested of a policy, and the vehicles that can carry it out now.

    Attributes:
        kind: kind of attack; "any" for all kinds.
        in_position: ids of the vehicles that are in a position for it.
        manoeuvres: id → its present manoeuvre against the target; None if the policy does not report it.
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
        exact: whether poses are applied as they are (logs); otherwise the vehicles follow them with the bicycle model.
        attack: state of the attack; None if the policy does not attack, or has not updated it.
        routes: id → edges of the route of a vehicle that is inserted; without an entry they are guessed.
        safeguarded: number of vehicles whose next motion the safeguard changed, and number that it checked.
    """

    tracks: Tracks
    exact: bool = False
    attack: AttackState | None = None
    routes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    safeguarded: tuple[int, int] = (0, 0)
