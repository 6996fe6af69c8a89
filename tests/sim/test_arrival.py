"""When a target has arrived, with the real SUMO."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.plan import Controls
from advdiff_sumo.core.record import EndReason
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.seed_scene import SeedScene
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sim.warmup_scenes import NaturalTraffic
from tests.sim.scenes import episode


def test_the_target_arrives_at_the_end_of_its_route(scene: SeedScene, road: RoadMap) -> None:
    name = scene.target
    short = replace(scene, routes={**scene.routes, name: scene.routes[name][:1]})
    record, _ = episode(short, road, target="lane_graph", horizon_s=60.0).run()
    assert record.end == EndReason.ARRIVED


def test_a_fast_target_arrives_before_it_runs_off_the_net(networks: Path) -> None:
    motorway = RoadMap.read(networks / "motorway.net.xml")
    options = SceneOptions.parse({"warmup_s": 15.0, "scenes_per_warmup": 1, "min_speed_mps": 25.0})
    start = NaturalTraffic(motorway, None, options, SimOptions.parse({}), 4.0, SeedTree(1)).batch(0)[0]
    route = start.routes[start.target][:1]
    short = replace(start, routes={**start.routes, start.target: route})
    record, _ = episode(short, motorway, target="lane_graph", horizon_s=60.0).run()
    assert record.end == EndReason.ARRIVED
    place = motorway.locate(record.tracks.xy_m[record.target, -1], record.tracks.yaw_rad[record.target, -1])
    assert place is not None
    lane = motorway.lanes[place.lane_id]
    assert lane.edge_id == route[0]
    assert place.s_m + 2.5 <= lane.length_m


class OffTheRoad:
    """Turns by a radian to the right at 8 m/s, and continues straight on."""

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> float:
        return float(scene.history.yaw_rad[scene.target, -1]) - 1.0

    def plan(
        self, road: RoadMap, scene: Scene, memory: float, rng: np.random.Generator
    ) -> tuple[Controls, float]:
        now = scene.history
        left = float(wrap_angle(np.asarray(now.yaw_rad[scene.target, -1] - memory)))
        faster = 8.0 - float(now.speed_mps[scene.target, -1])
        steer = -0.15 if left > 0.1 else 0.0
        return Controls(np.full(10, np.clip(faster, -3.0, 2.0)), np.full(10, steer), 0.1), memory


def test_a_target_that_leaves_the_road_on_the_last_edge_does_not_arrive(
    scene: SeedScene, road: RoadMap
) -> None:
    """It has driven farther than the rest of its route, but is not near the end."""
    name = scene.target
    short = replace(scene, routes={**scene.routes, name: scene.routes[name][:1]})
    record, _ = episode(short, road, target=OffTheRoad(), horizon_s=10.0).run()
    xy = record.tracks.xy_m[record.target]
    line = road.lanes[road.edges[short.routes[name][0]].lane_ids[0]].line
    assert np.linalg.norm(np.diff(xy, axis=0), axis=-1).sum() > line.length_m - line.project(xy[0])[0]
    assert np.linalg.norm(xy - line.xy_m[-1], axis=-1).min() > 10.0
    assert record.end == EndReason.HORIZON
