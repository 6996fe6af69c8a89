"""Seed scenes from natural traffic."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.errors import SceneError
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.scene_file import scene_to_bytes
from advdiff_sumo.sim.seed_scene import SavedTraffic, SeedScene
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sim.target_route import turns_round
from advdiff_sumo.sim.warmup_scenes import NaturalTraffic, with_draws_since
from tests import rare_net
from tests.sim import nets

OPTIONS = {"warmup_s": 15.0, "scenes_per_warmup": 2, "spacing_s": 5.0}


def source(road: RoadMap, **options: float) -> NaturalTraffic:
    scene = SceneOptions.parse({**OPTIONS, **options})
    return NaturalTraffic(road, None, scene, SimOptions.parse({}), 4.0, SeedTree(3))


@pytest.fixture(scope="module")
def scenes(road: RoadMap) -> list[SeedScene]:
    return source(road).batch(0)


def test_a_batch_has_the_scenes_asked_for_with_names_of_their_own(scenes: list[SeedScene]) -> None:
    assert [scene.name for scene in scenes] == ["downtown-000-00", "downtown-000-01"]
    assert all(scene.target in scene.history.index for scene in scenes)


def test_the_target_has_traffic_around_it_and_a_route_ahead(scenes: list[SeedScene], road: RoadMap) -> None:
    for scene in scenes:
        now = scene.history.xy_m[:, -1]
        gap = np.linalg.norm(now - now[scene.history.index[scene.target]], axis=-1)
        assert (gap < 50.0).sum() - 1 >= 3
        route = scene.routes[scene.target]
        assert sum(road.edges[edge].length_m for edge in route) >= 120.0
        assert all(b in road.edges[a].successors for a, b in pairwise(route))


def test_history_ends_where_the_log_begins(scenes: list[SeedScene]) -> None:
    for scene in scenes:
        history, log = scene.history, scene.log
        assert history.steps == 5
        assert history.times_s.tolist() == [-2.0, -1.5, -1.0, -0.5, 0.0]
        assert log.steps == 41
        for row, name in enumerate(history.ids):
            np.testing.assert_array_equal(history.xy_m[row, -1], log.xy_m[log.index[name], 0])


def test_the_same_seed_gives_the_same_scenes(scenes: list[SeedScene], road: RoadMap) -> None:
    again = source(road).batch(0)
    for first, second in zip(scenes, again, strict=True):
        assert first.target == second.target
        assert first.history.ids == second.history.ids
        np.testing.assert_array_equal(first.log.xy_m, second.log.xy_m)
        assert isinstance(first.start, SavedTraffic)
        assert isinstance(second.start, SavedTraffic)
        assert first.start.time_s == second.start.time_s


def test_the_first_scenes_alone_are_those_of_the_whole_batch(scenes: list[SeedScene], road: RoadMap) -> None:
    (alone,) = source(road).batch(0, wanted=1)
    assert scene_to_bytes(_undated(alone)) == scene_to_bytes(_undated(scenes[0]))


def _undated(scene: SeedScene) -> SeedScene:
    """Return *scene* without SUMO's comment on when its state was saved, and from which files SUMO had begun."""
    assert isinstance(scene.start, SavedTraffic)
    state_xml = re.sub(rb"<!--.*?-->", b"", scene.start.state_xml, count=1, flags=re.DOTALL)
    return replace(scene, start=replace(scene.start, state_xml=state_xml))


def test_draws_of_earlier_simulations_of_the_process_do_not_count() -> None:
    now = b'<snapshot time="12"><rngState default="5536" device.toc="3"><rngLane id="7" default="9"/></snapshot>'
    begin = b'<rngState default="3158" device.toc="0">'
    assert with_draws_since(now, begin) == now.replace(b"5536", b"2378")
    assert with_draws_since(now, b"") == now


def test_a_scene_does_not_depend_on_what_the_process_did_before(tmp_path: Path) -> None:
    road = RoadMap.read(rare_net.build(tmp_path, ["bends", "bicycle lane", "blinking light", "turnarounds"]))
    options = {"scenes_per_warmup": 1, "min_neighbours": 1, "min_route_m": 20.0, "min_speed_mps": 0.0}
    draws = []
    for _ in range(2):
        scene = source(road, **options, density_per_km=25.0).batch(0)[0]
        assert isinstance(scene.start, SavedTraffic)
        draws.append(re.findall(rb"<rngState.*?>", scene.start.state_xml))
    assert draws[0] == draws[1]
    assert b'default="0"' not in draws[0][0]  # something was drawn


def test_another_batch_is_other_traffic(scenes: list[SeedScene], road: RoadMap) -> None:
    other = source(road).batch(1)[0]
    assert other.name == "downtown-001-00"
    assert other.history.xy_m.shape != scenes[0].history.xy_m.shape or not np.array_equal(
        other.history.xy_m, scenes[0].history.xy_m
    )


def test_a_net_without_such_a_target_is_refused_with_the_remedy(road: RoadMap) -> None:
    with pytest.raises(SceneError, match=r"no vehicle with 500 others near it.*lower scene\.min_neighbours"):
        source(road, min_neighbours=500, spacing_s=0.2, density_per_km=1.0, warmup_s=5.0).batch(0)


def test_a_route_that_turns_round_on_the_spot_is_told_from_one_that_goes_on(tmp_path: Path) -> None:
    road = RoadMap.read(nets.build(tmp_path, *nets.STREET, turnarounds=True))
    assert turns_round(road, "ME", "EM")
    assert not turns_round(road, "WM", "ME")
