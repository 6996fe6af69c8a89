"""Run a target in closed loop in natural SUMO traffic, and compute figures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from advdiff_sumo.core.arrays import BoolArray
from advdiff_sumo.core.record import EndReason, EpisodeRecord
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.fault import AtFault
from advdiff_sumo.metrics.summary import summarise
from advdiff_sumo.planners.planner_registry import make_target
from advdiff_sumo.sim.demand_files import DemandFiles
from advdiff_sumo.sim.episode import Episode, Timing
from advdiff_sumo.sim.seed_scene import SeedScene
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sim.warmup_scenes import NaturalTraffic
from advdiff_sumo.traffic.sumo_traffic import SumoTraffic

_STANDING_MPS = 0.3


@dataclass(frozen=True)
class Outcome:
    """Figures of one episode.

    Attributes:
        scene: name of the seed scene.
        end: reason for its end.
        struck: type of the target's collision and the reason for its fault; "" for none.
        at_fault: whether the target caused it, or left the road.
        route_m: distance along its route.
        mean_mps: mean speed of the target.
        stood_s: longest time at standstill.
        brake_mps2: strongest deceleration.
        lateral_mps2: strongest lateral acceleration.
        plan_s: median wall-clock time of a plan; 0 for SUMO-driven targets.
        failure: message of a failed episode.
    """

    scene: str
    end: str
    struck: str
    at_fault: bool
    route_m: float
    mean_mps: float
    stood_s: float
    brake_mps2: float
    lateral_mps2: float
    plan_s: float
    failure: str


def scenes(
    road: RoadMap, seed: int, count: int, horizon_s: float, demand: Path | None = None
) -> Iterator[SeedScene]:
    """Yield *count* seed scenes of natural traffic, generated or from *demand*."""
    files = DemandFiles((demand,), (), 0.0) if demand else None
    source = NaturalTraffic(road, files, SceneOptions(), SimOptions(), horizon_s, SeedTree(seed))
    found = 0
    for number in range(count):
        for scene in source.batch(number):
            if found < count:
                found += 1
                yield scene


def drive(
    road: RoadMap, scene: SeedScene, target: str, horizon_s: float, seed: int = 0
) -> tuple[EpisodeRecord, Timing]:
    """Run *target* from *scene* in traffic that SUMO drives."""
    made, names = make_target(target, {}), (target, "sumo")
    return Episode(0, scene, road, made, SumoTraffic(), names, SimOptions(), horizon_s, SeedTree(seed)).run()


def outcome(record: EpisodeRecord, timing: Timing, road: RoadMap) -> Outcome:
    """Return the figures of *record*."""
    metrics, tracks, row = summarise(record, road), record.tracks, record.target
    is_valid = tracks.valid[row]
    speed, yaw = tracks.speed_mps[row, is_valid], np.unwrap(tracks.yaw_rad[row, is_valid])
    struck = f"{metrics.struck.kind}: {metrics.struck.verdict.fault.reason}" if metrics.struck else ""
    caused = metrics.struck is not None and metrics.struck.verdict.fault.at_fault is AtFault.TARGET
    return Outcome(
        scene=record.scene,
        end=str(record.end),
        struck="left the road" if metrics.left_road else struck,
        at_fault=caused or metrics.left_road is not None,
        route_m=float(metrics.progress.route_m or 0.0),
        mean_mps=float(speed.mean()),
        stood_s=_longest(speed < _STANDING_MPS) * tracks.dt_s,
        brake_mps2=float(-np.diff(speed).min(initial=0.0) / tracks.dt_s),
        lateral_mps2=float(np.abs(np.diff(yaw) / tracks.dt_s * speed[1:]).max(initial=0.0)),
        plan_s=float(np.median(timing.target_plans_s)) if timing.target_plans_s else 0.0,
        failure=record.failure.message if record.end is EndReason.FAILED and record.failure else "",
    )


def _longest(mask: BoolArray) -> int:
    longest = run = 0
    for value in mask.tolist():
        run = run + 1 if value else 0
        longest = max(longest, run)
    return longest


def summary(runs: list[Outcome]) -> str:
    """Return the totals of *runs* as text."""
    ends = {end: sum(x.end == end for x in runs) for end in sorted({x.end for x in runs})}
    rows = [
        f"episodes {len(runs)}, ends {ends}",
        f"collisions {sum(bool(x.struck) for x in runs)}, at fault {sum(x.at_fault for x in runs)}",
        f"stood for more than 25 s {sum(x.stood_s > 25.0 for x in runs)}",
        f"mean speed {np.mean([x.mean_mps for x in runs]):.2f} m/s, route {np.mean([x.route_m for x in runs]):.0f} m",
        f"braking p95 {np.percentile([x.brake_mps2 for x in runs], 95):.1f} m/s²",
        f"median plan {1e3 * np.median([x.plan_s for x in runs]):.1f} ms",
    ]
    return "\n".join(rows)
