"""Build encounters in SUMO: small roads, road users that drive as scripted, and whether the target failed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import Polyline
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.metric_rows import episode_row
from advdiff_sumo.planners.planner_registry import make_target
from advdiff_sumo.sim.episode import Episode
from advdiff_sumo.sim.seed_scene import PlacedTraffic, SeedScene
from advdiff_sumo.sim.sim_options import SimOptions
from advdiff_sumo.traffic.policy_registry import make_policy
from tests.sim.nets import build

STEP_S, HISTORY = 0.1, 5
SIZES_M = {
    AgentClass.CAR: (4.6, 1.8),
    AgentClass.TRUCK: (10.0, 2.5),
    AgentClass.BICYCLE: (1.8, 0.65),
}
ONE_LANE = (
    '<nodes><node id="W" x="0" y="0"/><node id="M" x="900" y="0"/><node id="E" x="1000" y="0"/></nodes>',
    '<edges><edge id="WM" from="W" to="M" speed="{limit}"/><edge id="ME" from="M" to="E" speed="{limit}"/></edges>',
)
TWO_LANES = (
    ONE_LANE[0],
    '<edges><edge id="WM" from="W" to="M" numLanes="2" speed="{limit}"/>'
    '<edge id="ME" from="M" to="E" numLanes="2" speed="{limit}"/></edges>',
)
CROSSING = (
    '<nodes><node id="c" x="0" y="0" type="{kind}"/><node id="west" x="-300" y="0"/><node id="east" x="300" y="0"/>'
    '<node id="south" x="0" y="-300"/><node id="north" x="0" y="300"/></nodes>',
    "<edges>"
    + "".join(
        f'<edge id="{arm}_in" from="{arm}" to="c" speed="13.89" priority="{rank}"/>'
        f'<edge id="{arm}_out" from="c" to="{arm}" speed="13.89" priority="{rank}"/>'
        for arm, rank in (("west", 3), ("east", 3), ("south", 1), ("north", 1))
    )
    + "</edges>",
)

_ARMS = (("c", 0, 0), ("west", -300, 0), ("east", 300, 0), ("south", 0, -300))


@dataclass(frozen=True)
class Scripted:
    """A road user that drives as scripted.

    Attributes:
        lanes: lanes whose centre lines it follows, internal ones included.
        s_m: arc length of its centre at time 0.
        speed_mps: function of times (T,) s that returns speeds (T,), or one speed.
        aside_m: function of times (T,) s that returns lateral offsets (T,), left positive, or one offset.
        kind: class of road user.
    """

    lanes: tuple[str, ...]
    s_m: float
    speed_mps: float | Callable[[FloatArray], FloatArray]
    aside_m: float | Callable[[FloatArray], FloatArray] = 0.0
    kind: AgentClass = AgentClass.CAR

    def states(self, road: RoadMap, times_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return centres (T, 2), headings (T,) and speeds (T,)."""
        line = Polyline.of(np.concatenate([road.lanes[lane].centre_xy_m for lane in self.lanes]))
        fine_s = np.arange(times_s[0], times_s[-1] + 0.005, 0.01)
        speed = _of(self.speed_mps, fine_s)
        s = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * 0.01))
        s += self.s_m - np.interp(0.0, fine_s, s)
        xy, yaw = line.at(s, _of(self.aside_m, fine_s), extrapolate=True)
        drift = np.gradient(_of(self.aside_m, fine_s), 0.01)
        yaw = np.unwrap(yaw) + np.arctan2(drift, np.maximum(speed, 1.0))
        columns = [np.interp(times_s, fine_s, values) for values in (xy[:, 0], xy[:, 1], yaw, speed)]
        return np.column_stack(columns[:2]), columns[2], columns[3]


@dataclass(frozen=True)
class Encounter:
    """A road and the road users on it.

    Attributes:
        road: the net.
        target: initial position and speed of the target.
        route: route of the target.
        others: scripted road users.
        horizon_s: duration.
    """

    road: RoadMap
    target: Scripted
    route: tuple[str, ...]
    others: tuple[Scripted, ...]
    horizon_s: float = 15.0

    def drive(
        self,
        defects: Sequence[str] = (),
        target: str = "lane_graph",
        background: str = "replay",
        background_options: Mapping[str, Any] | None = None,
        seed: int = 3,
    ) -> dict[str, Any]:
        """Return the episode's row with *defects* planted in *target*."""
        made = make_target(target, {"defects": list(defects)})
        sim = SimOptions(record_natural=False, record_plans=0, observe_radius_m=200.0, record_radius_m=300.0)
        episode = Episode(
            0,
            self.scene(),
            self.road,
            made,
            make_policy(background, background_options or {}),
            (target, background),
            sim,
            self.horizon_s,
            SeedTree(seed),
        )
        record, _ = episode.run()
        row = dict(episode_row(record, self.road))
        if row["failure_kind"] is not None:
            raise AssertionError(row["failure_message"])
        return row

    def scene(self) -> SeedScene:
        """Return the seed scene."""
        users = (self.target, *self.others)
        past = 0.5 * np.arange(-HISTORY + 1, 1)
        future = STEP_S * np.arange(-20, round(self.horizon_s / STEP_S) + 1)
        return SeedScene(
            name="made",
            net=self.road.path,
            seed=1,
            history=_tracks(self.road, users, past, 0.5),
            target="car0",
            routes={"car0": self.route},
            log=_tracks(self.road, users, future, STEP_S),
            start=PlacedTraffic(np.ones(len(users), dtype=np.bool_)),
            horizon_s=self.horizon_s,
        )


def failed(row: dict[str, Any]) -> bool:
    """Return whether the target had a valid failure by its own fault."""
    return bool(row["valid_failure"] and row["at_fault"] == "target")


def braking(
    from_mps: float, at_s: float, brake_mps2: float, to_mps: float = 0.0
) -> Callable[[FloatArray], FloatArray]:
    """Return a speed over time: constant, then decreasing to *to_mps*."""
    return lambda t: np.clip(from_mps - brake_mps2 * np.maximum(t - at_s, 0.0), to_mps, from_mps)


def sliding(begin_s: float, takes_s: float, from_m: float) -> Callable[[FloatArray], FloatArray]:
    """Return a lateral offset over time that goes smoothly from *from_m* to 0."""

    def aside(t: FloatArray) -> FloatArray:
        u = np.clip((t - begin_s) / takes_s, 0.0, 1.0)
        return np.asarray(from_m * (1.0 - u * u * (3.0 - 2.0 * u)))

    return aside


def one_lane(folder: Path, limit_mps: float) -> RoadMap:
    """Return a straight lane of 1 km."""
    return RoadMap.read(
        build(folder, ONE_LANE[0], ONE_LANE[1].format(limit=limit_mps), name=f"one{limit_mps:g}")
    )


def two_lanes(folder: Path, limit_mps: float) -> RoadMap:
    """Return two straight lanes of 1 km."""
    return RoadMap.read(
        build(folder, TWO_LANES[0], TWO_LANES[1].format(limit=limit_mps), name=f"two{limit_mps:g}")
    )


def three_lanes(folder: Path, limit_mps: float) -> RoadMap:
    """Return three straight lanes of 1 km."""
    edges = TWO_LANES[1].replace('numLanes="2"', 'numLanes="3"').format(limit=limit_mps)
    return RoadMap.read(build(folder, TWO_LANES[0], edges, name=f"three{limit_mps:g}"))


def crossing(folder: Path, kind: str) -> RoadMap:
    """Return a crossing of single lanes; west to east has the right of way if *kind* gives any."""
    return RoadMap.read(build(folder, CROSSING[0].format(kind=kind), CROSSING[1], name=f"crossing-{kind}"))


def bending(folder: Path) -> RoadMap:
    """Return a junction of three arms whose main road bends: from the east to the south has priority."""
    nodes = "<nodes>" + "".join(
        f'<node id="{name}" x="{x}" y="{y}" type="priority"/>' for name, x, y in _ARMS
    )
    edges = "".join(
        f'<edge id="{arm}_in" from="{arm}" to="c" speed="13.89" priority="{rank}"/>'
        f'<edge id="{arm}_out" from="c" to="{arm}" speed="13.89" priority="{rank}"/>'
        for arm, rank in (("west", 1), ("east", 3), ("south", 3))
    )
    return RoadMap.read(build(folder, nodes + "</nodes>", f"<edges>{edges}</edges>", name="bending"))


def over(road: RoadMap, from_edge: str, to_edge: str) -> tuple[str, ...]:
    """Return the lanes from one arm over the junction to another."""
    for link in road.lanes[f"{from_edge}_0"].successors:
        if road.lanes[link.to_lane].edge_id == to_edge:
            return (f"{from_edge}_0", *link.via, link.to_lane)
    raise AssertionError(f"no way from {from_edge} to {to_edge}")


def _of(value: float | Callable[[FloatArray], FloatArray], times_s: FloatArray) -> FloatArray:
    return np.asarray(value(times_s)) if callable(value) else np.full(len(times_s), float(value))


def _tracks(road: RoadMap, users: Sequence[Scripted], times_s: FloatArray, dt_s: float) -> Tracks:
    xy, yaw, speed = zip(*(user.states(road, times_s) for user in users), strict=True)
    return Tracks(
        ids=tuple(f"car{k}" for k in range(len(users))),
        classes=np.array([int(user.kind) for user in users]),
        size_m=np.array([SIZES_M[user.kind] for user in users]),
        xy_m=np.array(xy),
        yaw_rad=np.array(yaw),
        speed_mps=np.array(speed),
        valid=np.ones((len(users), len(times_s)), dtype=np.bool_),
        t0_s=float(times_s[0]),
        dt_s=dt_s,
    )
