"""Seed scenes and episodes from nuScenes, on a net converted from its own HD map."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.errors import SceneError
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.record import Controller, EndReason
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.data import open_log
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.convert import convert_map
from advdiff_sumo.sim.logs import LoggedTraffic
from advdiff_sumo.sim.seed_scene import PlacedTraffic, SeedScene
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from tests.sim.scenes import episode

pytestmark = pytest.mark.data


def source(road: RoadMap, log: Path) -> LoggedTraffic:
    return LoggedTraffic(
        road, open_log(log), SceneOptions.parse({"stride_s": 3.0}), SimOptions.parse({}), SeedTree(0)
    )


@pytest.fixture(scope="module")
def log(adv_data: Path) -> Path:
    return adv_data / "nuscenes-mini"


@pytest.fixture(scope="module")
def road(log: Path, tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    net = tmp_path_factory.mktemp("onenorth") / "singapore-onenorth.net.xml"
    convert_map(log / "maps" / "expansion" / "singapore-onenorth.json", net)
    return RoadMap.read(net)


@pytest.fixture(scope="module")
def scenes(road: RoadMap, log: Path) -> list[SeedScene]:
    return list(source(road, log).scenes())


def test_only_the_drives_of_this_map_give_scenes(scenes: list[SeedScene]) -> None:
    assert len(scenes) >= 3
    assert {scene.name.rsplit("-", 1)[0] for scene in scenes} == {"scene-0061"}
    assert all(scene.target == "ego" for scene in scenes)


def test_a_scene_has_two_seconds_of_history_and_six_of_future_at_least(scenes: list[SeedScene]) -> None:
    for scene in scenes:
        assert scene.history.times_s.tolist() == [-2.0, -1.5, -1.0, -0.5, 0.0]
        assert scene.history.valid[scene.history.index["ego"]].all()
        assert scene.horizon_s >= 6.0


def test_the_target_starts_on_a_lane_and_its_route_is_connected(
    scenes: list[SeedScene], road: RoadMap
) -> None:
    for scene in scenes:
        row = scene.history.index["ego"]
        pose = road.locate(scene.history.xy_m[row, -1], float(scene.history.yaw_rad[row, -1]))
        assert pose is not None
        assert abs(pose.d_m) <= 0.5 * road.lanes[pose.lane_id].width_m
        assert abs(pose.yaw_error_rad) <= 0.1
        route = scene.routes["ego"]
        assert all(b in road.edges[a].successors for a, b in pairwise(route))


def test_sumo_does_not_drive_pedestrians_and_parked_vehicles(scenes: list[SeedScene]) -> None:
    for scene in scenes:
        assert isinstance(scene.start, PlacedTraffic)
        walks = scene.log.classes == AgentClass.PEDESTRIAN
        assert walks.any()
        assert not (walks & scene.start.drivable).any()


def test_replay_is_at_every_logged_pose_at_every_keyframe(scenes: list[SeedScene], road: RoadMap) -> None:
    for scene in scenes[:2]:
        record, _ = episode(scene, road, background="replay", horizon_s=20.0).run()
        assert record.failure is None
        tracks, log = record.tracks, scene.log
        compared = 0
        for agent, name in enumerate(log.ids):
            row = tracks.index.get(name)
            if name == "ego" or row is None:
                continue
            for step in np.flatnonzero(log.valid[agent] & (log.times_s > -1e-9)):
                k = round(log.times_s[step] / tracks.dt_s)
                if k < tracks.steps and tracks.valid[row, k]:
                    compared += 1
                    assert np.hypot(*(tracks.xy_m[row, k] - log.xy_m[agent, step])) <= 0.05
                    turn = wrap_angle(tracks.yaw_rad[row, k] - log.yaw_rad[agent, step])
                    assert abs(float(turn)) <= 0.01
        assert compared > 500


def test_sumo_takes_over_what_it_can_drive_and_the_rest_follows_the_log(
    scenes: list[SeedScene], road: RoadMap
) -> None:
    scene = scenes[0]
    record, _ = episode(scene, road, background="sumo", horizon_s=6.0).run()
    assert record.end in {EndReason.HORIZON, EndReason.LOG_END}
    assert isinstance(scene.start, PlacedTraffic)
    drivable = dict(zip(scene.log.ids, scene.start.drivable, strict=True))
    for row, name in enumerate(record.tracks.ids):
        if name == scene.target:
            continue
        movers = set(np.unique(record.controller[row])) - {Controller.ABSENT}
        if not drivable[name]:
            assert movers <= {Controller.REPLAYED}
    assert (record.controller == Controller.SUMO).any()


def test_the_target_is_released_without_a_jump(scenes: list[SeedScene], road: RoadMap) -> None:
    for scene in scenes:
        record, _ = episode(scene, road, background="replay", horizon_s=1.0).run()
        own = record.tracks.rows([record.target])
        stride = np.hypot(*np.diff(own.xy_m[0], axis=0).T)
        assert (stride <= own.speed_mps[0].max() * own.dt_s + 0.3).all()


def test_a_net_of_another_place_is_refused(networks: Path, log: Path) -> None:
    with pytest.raises(SceneError, match="none of the log's drives is on this net"):
        next(source(RoadMap.read(networks / "downtown.net.xml"), log).scenes())
