"""The scripted background: its contract, its memory, and that it breaks no rule in closed loop."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.plan import AttackState
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.policy_registry import make_policy
from advdiff_sumo.traffic.scripted.scripted_policy import ScriptedTraffic
from tests.traffic.manoeuvres.scenes import long_lane, scene_on


@pytest.fixture(scope="module")
def motorway(networks: object) -> RoadMap:
    return RoadMap.read(f"{networks}/motorway.net.xml")


def test_the_leader_first_drives_ordinarily_then_stops_and_keeps_stopping(motorway: RoadMap) -> None:
    """It does not attack for the first three seconds."""
    lane = long_lane(motorway)
    policy = ScriptedTraffic(attack="hard-stop")
    rng = np.random.default_rng(0)
    cars = {"target": (lane, 50.0, 20.0), "leader": (lane, 85.0, 20.0)}
    memory = policy.start(motorway, scene_on(cars), None, rng)
    for time_s in np.arange(0.0, 3.0, 0.5).tolist():
        plan, memory = policy.plan(motorway, scene_on(cars, time_s), memory, rng)
        assert plan.attack == AttackState("hard-stop", (), {})
    plan, memory = policy.plan(motorway, scene_on(cars, 3.0), memory, rng)
    assert plan.tracks.ids == ("leader",)
    assert plan.tracks.speed_mps[0, -1] == 0.0
    assert plan.attack == AttackState("hard-stop", ("leader",), {"leader": "hard-stop"})
    slower = scene_on({"target": (lane, 60.0, 18.0), "leader": (lane, 94.0, 16.0)}, 3.5)
    again, _ = policy.plan(motorway, slower, memory, rng)
    assert again.tracks.ids == ("leader",)
    assert again.tracks.speed_mps[0, -1] == 0.0


def test_a_stop_is_over_when_both_stand_or_the_target_is_in_another_lane(motorway: RoadMap) -> None:
    lane = long_lane(motorway)
    policy = ScriptedTraffic(attack="hard-stop", staged=0)
    rng = np.random.default_rng(0)
    cars = {"target": (lane, 50.0, 20.0), "leader": (lane, 85.0, 20.0)}
    memory = policy.start(motorway, scene_on(cars), None, rng)
    for time_s in (0.0, 3.0):
        _, memory = policy.plan(motorway, scene_on(cars, time_s), memory, rng)
    assert memory.attacking == ("leader",)
    moves = scene_on({"target": (lane, 100.0, 3.0), "leader": (lane, 110.0, 0.0)}, 3.0)
    assert policy.plan(motorway, moves, memory, rng)[0].tracks.ids == ("leader",)
    stands = scene_on({"target": (lane, 104.0, 0.0), "leader": (lane, 110.0, 0.0)}, 3.0)
    assert policy.plan(motorway, stands, memory, rng)[0].tracks.agents == 0
    aside = motorway.lanes[lane.left_id or ""]
    passes = scene_on({"target": (aside, 100.0, 8.0), "leader": (lane, 110.0, 0.0)}, 3.0)
    assert policy.plan(motorway, passes, memory, rng)[0].tracks.agents == 0


def test_no_vehicle_is_moved_if_no_manoeuvre_is_useful(motorway: RoadMap) -> None:
    lane = long_lane(motorway)
    policy = ScriptedTraffic(staged=0)
    rng = np.random.default_rng(0)
    scene = scene_on({"target": (lane, 90.0, 20.0), "follower": (lane, 50.0, 20.0)})
    plan, _ = policy.plan(motorway, scene, policy.start(motorway, scene, None, rng), rng)
    assert plan.tracks.agents == 0
    assert plan.attack == AttackState("any", (), {})


def test_a_misspelt_kind_is_refused() -> None:
    with pytest.raises(ConfigError, match="attack = 'cutin'"):
        make_policy("scripted", {"attack": "cutin"})
