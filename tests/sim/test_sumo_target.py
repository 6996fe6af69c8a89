"""A SUMO-driven target in an episode: offsets by the net's side of the road, drawn desired speeds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.record import EndReason
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.planner_protocol import SumoDriver
from advdiff_sumo.planners.planner_registry import make_target
from advdiff_sumo.sim.seed_scene import SeedScene
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sim.sumo_target import as_driven
from advdiff_sumo.sim.warmup_scenes import NaturalTraffic
from tests.sim.scenes import episode


def scene_on(road: RoadMap) -> SeedScene:
    """Return a scene in which the target stays in its lane on both nets."""
    options = SceneOptions.parse({"warmup_s": 15.0, "scenes_per_warmup": 1})
    return NaturalTraffic(road, None, options, SimOptions.parse({}), 8.0, SeedTree(5)).batch(0)[0]


def params_in_episode(options: dict[str, Any], seed: int = 0, lefthand: bool = False) -> dict[str, Any]:
    driven = as_driven(make_target("IDM", options), lefthand, SeedTree(seed))
    assert isinstance(driven, SumoDriver)
    return dict(driven.params)


def left_of_middle_m(scene: SeedScene, road: RoadMap, **options: Any) -> float:
    """Return the median offset of the target to the left of its lane's middle, on straight lanes, from 3 s on."""
    record, _ = episode(scene, road, make_target("IDM", options), horizon_s=8.0).run()
    assert record.end is not EndReason.FAILED
    tracks, row = record.tracks, record.target
    steps = np.flatnonzero(tracks.valid[row])[30:]
    lanes, _, d, _ = road.locate_many(tracks.xy_m[row, steps], tracks.yaw_rad[row, steps])
    on_edges = [lane is not None and not road.lanes[lane].is_internal for lane in lanes]
    assert sum(on_edges) >= 10
    return float(np.median(d[on_edges]))


@pytest.mark.parametrize("net", ["downtown", "downtown-left"])
def test_a_target_that_believes_to_be_too_far_left_drives_too_far_right(networks: Path, net: str) -> None:
    road = RoadMap.read(networks / f"{net}.net.xml")
    scene = scene_on(road)
    sound = left_of_middle_m(scene, road)
    assert left_of_middle_m(scene, road, defects="localisation:0.5") == pytest.approx(sound - 0.5, abs=0.15)
    assert left_of_middle_m(scene, road, defects="localisation:-0.5") == pytest.approx(sound + 0.5, abs=0.15)


def test_only_the_planted_offset_takes_the_side_of_the_net() -> None:
    assert params_in_episode({"defects": "localisation:0.5"}) == {"latAlignment": -0.5}
    assert params_in_episode({"defects": "localisation:0.5"}, lefthand=True) == {"latAlignment": 0.5}
    own = {"params": {"latAlignment": "0.5"}}
    assert params_in_episode(own, lefthand=True) == params_in_episode(own) == {"latAlignment": "0.5"}


def factors(count: int, **options: Any) -> np.ndarray[Any, Any]:
    drawn = [params_in_episode(options, seed) for seed in range(count)]
    assert {params["speedDev"] for params in drawn} == {0.0}
    return np.array([params["speedFactor"] for params in drawn])


def test_a_desired_speed_is_drawn_anew_in_each_episode_and_again_in_the_same() -> None:
    drawn = factors(1000, speedFactor="normc(1,0.1,0.2,2)")
    assert (drawn == factors(1000, speedFactor="normc(1,0.1,0.2,2)")).all()
    assert drawn.mean() == pytest.approx(1.0, abs=0.015)  # 4.7 standard errors
    assert drawn.std() == pytest.approx(0.1, abs=0.01)
    cut = factors(1000, speedFactor="normc(1, 0.1, 0.95, 1.05)")  # 0.38 of the density: all but even
    assert (cut.min() >= 0.95, cut.max() <= 1.05) == (True, True)
    assert cut.std() == pytest.approx(0.0283, abs=0.002)
    assert factors(1000, params={"speedDev": 0.2}).std() == pytest.approx(0.2, abs=0.02)
    assert factors(3, speedFactor=1.3).tolist() == [1.3, 1.3, 1.3]


def test_sumo_drives_with_the_desired_speed_that_was_drawn(scene: SeedScene, road: RoadMap) -> None:
    target = make_target("IDM", {"speedFactor": "normc(1,0.1,0.2,2)"})
    for number in (1, 2):
        made = replace(episode(scene, road, target), seed=SeedTree(number))
        driven = as_driven(target, road.lefthand, made.seed)
        assert isinstance(driven, SumoDriver)
        with made.opened() as loop:
            loop.start()
            factor = loop.session.api.vehicle.getSpeedFactor(scene.target)
        assert factor == pytest.approx(driven.params["speedFactor"], abs=1e-4)
        assert factor != pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"speedFactor": "normc(1,0.1)"}, "expected a number, norm"),
        ({"speedFactor": "fast"}, "expected a number, or SUMO's text such as normc"),
        ({"speedFactor": "normc(3,0.1,0.2,2)"}, "0 <= low <= mean <= high"),
        ({"params": {"speedDev": "much"}}, "speedDev = 'much' is no number of at least 0"),
    ],
)
def test_a_desired_speed_that_cannot_be_drawn_gets_a_sentence(options: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        make_target("IDM", options)
