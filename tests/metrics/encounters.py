"""Hand-made encounters on constructed nets, for tests of metrics and verdicts: nets, cars and records."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import sumolib

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import Polyline
from advdiff_sumo.core.record import Controller, EndReason, EpisodeRecord
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.collision import collisions, target_collision
from advdiff_sumo.metrics.verdict import judge

DT_S = 0.1
NODES = """<nodes>
  <node id="W" x="-200" y="0"/> <node id="E" x="200" y="0"/> <node id="N" x="0" y="200"/> <node id="S" x="0" y="-200"/>
  <node id="C" x="0" y="0" type="{kind}"/>
</nodes>"""
EDGES = """<edges>
  <edge id="WC" from="W" to="C" numLanes="2" priority="5"/> <edge id="CE" from="C" to="E" numLanes="2" priority="5"/>
  <edge id="EC" from="E" to="C" numLanes="2" priority="5"/> <edge id="CW" from="C" to="W" numLanes="2" priority="5"/>
  <edge id="SC" from="S" to="C" numLanes="1" priority="1"/> <edge id="CN" from="C" to="N" numLanes="1" priority="1"/>
  <edge id="NC" from="N" to="C" numLanes="1" priority="1"/> <edge id="CS" from="C" to="S" numLanes="1" priority="1"/>
</edges>"""


@dataclass(frozen=True)
class Car:
    """A road user at T instants: centres (T, 2), headings (T,), speeds (T,)."""

    name: str
    xy_m: FloatArray
    yaw_rad: FloatArray
    speed_mps: FloatArray
    size_m: tuple[float, float] = (4.0, 2.0)
    agent_class: AgentClass = AgentClass.CAR


def crossing(folder: Path, kind: str, lefthand: bool = False) -> RoadMap:
    """Make a crossing of a 2 x 2 lane street along x and a 2 x 1 lane one along y; lanes are 3.2 m wide.

    Right-hand traffic; lanes along x: EC_0 y = 4.8, EC_1 1.6 (westward), WC_1 -1.6, WC_0 -4.8 (eastward); along y:
    SC_0 x = 1.6 (northward), NC_0 x = -1.6. The junction reaches about 10 m from the origin. The limit is 13.89 m/s.

    Args:
        folder: folder in which the net is made.
        kind: SUMO's type of junction: priority (the street along x has it), traffic_light, allway_stop, ...
        lefthand: whether traffic keeps left.
    """
    return build(folder, NODES.format(kind=kind), EDGES, f"{kind}{'-left' * lefthand}", lefthand)


def build(
    folder: Path, nodes: str, edges: str, name: str, lefthand: bool = False, more: Sequence[str] = ()
) -> RoadMap:
    """Make a net from plain XML *nodes* and *edges* with netconvert and *more* options; coordinates do not change."""
    (folder / f"{name}.nod.xml").write_text(nodes)
    (folder / f"{name}.edg.xml").write_text(edges)
    net = folder / f"{name}.net.xml"
    files = ["-n", str(folder / f"{name}.nod.xml"), "-e", str(folder / f"{name}.edg.xml"), "-o", str(net)]
    options = ["--no-turnarounds", "true", "--offset.disable-normalization", "true", "--no-warnings", "true"]
    options += ["--lefthand", "true"] * lefthand
    command = [sumolib.checkBinary("netconvert"), *files, *options, *more]
    subprocess.run(command, check=True, capture_output=True)
    return RoadMap.read(net)


def straight(
    name: str,
    xy: tuple[float, float],
    yaw: float,
    speed: float,
    steps: int = 41,
    drift: float = 0.0,
    size: tuple[float, float] = (4.0, 2.0),
) -> Car:
    """Return a car at constant velocity; *drift* is its lateral speed (left positive)."""
    t = DT_S * np.arange(steps)[:, None]
    ahead, left = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    path = np.asarray(xy) + t * (speed * ahead + drift * left)
    return Car(name, path, np.full(steps, float(yaw)), np.full(steps, float(speed)), size)


def driven(
    name: str,
    xy: tuple[float, float],
    yaw: float,
    speed: Sequence[float] | FloatArray,
    left: Sequence[float] | FloatArray | float = 0.0,
    size: tuple[float, float] = (4.0, 2.0),
    agent_class: AgentClass = AgentClass.CAR,
) -> Car:
    """Return a road user that keeps its heading while its speed and its offset to the left change.

    Args:
        name: its id.
        xy: its centre at the first instant, where *left* is 0.
        yaw: its heading.
        speed: (T,) speed at each instant; x[i + 1] = x[i] + v[i + 1] * 0.1 s.
        left: (T,) offset to the left at each instant, or one for all.
        size: length and width.
        agent_class: its class.
    """
    v = np.asarray(speed, dtype=np.float64)
    s = np.concatenate(([0.0], np.cumsum(v[1:]) * DT_S))[:, None]
    d = np.broadcast_to(np.asarray(left, dtype=np.float64), v.shape)[:, None]
    ahead, side = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    path = np.asarray(xy) + s * ahead + d * side
    return Car(name, path, np.full(len(v), float(yaw)), v, size, agent_class)


def braking(speed: float, after_s: float, brake_mps2: float, steps: int) -> FloatArray:
    """Return (T,) speeds of a car that keeps its speed for *after_s* and then brakes evenly to a stop."""
    t = DT_S * np.arange(steps)
    return np.maximum(0.0, speed - brake_mps2 * np.maximum(0.0, t - after_s))


def record_of(
    *cars: Car,
    route: tuple[str, ...] = ("WC", "CE"),
    signals: tuple[Mapping[str, str], ...] = (),
    episode_number: int = 0,
    **rest: object,
) -> EpisodeRecord:
    """Return the record of *cars*, of which the first is the target; NaN positions mean absent."""
    xy = np.stack([c.xy_m for c in cars])
    valid = np.isfinite(xy).all(-1)
    tracks = Tracks(
        ids=tuple(c.name for c in cars),
        classes=np.array([int(c.agent_class) for c in cars], dtype=np.int64),
        size_m=np.array([c.size_m for c in cars]),
        xy_m=xy,
        yaw_rad=np.where(valid, np.stack([c.yaw_rad for c in cars]), np.nan),
        speed_mps=np.where(valid, np.stack([c.speed_mps for c in cars]), np.nan),
        valid=valid,
        t0_s=0.0,
        dt_s=DT_S,
    )
    controller = np.where(valid, Controller.POLICY, Controller.ABSENT).astype(np.int64)
    return EpisodeRecord(
        episode_number,
        1,
        "hand-made",
        tracks,
        0,
        controller,
        route,
        EndReason.HORIZON,
        signals=signals,
        **rest,
    )  # type: ignore[arg-type]  # keyword fields vary by test


def signals_of(
    road: RoadMap, letters: Mapping[tuple[str, str], str], steps: int
) -> tuple[Mapping[str, str], ...]:
    """Return the states of all lights over *steps* instants: *letters* by link (from lane, to lane), others "g"."""
    state: dict[str, list[str]] = {}
    for link in road.links.values():
        if link.tls_id is not None and link.tls_index is not None:
            row = state.setdefault(link.tls_id, [])
            row.extend("g" * (link.tls_index + 1 - len(row)))
            row[link.tls_index] = letters.get((link.from_lane, link.to_lane), row[link.tls_index])
    return ({name: "".join(row) for name, row in state.items()},) * steps


def along(name: str, line: Polyline, s_m: FloatArray, left_m: FloatArray | float = 0.0) -> Car:
    """Return a car whose centre is at *s_m* (T,) along *line*, *left_m* to the left of it."""
    xy, yaw = line.at(s_m, np.broadcast_to(left_m, s_m.shape), extrapolate=True)
    return Car(name, xy, np.unwrap(yaw), np.gradient(s_m, DT_S))


def findings(record: EpisodeRecord, road: RoadMap) -> tuple[str, str, list[str], list[str]]:
    """Return kind, fault and both parties' breaches of the target's first collision."""
    hit = target_collision(record, collisions(record))
    assert hit is not None, "the record was meant to hold a collision"
    verdict = judge(record, road, hit)
    own, other = ([str(x.kind) for x in side] for side in (verdict.target_breaches, verdict.other_breaches))
    return str(verdict.kind), str(verdict.fault.at_fault), own, other


def blame(record: EpisodeRecord, road: RoadMap) -> tuple[str, str]:
    """Return kind and fault of the target's first collision."""
    kind, fault, _, _ = findings(record, road)
    return kind, fault


def broken(record: EpisodeRecord, road: RoadMap) -> tuple[list[str], list[str]]:
    """Return the breaches of the target and of its partner that led to the target's first collision."""
    _, _, own, other = findings(record, road)
    return own, other
