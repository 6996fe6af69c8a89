"""The scene that planners and policies receive: road users with their histories, and which may be moved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.kinematic_states import KinematicStates


class AgentClass(IntEnum):
    """Kinds of road user, in the order of every class array."""

    CAR = 0
    TRUCK = 1
    BUS = 2
    MOTORCYCLE = 3
    BICYCLE = 4
    PEDESTRIAN = 5


MOTOR_CLASSES = (AgentClass.CAR, AgentClass.TRUCK, AgentClass.BUS, AgentClass.MOTORCYCLE)
"""Motor vehicles, which must stay on the drivable area."""
HEAVY_CLASSES = (AgentClass.TRUCK, AgentClass.BUS)
"""Heavy vehicles, which brake less hard than cars."""
TRACK_ARRAYS = ("classes", "size_m", "xy_m", "yaw_rad", "speed_mps", "valid")
"""Names of the array fields of :class:`Tracks`."""
_STATES = TRACK_ARRAYS[2:]


@dataclass(frozen=True)
class Tracks:
    """States of A agents at T evenly spaced instants; arrays are (A,), (A, T) or (A, T, 2).

    Entries where ``valid`` is False hold NaN.

    Attributes:
        ids: A names, unique.
        classes: (A,) values of :class:`AgentClass`.
        size_m: (A, 2) length and width of the boxes.
        xy_m: (A, T, 2) box centres; x east, y north.
        yaw_rad: (A, T) counter-clockwise from east.
        speed_mps: (A, T) signed along the heading.
        valid: (A, T) whether the agent is present.
        t0_s: time of the first instant since the episode's start.
        dt_s: spacing of the instants.
    """

    ids: tuple[str, ...]
    classes: IntArray
    size_m: FloatArray
    xy_m: FloatArray
    yaw_rad: FloatArray
    speed_mps: FloatArray
    valid: BoolArray
    t0_s: float
    dt_s: float

    def __post_init__(self) -> None:
        agents, steps = len(self.ids), self.yaw_rad.shape[-1]
        expected = {
            "classes": (agents,),
            "size_m": (agents, 2),
            "xy_m": (agents, steps, 2),
            "yaw_rad": (agents, steps),
            "speed_mps": (agents, steps),
            "valid": (agents, steps),
        }
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"Tracks.{name} has shape {getattr(self, name).shape}, expected {shape}")
        if len(set(self.ids)) != agents:
            raise ValueError("Tracks.ids are not unique")

    @property
    def times_s(self) -> FloatArray:
        """(T,) times of the instants since the episode's start."""
        return np.asarray(self.t0_s + self.dt_s * np.arange(self.steps), dtype=np.float64)

    @property
    def agents(self) -> int:
        """Number of agents A."""
        return len(self.ids)

    @property
    def steps(self) -> int:
        """Number of instants T."""
        return int(self.yaw_rad.shape[-1])

    @cached_property
    def index(self) -> Mapping[str, int]:
        """Row of each id."""
        return {name: row for row, name in enumerate(self.ids)}

    def rows(self, rows: Sequence[int] | IntArray | BoolArray) -> Tracks:
        """Return the agents at *rows* (indices, or a mask (A,))."""
        picked = np.atleast_1d(np.asarray(rows))
        if picked.dtype == np.bool_:
            picked = np.flatnonzero(picked)
        picked = picked.astype(np.int64)
        arrays = {name: getattr(self, name)[picked] for name in TRACK_ARRAYS}
        return replace(self, ids=tuple(self.ids[i] for i in picked), **arrays)

    def window(self, start: int, stop: int) -> Tracks:
        """Return instants *start* to *stop* (exclusive, both in [0, T])."""
        return self.at(slice(start, stop), self.t0_s + self.dt_s * start, self.dt_s)

    def every(self, stride: int, first: int = 0) -> Tracks:
        """Return every *stride*-th instant, from *first* on."""
        return self.at(slice(first, None, stride), self.t0_s + self.dt_s * first, self.dt_s * stride)

    def at(self, instants: slice | IntArray, t0_s: float, dt_s: float) -> Tracks:
        """Return the states at *instants*, indices in [0, T), with the new *t0_s* and *dt_s*."""
        states = {name: getattr(self, name)[:, instants] for name in _STATES}
        return replace(self, t0_s=t0_s, dt_s=dt_s, **states)

    def where(self, mask: BoolArray) -> Tracks:
        """Return the same tracks, valid only where *mask*, (A, T) or (T,), is also True."""
        return replace(
            self,
            xy_m=np.where(mask[..., None], self.xy_m, np.nan),
            yaw_rad=np.where(mask, self.yaw_rad, np.nan),
            speed_mps=np.where(mask, self.speed_mps, np.nan),
            valid=self.valid & mask,
        )

    def with_states(self, plan: KinematicStates, t0_s: float, dt_s: float) -> Tracks:
        """Return these agents with the states of *plan* (A, T), all valid."""
        return replace(
            self,
            xy_m=plan.xy_m,
            yaw_rad=plan.yaw_rad,
            speed_mps=plan.speed_mps,
            valid=np.ones(plan.yaw_rad.shape, dtype=np.bool_),
            t0_s=t0_s,
            dt_s=dt_s,
        )

    def padded(self, before: int, after: int = 0) -> Tracks:
        """Return the tracks with *before* and *after* instants added in which nothing is valid."""
        pad = ((0, 0), (before, after))
        return replace(
            self,
            xy_m=np.pad(self.xy_m, (*pad, (0, 0)), constant_values=np.nan),
            yaw_rad=np.pad(self.yaw_rad, pad, constant_values=np.nan),
            speed_mps=np.pad(self.speed_mps, pad, constant_values=np.nan),
            valid=np.pad(self.valid, pad, constant_values=False),
            t0_s=self.t0_s - before * self.dt_s,
        )

    def shifted(self, seconds: float) -> Tracks:
        """Return the same tracks with their clock moved by *seconds*."""
        return replace(self, t0_s=self.t0_s + seconds)

    def copied(self) -> Tracks:
        """Return the same tracks with copies of the arrays, which the receiver may modify."""
        return replace(self, **{name: getattr(self, name).copy(order="K") for name in TRACK_ARRAYS})

    def joined(self, other: Tracks) -> Tracks:
        """Return these agents and those of *other*, which must have the same instants."""
        if (self.steps, self.dt_s, self.t0_s) != (other.steps, other.dt_s, other.t0_s):
            raise ValueError("Tracks of different instants cannot be joined")
        parts = {name: np.concatenate((getattr(self, name), getattr(other, name))) for name in TRACK_ARRAYS}
        return Tracks(ids=(*self.ids, *other.ids), t0_s=self.t0_s, dt_s=self.dt_s, **parts)

    @staticmethod
    def empty(steps: int = 0, dt_s: float = 0.5, t0_s: float = 0.0) -> Tracks:
        """Return tracks of no agents."""
        return Tracks(
            ids=(),
            classes=np.zeros(0, dtype=np.int64),
            size_m=np.zeros((0, 2)),
            xy_m=np.zeros((0, steps, 2)),
            yaw_rad=np.zeros((0, steps)),
            speed_mps=np.zeros((0, steps)),
            valid=np.zeros((0, steps), dtype=np.bool_),
            t0_s=t0_s,
            dt_s=dt_s,
        )


@dataclass(frozen=True)
class Scene:
    """One instant at which plans are made; A agents, H instants of history.

    Attributes:
        history: (A, H) states at the model step, the last instant is now.
        target: row of the tested vehicle.
        movable: (A,) background vehicles that the policy may move now.
        routes: A tuples of edge ids, from the agent's present edge on; () if unknown. Planners get only the target's.
        signals: id of each traffic light → SUMO's state string.
        replan_s: time until the target's next plan; 0: one step of the history.
    """

    history: Tracks
    target: int
    movable: BoolArray
    routes: tuple[tuple[str, ...], ...]
    signals: Mapping[str, str]
    replan_s: float = 0.0

    @property
    def least_plan_s(self) -> float:
        """Least duration of the target's plan: the time until the next one."""
        return self.replan_s or self.history.dt_s

    @property
    def time_s(self) -> float:
        """Present time in seconds since the episode's start."""
        return self.history.t0_s + self.history.dt_s * (self.history.steps - 1)

    @property
    def target_id(self) -> str:
        """Name of the tested vehicle."""
        return self.history.ids[self.target]

    def copied(self) -> Scene:
        """Return a copy of the scene for a plug-in, which may modify its arguments."""
        return replace(
            self, history=self.history.copied(), movable=self.movable.copy(), signals=dict(self.signals)
        )

    def without(self, hidden: BoolArray) -> Scene:
        """Return the scene without the road users in *hidden* (A,); the target is never removed."""
        visible = ~hidden
        visible[self.target] = True
        if visible.all():
            return self
        return replace(
            self,
            history=self.history.rows(visible),
            target=int(visible[: self.target].sum()),
            movable=self.movable[visible],
            routes=tuple(route for route, x in zip(self.routes, visible.tolist(), strict=True) if x),
        )
