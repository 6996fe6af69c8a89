"""What an episode leaves behind: enough for every metric, report and export."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.scene import Tracks


class Controller(IntEnum):
    """Who moved an agent in a step; REPLAYED follows its driving log, as neither SUMO nor a policy drives it."""

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
    """One line of SUMO's own collision list.

    Attributes:
        step: index of the instant in the record.
        collider: id of the vehicle that SUMO says ran into the other.
        victim: id of the other.
        kind: SUMO's word, such as "collision" or "junction".
        lane_id: where.
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
        kind: word of the error class, such as "plan_refused".
        message: one sentence.
        time_s: when, since the episode's start.
        trace: where the planner or policy raised, as Python tells it; "" where it did not.
    """

    kind: str
    message: str
    time_s: float
    trace: str = ""


@dataclass(frozen=True)
class MadePlans:
    """What the target and vehicles near it meant to do at one instant; A agents, T instants.

    Attributes:
        made_s: when they were made, since the episode's start.
        dt_s: spacing of the instants, the first of which is one of them after ``made_s``.
        ids: A names.
        xy_m: (A, T, 2) planned box centres; NaN where a plan does not reach or has nobody there.
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
        seed: the seed of SUMO in the simulation that its seed scene was taken from.
        scene: name of the seed scene.
        tracks: (A, T) states.
        target: row of the tested vehicle.
        controller: (A, T) values of :class:`Controller`.
        route: edges of the target's route.
        end: why it ended.
        visible: T sets of ids that a SUMO-driven target's model perceived (leader, foe, neighbour);
            None when a Python planner drove, which sees everything.
        signals: T mappings, traffic light → state string.
        sumo_collisions: SUMO's own list.
        teleports: vehicles that SUMO teleported.
        rough_handovers: vehicles that SUMO got back although they stood askew in their lane.
        skipped_agents: agents of a log left to SUMO, which had them out of reach of where the log goes on.
        refused_insertions: moved vehicles that SUMO would not take in; they leave the scene once nobody moves them.
        attack: kind of attack that the background was asked for; None where it attacks nobody.
        in_position: whether somebody was in a position for that attack at some time; None without one.
        manoeuvres: id → what it did against the target last, and when it was last at it, s; None where nobody told.
        implausible: plans of the target that ask for what no vehicle can do, and what the first of them does.
        safeguarded: plans of a vehicle of which a safeguard changed what was driven next, and all it looked at.
        plans: what was planned, in the order of time; of a SUMO-driven vehicle nothing is known.
        natural: what everybody near did from the same start without attack, at the model step; None when it
            was not to be kept.
        failure: set when ``end`` is FAILED.
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
