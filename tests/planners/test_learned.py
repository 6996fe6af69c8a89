"""Targets on trained models: what they choose, that they keep to road and route, and that they drive in SUMO."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from advdiff_sumo.core.boxes import corners, overlap
from advdiff_sumo.core.errors import ConfigError, WeightsError
from advdiff_sumo.core.plan import Trajectory
from advdiff_sumo.core.record import EndReason
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.shipped_weights import shipped_weights
from advdiff_sumo.models.simnet import begin_simnet, save_simnet
from advdiff_sumo.planners.learned.candidate_score import Around, followers, risk
from advdiff_sumo.planners.learned.candidates import BRAKE, RAW, candidates
from advdiff_sumo.planners.planner_check import check_planner
from advdiff_sumo.planners.planner_protocol import Planner
from advdiff_sumo.planners.planner_registry import make_target
from advdiff_sumo.sim.episode import Episode
from advdiff_sumo.sim.seed_scene import SeedScene
from advdiff_sumo.sim.sim_options import SimOptions
from advdiff_sumo.traffic.sumo_traffic import SumoTraffic

from .harness import outcome, scenes
from .scenes import CAR_M, Car, make_scene, roll

NAMES = ("simnet", "trafficsim", "diffusion")
Maker = Callable[..., Planner]


@pytest.fixture(autouse=True, scope="module")
def _one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory) -> Maker:
    """Return a maker of targets; SimNet on the shipped encoder where no SimNet is shipped."""
    path = shipped_weights("simnet")
    if not path.is_file():
        path = tmp_path_factory.mktemp("weights") / "simnet.safetensors"
        save_simnet(begin_simnet(shipped_weights(), ModelOptions()), path)

    def make(name: str, **options: Any) -> Planner:
        more = {"weights": str(path)} if name == "simnet" else {}
        made = make_target(name, {**more, **options})
        assert isinstance(made, Planner)
        return made

    return make


@pytest.fixture(scope="module")
def downtown(networks: Path) -> tuple[RoadMap, SeedScene]:
    road = RoadMap.read(networks / "downtown.net.xml")
    return road, next(scenes(road, 7, 1, 15.0))


@pytest.mark.parametrize("name", NAMES)
def test_it_drives_ten_seconds_of_traffic_repeatably(
    target: Maker, downtown: tuple[RoadMap, SeedScene], name: str
) -> None:
    road, scene = downtown
    sim = SimOptions(record_natural=False)
    first, again = (
        Episode(0, scene, road, target(name), SumoTraffic(), (name, "sumo"), sim, 10.0, SeedTree(3)).run()
        for _ in range(2)
    )
    record, timing = first
    found = outcome(record, timing, road)
    assert record.end is not EndReason.FAILED, found.failure
    assert found.struck != "left the road"
    assert not found.at_fault, found
    assert len(timing.target_plans_s) >= 19
    for part in ("xy_m", "yaw_rad", "speed_mps"):
        assert getattr(record.tracks, part).tobytes() == getattr(again[0].tracks, part).tobytes()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("lefthand", [False, True])
def test_it_keeps_the_contract(
    target: Maker, crossing: Callable[..., RoadMap], name: str, lefthand: bool
) -> None:
    road = crossing("priority", lefthand)
    cars = [Car("south_in_0", 150.0, 8.0), Car("west_in_0", 150.0, 12.0), Car("east_in_1", 120.0, 12.0)]
    scene = make_scene(road, cars, ("south_in", "north_out"))
    assert check_planner(target(name), road, scene) == []
    lost = replace(scene, routes=((), (), ()))
    assert check_planner(target(name), road, lost) == []


@pytest.mark.parametrize(
    "route", [("west_in", "north_out"), ("west_in", "south_out"), ("west_in", "east_out")]
)
def test_it_turns_where_the_route_turns(
    target: Maker, crossing: Callable[..., RoadMap], route: tuple[str, str]
) -> None:
    """The model knows no route: by itself it would drive the same way for all three."""
    road = crossing()
    lane = "west_in_1" if route[1] == "north_out" else "west_in_0"
    scene = make_scene(road, [Car(lane, 165.0, 7.0)], route)
    driven = roll(road, target("diffusion"), scene, 9.0)
    pose = road.locate(driven.xy_m[0, -1], float(driven.yaw_rad[0, -1]))
    assert pose is not None
    edges = {road.lanes[pose.lane_id].edge_id}
    assert route[1] in edges or float(driven.speed_mps[0].min()) < 1.0, edges  # it arrived, or stopped before
    boxes = corners(driven.xy_m[0], driven.yaw_rad[0], np.broadcast_to(np.array(CAR_M), (driven.steps, 2)))
    assert float(road.off_road_share(boxes).max()) < 0.1


@pytest.mark.parametrize("name", NAMES)
def test_it_stops_at_a_red_light(target: Maker, crossing: Callable[..., RoadMap], name: str) -> None:
    road = crossing("traffic_light")
    scene = make_scene(road, [Car("west_in_0", 130.0, 10.0)], ("west_in", "east_out"), {"c": "r" * 40})
    driven = roll(road, target(name), scene, 8.0)
    line = road.to_world("west_in_0", road.lanes["west_in_0"].length_m)[0][0]
    assert float(driven.xy_m[0, :, 0].max()) + 0.5 * CAR_M[0] < line + 0.5


@pytest.mark.parametrize("name", NAMES)
def test_it_does_not_run_into_a_standing_car(
    target: Maker, crossing: Callable[..., RoadMap], name: str
) -> None:
    road = crossing()
    scene = make_scene(
        road, [Car("south_in_0", 100.0, 10.0), Car("south_in_0", 140.0)], ("south_in", "north_out")
    )
    driven = roll(road, target(name), scene, 8.0)
    assert not touching(driven)


def touching(driven: Tracks) -> bool:
    boxes = [
        corners(driven.xy_m[k], driven.yaw_rad[k], np.broadcast_to(driven.size_m[k], (driven.steps, 2)))
        for k in (0, 1)
    ]
    return bool(overlap(boxes[0], boxes[1]).any())


def first_plan(planner: Planner, road: RoadMap, scene: Scene, seed: int) -> Trajectory:
    rng = np.random.default_rng(seed)
    plan, _ = planner.plan(road, scene, planner.start(road, scene, rng), rng)
    assert isinstance(plan, Trajectory)
    return plan


def test_the_mean_of_the_prior_is_deterministic_and_samples_are_not(
    target: Maker, crossing: Callable[..., RoadMap]
) -> None:
    road = crossing()
    scene = make_scene(
        road, [Car("west_in_0", 100.0, 9.0), Car("west_in_1", 110.0, 8.0)], ("west_in", "east_out")
    )
    raw: dict[str, Any] = {"route": False, "brakes": False}
    mean = target("trafficsim", draws=0, **raw)
    one, other = (first_plan(mean, road, scene, seed) for seed in (1, 2))
    assert one.xy_m.tobytes() == other.xy_m.tobytes()
    drawing = target("diffusion", samples=1, **raw)
    assert (
        first_plan(drawing, road, scene, 1).xy_m.tobytes()
        != first_plan(drawing, road, scene, 2).xy_m.tobytes()
    )


def test_risk_is_the_share_of_samples_with_a_collision_and_fades() -> None:
    """One candidate stands still; in the first of two samples a vehicle overlaps it at the last instant."""
    still = np.zeros((1, 3, 2)), np.zeros((1, 3)), np.zeros((1, 3))
    made = candidates(*still, None, (np.zeros(2), 0.0, 0.0), 0.5, route=False, brakes=False)
    xy = np.full((2, 1, 3, 2), 50.0)
    xy[0, 0, 2] = 0.0
    around = Around(xy, np.zeros((2, 1, 3)), np.array([[4.0, 2.0]]), np.zeros(1, dtype=np.bool_))
    size = np.array([4.0, 2.0])
    assert risk(made, around, size, 0.5) == pytest.approx([0.5 * np.exp(-0.5 * 0.5 * 4 / 4.0)])
    behind = replace(around, ignored=np.ones(1, dtype=np.bool_))
    assert risk(made, behind, size, 0.5) == pytest.approx([0.0])


def test_followers_are_behind_in_the_same_lane() -> None:
    own = np.zeros(2), 0.0, 4.0
    xy = np.array([[-10.0, 0.5], [-10.0, 3.0], [10.0, 0.0], [-10.0, 0.0]])
    yaw = np.array([0.1, 0.0, 0.0, np.pi])
    assert followers(xy, yaw, own).tolist() == [True, False, False, False]


def test_braking_is_a_candidate_and_straight_without_a_guide() -> None:
    ahead = np.cumsum(np.full((1, 4), 5.0), axis=1)
    xy = np.stack((ahead, np.zeros_like(ahead)), axis=-1)
    made = candidates(
        xy, np.zeros((1, 4)), np.full((1, 4), 10.0), None, (np.zeros(2), 0.0, 10.0), 0.5, True, True
    )
    assert made.line.tolist() == [RAW, BRAKE, BRAKE, BRAKE]
    assert made.speed_mps[1:].tolist() == [[9.0, 8.0, 7.0, 6.0], [8.0, 6.0, 4.0, 2.0], [6.0, 2.0, 0.0, 0.0]]
    assert made.xy_m[1, :, 0] == pytest.approx([4.75, 9.0, 12.75, 16.0])


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("simnet", {"wieghts": "x"}, "did you mean 'weights'"),
        ("trafficsim", {"draws": -1}, "draws = -1"),
        ("diffusion", {"steps": 500}, "ask for at most so many"),
        ("diffusion", {"device": "abacus"}, "target 'diffusion': device = 'abacus'"),
    ],
)
def test_a_bad_option_says_what_to_do(target: Maker, name: str, options: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        target(name, **options)


def test_weights_of_another_kind_are_refused(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="is not of the format"):
        make_target("simnet", {"weights": str(shipped_weights())})
    with pytest.raises(WeightsError, match="no such file"):
        make_target("trafficsim", {"weights": str(tmp_path / "none.safetensors")})
