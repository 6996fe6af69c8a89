"""The reward of half a second, worked by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.rl.adversary_reward import (
    DecisionInterval,
    accel_before,
    hit_by_attacker,
    mean_accel,
    reward_terms,
)
from advdiff_sumo.rl.rl_options import RewardWeights
from advdiff_sumo.sim.world import Frame

WEIGHTS = RewardWeights()


@pytest.fixture(scope="module")
def road(networks: Path) -> RoadMap:
    return RoadMap.read(networks / "downtown.net.xml")


@pytest.fixture(scope="module")
def place(road: RoadMap) -> tuple[np.ndarray, float]:
    """Return a point and heading in the middle of the longest lane."""
    lane = max((x for x in road.lanes.values() if not x.is_internal), key=lambda x: (x.length_m, x.id))
    xy, yaw = lane.line.at(0.5 * lane.length_m)
    return xy, float(yaw)


def half(place: tuple[np.ndarray, float], ahead: list[list[float]], **more: Any) -> DecisionInterval:
    """Return vehicles of 4 × 2 m on one line; *ahead* has their positions at each instant, the target first."""
    xy, yaw = place
    way = np.array((np.cos(yaw), np.sin(yaw)))
    speeds = more.pop("speeds", np.zeros((len(ahead), len(ahead[0]))))
    frames = [
        Frame(
            xy + np.array(row)[:, None] * way,
            np.where(np.isnan(row), np.nan, yaw),
            np.asarray(speed, dtype=np.float64),
            np.zeros(len(row), dtype=np.int64),
        )
        for row, speed in zip(ahead, speeds, strict=True)
    ]
    given: dict[str, Any] = {
        "attacker": 1,
        "target": 0,
        "collided": False,
        "accel_mps2": 0.0,
        "residual": np.zeros(2),
        "dt_s": 0.1,
    }
    return DecisionInterval(frames, np.tile([4.0, 2.0], (len(ahead[0]), 1)), **{**given, **more})


def test_an_interval_of_one_instant_has_no_jerk(road: RoadMap, place: tuple[np.ndarray, float]) -> None:
    """The target left the net in the first simulation step: only the instant before it is left."""
    terms = reward_terms(half(place, [[12.0, 0.0]], accel_mps2=-5.0), WEIGHTS, road)
    assert terms["jerk"] == 0.0


def test_jerk_is_that_of_the_attacker(road: RoadMap, place: tuple[np.ndarray, float]) -> None:
    """From 10 to 11 m/s in the half second before, 2 m/s², and to 12.5 m/s in this one, 3 m/s²: 2 m/s³, 0.04 units.

    The third was not there before.
    """
    past = half(
        place, [[40.0, 0.0, np.nan], [40.0, 5.0, 9.0]], speeds=[[0.0, 10.0, np.nan], [0.0, 11.0, 14.0]]
    )
    before = [accel_before(past.frames, row, 0.5) for row in (1, 2, 3)]
    assert before == [2.0, None, None]
    assert accel_before(past.frames[1:], 1, 0.5) is None
    speeds = [[0.0, 11.0, 14.0], [0.0, 12.5, 9.0]]
    now = half(place, [[80.0, 5.0, 30.0], [80.0, 11.0, 36.0]], speeds=speeds, dt_s=0.5, accel_mps2=2.0)
    assert reward_terms(now, WEIGHTS, road)["jerk"] == pytest.approx(-0.05 * 0.04)
    new = replace(now, attacker=2, accel_mps2=None)
    assert reward_terms(new, WEIGHTS, road)["jerk"] == 0.0


def test_nearness_is_that_of_the_nearest_instant(road: RoadMap, place: tuple[np.ndarray, float]) -> None:
    """Centres 12, 9 and 10 m apart: the smallest gap of the boxes is 5 m, 1/e of the weight."""
    terms = reward_terms(half(place, [[12.0, 0.0], [9.0, 0.0], [10.0, 0.0]]), WEIGHTS, road)
    assert terms == pytest.approx(
        {"hit": 0.0, "near": 0.2 / np.e, "touch": 0.0, "off_road": 0.0, "jerk": 0.0, "align": 0.0}
    )


def test_a_hit_by_the_attacker_does_not_depend_on_the_weights(place: tuple[np.ndarray, float]) -> None:
    assert hit_by_attacker(half(place, [[6.0, 0.0], [4.0, 0.0]], collided=True))
    assert not hit_by_attacker(half(place, [[6.0, 0.0], [5.0, 0.0]], collided=True))
    assert not hit_by_attacker(half(place, [[6.0, 0.0], [4.0, 0.0]], collided=False))
    assert not hit_by_attacker(half(place, [[6.0, 0.0], [4.0, 0.0]], collided=True, attacker=None))


def test_a_collision_with_the_attacker_counts_most(road: RoadMap, place: tuple[np.ndarray, float]) -> None:
    struck = reward_terms(half(place, [[6.0, 0.0], [4.0, 0.0]], collided=True), WEIGHTS, road)
    assert struck["hit"] == 10.0
    assert struck["near"] == pytest.approx(0.2)
    another = reward_terms(half(place, [[6.0, 0.0], [5.0, 0.0]], collided=True), WEIGHTS, road)
    assert another["hit"] == 3.0
    no_attacker = half(place, [[6.0, 0.0], [5.0, 0.0]], collided=True, attacker=None)
    assert reward_terms(no_attacker, WEIGHTS, road) == {"hit": 3.0}
    gone = half(place, [[6.0, 0.0], [5.0, np.nan]], collided=False)
    assert reward_terms(gone, WEIGHTS, road) == {"hit": 0.0}


def test_touching_another_road_user_costs_only_when_it_begins(
    road: RoadMap, place: tuple[np.ndarray, float]
) -> None:
    begins = half(place, [[40.0, 0.0, 5.0], [40.0, 1.0, 5.0], [40.0, 1.5, 5.0]])
    assert reward_terms(begins, WEIGHTS, road)["touch"] == -4.0
    lasts = half(place, [[40.0, 1.0, 5.0], [40.0, 1.0, 5.0]])
    assert reward_terms(lasts, WEIGHTS, road)["touch"] == 0.0


def test_costs_of_leaving_the_road_jerk_and_deviation(road: RoadMap, place: tuple[np.ndarray, float]) -> None:
    """From 10 to 11 m/s in 0.2 s is 5 m/s², after 1 m/s² a jerk of 20 m/s³: four units, the upper bound."""
    made = half(
        place,
        [[40.0, 0.0], [40.0, 1.0], [40.0, 2.0]],
        speeds=[[0.0, 10.0], [0.0, 10.5], [0.0, 11.0]],
        accel_mps2=1.0,
        residual=np.array([0.6, -0.8]),
    )
    terms = reward_terms(made, WEIGHTS, road)
    assert mean_accel(made, 1) == pytest.approx(5.0)
    assert terms["jerk"] == pytest.approx(-0.05 * 4.0)
    assert terms["align"] == pytest.approx(-0.05)
    assert terms["off_road"] == 0.0
    far = (place[0] + 1e4, place[1])
    assert reward_terms(half(far, [[40.0, 0.0], [40.0, 0.0]]), WEIGHTS, road)["off_road"] == pytest.approx(
        -2.0
    )
