"""The record of an episode, from which all metrics, reports and exports are made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.scene import Tracks


class Controller(IntEnum):
    """What moved an agent in a step; REPLAYED: it followed its driving log, moved neither by SUMO nor by a policy."""

    ABSENT = -1
    SUMO = 0
    POLICY = 1
    PLANNER = 2
    REPLAYED = 3


class EndReason(StrEnum):
    """Why an episode ended."""

    HORIZON = "horizon"
    COLLISION = "collision"
    ARRIVED = "arrived"
    LOG_END = "log_end"
    FAILED = "failed"


@dataclass(frozen=True)
class SumoCollision:
    """One entry of SUMO's own collision list.

    Attributes:
        step: index of the instant in the record.
        collider: id of the vehicle that SUMO says ran into the other.
        victim: id of the other.
        kind: SUMO's type of collision, such as "collision" or "junction".
        lane_id: id of the lane.
    """

    step: int
    collider: str
    victim: str
    kind: str
    lane_id: str


@dataclass(frozen=True)
class Failure:
    """Why an episode could not be finished.

    Attributes:
        kind: ``kind`` of the error class, such as "plan_refused".
        message: one sentence.
        time_s: time since the episode's start.
        trace: Python's traceback, if the planner or policy raised; else "".
    """

    kind: str
    message: str
    time_s: float
    trace: str = ""


@dataclass(frozen=True)
class MadePlans:
    """Plans of the target and of vehicles near it, made at one instant; A agents, T instants.

    Attributes:
        made_s: time at which they were made, since the episode's start.
        dt_s: spacing of the instants; the first one is at ``made_s`` + ``dt_s``.
        ids: A names.
        xy_m: (A, T, 2) planned box centres; NaN beyond the end of a plan and where the agent is absent.
    """

    made_s: float
    dt_s: float
    ids: tuple[str, ...]
    xy_m: FloatArray


@dataclass(frozen=True)
class EpisodeRecord:
    """One closed-loop run; A agents, T instants at the simulation step (instant 0 is the start).

    Attributes:
        episode: number of the episode in its run.
        seed: SUMO's seed in the simulation from which the seed scene was taken.
        scene: name of the seed scene.
        tracks: (A, T) states.
        target: row of the tested vehicle.
        controller: (A, T) values of :class:`Controller`.
        route: edges of the target's route.
        end: why it ended.
        visible: T sets of ids that a SUMO-driven target's model perceived (leader, foe, neighbour);
            None if a Python planner drove, which perceives everything.
        signals: T mappings, traffic light → state string.
        sumo_collisions: SUMO's own collision list.
        teleports: number of vehicles that SUMO teleported.
        rough_handovers: number of vehicles handed back to SUMO although they were not aligned with their lane.
        skipped_agents: number of agents of a log left to SUMO, because their log continues out of reach.
        refused_insertions: number of moved vehicles that SUMO refused to insert; they leave the scene once they are
            no longer moved.
        attack: kind of attack requested of the background; None if it does not attack.
        in_position: whether a vehicle was in a position for that attack at some time; None without an attack.
        manoeuvres: id → its last manoeuvre against the target and the time at which it last did it, s; None if unknown.
        implausible: number of plans of the target that no vehicle can drive, and the problem of the first of them.
        safeguarded: number of vehicles' plans whose next motion a safeguard changed, and number that it checked.
        plans: plans in time order; those of SUMO-driven vehicles are unknown.
        natural: motion of the vehicles near from the same start without attack, at the model step; None if not kept.
        failure: reason, if ``end`` is FAILED.
    """

    episode: int
    seed: int
    scene: str
    tracks: Tracks
    target: int
    controller: IntArray
    route: tuple[str, ...]
    end: EndReason
    visible: tuple[frozenset[str], ...] | None = None
    signals: tuple[Mapping[str, str], ...] = ()
    sumo_collisions: tuple[SumoCollision, ...] = ()
    teleports: int = 0
    rough_handovers: int = 0
    skipped_agents: int = 0
    refused_insertions: int = 0
    attack: str | None = None
    in_position: bool | None = None
    manoeuvres: Mapping[str, tuple[str, float]] | None = None
    implausible: tuple[int, str] = (0, "")
    safeguarded: tuple[int, int] = (0, 0)
    plans: tuple[MadePlans, ...] = ()
    natural: Tracks | None = None
    failure: Failure | None = field(default=None)
