"""Closed-loop evaluation of a target in natural SUMO traffic.

Run it as a program for figures over many episodes:
``python -m tests.planners.harness --net networks/downtown.net.xml --target lane_graph --scenes 50``.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from advdiff_sumo.core.boxes import corners, overlap
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.registry import make_target
from advdiff_sumo.sim.episode import Episode, Timing
from advdiff_sumo.sim.natural import NaturalTraffic
from advdiff_sumo.sim.options import SceneOptions, SimOptions
from advdiff_sumo.sim.seed_scene import SeedScene
from advdiff_sumo.traffic.sumo import SumoTraffic


@dataclass(frozen=True)
class Outcome:
    """One episode in numbers.

    Attributes:
        name: of the scene.
        end: why it ended.
        hit: id of whom the target's box overlapped, "" for nobody.
        front: the other was ahead of the target's middle when they met.
        speed_mps: the target's speed when they met.
        driven_m: how far the target drove.
        mean_mps: its mean speed.
        stood_s: longest time in which it stood.
        worst_brake_mps2: strongest deceleration.
        worst_lateral_mps2: strongest lateral acceleration.
        plan_s: median planning time.
        failure: message of a failed episode.
    """

    name: str
    end: str
    hit: str
    front: bool
    speed_mps: float
    driven_m: float
    mean_mps: float
    stood_s: float
    worst_brake_mps2: float
    worst_lateral_mps2: float
    plan_s: float
    failure: str


def scenes(
    road: RoadMap, seed: int, count: int, horizon_s: float, density_per_km: float
) -> Iterator[SeedScene]:
    """Yield *count* seed scenes of natural traffic."""
    options = SceneOptions(density_per_km=density_per_km)
    source = NaturalTraffic(road, None, options, SimOptions(), horizon_s, SeedTree(seed))
    found = 0
    for number in range(count):
        for scene in source.batch(number):
            if found == count:
                return
            found += 1
            yield scene


def drive(
    road: RoadMap, scene: SeedScene, name: str, horizon_s: float, seed: int
) -> tuple[EpisodeRecord, Timing]:
    """Run the target *name* from *scene* in traffic that SUMO drives."""
    episode = Episode(
        0,
        scene,
        road,
        make_target(name, {}),
        SumoTraffic(),
        (name, "sumo"),
        SimOptions(),
        horizon_s,
        SeedTree(seed),
    )
    return episode.run()


def outcome(record: EpisodeRecord, timing: Timing) -> Outcome:
    """Return *record* in numbers; the truth about contacts is the overlap of boxes at every step."""
    tracks, row = record.tracks, record.target
    there = tracks.valid[row]
    speed = tracks.speed_mps[row, there]
    box = corners(tracks.xy_m, tracks.yaw_rad, np.repeat(tracks.size_m[:, None], tracks.steps, 1))
    touch = overlap(box, np.broadcast_to(box[row], box.shape)) & tracks.valid & there
    touch[row] = False
    hit, front, at = "", False, 0.0
    if touch.any():
        step = int(np.flatnonzero(touch.any(0))[0])
        other = int(np.flatnonzero(touch[:, step])[0])
        delta = tracks.xy_m[other, step] - tracks.xy_m[row, step]
        yaw = tracks.yaw_rad[row, step]
        front = bool(delta @ np.array([np.cos(yaw), np.sin(yaw)]) > 0.0)
        hit, at = tracks.ids[other], float(tracks.speed_mps[row, step])
    accel = np.diff(speed) / tracks.dt_s
    turn = np.diff(np.unwrap(tracks.yaw_rad[row, there])) / tracks.dt_s
    return Outcome(
        name=record.scene,
        end=str(record.end),
        hit=hit,
        front=front,
        speed_mps=at,
        driven_m=float(speed.sum() * tracks.dt_s),
        mean_mps=float(speed.mean()),
        stood_s=_longest(speed < 0.3) * tracks.dt_s,
        worst_brake_mps2=float(-accel.min(initial=0.0)),
        worst_lateral_mps2=float(np.abs(turn * speed[1:]).max(initial=0.0)),
        plan_s=float(np.median(timing.target_plans_s)) if timing.target_plans_s else 0.0,
        failure=record.failure.message if record.failure else "",
    )


def _longest(mask: np.ndarray) -> int:
    best = run = 0
    for value in mask:
        run = run + 1 if value else 0
        best = max(best, run)
    return best


def main() -> None:
    """Print one line an episode and the totals."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--net", type=Path, required=True)
    parser.add_argument("--target", default="lane_graph")
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--horizon", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--density", type=float, default=9.0)
    parser.add_argument("--only", default="")
    args = parser.parse_args()
    road, found, begun = RoadMap.read(args.net), [], time.perf_counter()
    for scene in scenes(road, args.seed, args.scenes, args.horizon, args.density):
        if args.only and args.only not in scene.name:
            continue
        found.append(outcome(*drive(road, scene, args.target, args.horizon, args.seed)))
        print(
            {k: round(v, 3) if isinstance(v, float) else v for k, v in dataclasses.asdict(found[-1]).items()},
            flush=True,
        )
    _summary(found, time.perf_counter() - begun)


def _summary(found: list[Outcome], wall_s: float) -> None:
    count = len(found)
    hits = [x for x in found if x.hit]
    print(f"episodes {count}, wall {wall_s:.0f} s")
    print(
        f"contacts {len(hits)}, of these moving and ahead {sum(x.front and x.speed_mps > 0.5 for x in hits)}"
    )
    print(f"arrived {sum(x.end == 'arrived' for x in found)}, failed {sum(x.end == 'failed' for x in found)}")
    print(f"stood over 20 s {sum(x.stood_s > 20.0 for x in found)}")
    print(
        f"mean speed {np.mean([x.mean_mps for x in found]):.2f} m/s, driven {np.mean([x.driven_m for x in found]):.1f} m"
    )
    print(
        f"brake p95 {np.percentile([x.worst_brake_mps2 for x in found], 95):.1f}, plan {1e3 * np.median([x.plan_s for x in found]):.1f} ms"
    )


if __name__ == "__main__":
    main()
