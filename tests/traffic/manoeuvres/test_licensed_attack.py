"""What a licence makes of guided plans: plans that ram the target are refused, lawful manoeuvres are added."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.model_options import FUTURE_STEPS, MODEL_STEP_S
from advdiff_sumo.models.view import look
from advdiff_sumo.traffic.manoeuvres.commitments import Commitments
from advdiff_sumo.traffic.manoeuvres.licensed_attack import UNRESTRICTED, licensed_attack
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.planning.futures import Futures, constant_velocity_futures
from advdiff_sumo.traffic.policy_registry import make_policy
from tests.traffic.small_networks import downtown, street

__all__ = ["downtown", "street"]


def futures_of_scene(scene: Scene) -> Futures:
    history = scene.history
    return constant_velocity_futures(
        history.xy_m[:, -1],
        history.yaw_rad[:, -1],
        history.speed_mps[:, -1],
        history.size_m,
        FUTURE_STEPS,
        MODEL_STEP_S,
    )


def attack_of(
    road: RoadMap,
    scene: Scene,
    licence: Any,
    kept: Commitments | None = None,
    steps: int = FUTURE_STEPS,
    leaves: str = "",
) -> Any:
    view = look(road, scene, np.array([name == leaves for name in scene.history.ids]))
    assert view.ids == scene.history.ids
    futures = futures_of_scene(scene).first(steps)
    return licensed_attack(road, view, futures, ("v1",), licence, kept, 2)


@pytest.mark.parametrize(("licence", "refused"), [("lawful", (1,)), ("careless", (1,)), ("reckless", ())])
def test_a_plan_that_rams_the_target_is_refused(
    downtown: RoadMap, street: Callable[..., Scene], licence: str, refused: tuple[int, ...]
) -> None:
    scene = street([(60.0, 0.0), (40.0, 0.0)], [5.0, 13.0])
    attack = attack_of(downtown, scene, licence)
    assert attack.refused == refused
    assert attack.exempt is (licence == "reckless")


def test_a_short_plan_is_judged_beyond_its_end(downtown: RoadMap, street: Callable[..., Scene]) -> None:
    """It is 20 m behind and 8 m/s faster: contact after 2 s, a second after the plan's end."""
    scene = street([(60.0, 0.0), (40.0, 0.0)], [5.0, 13.0])
    assert attack_of(downtown, scene, "lawful", steps=2).refused == (1,)


def test_a_harmless_plan_is_left_unchanged(downtown: RoadMap, street: Callable[..., Scene]) -> None:
    scene = street([(40.0, 0.0), (80.0, 0.0)], [8.0, 9.0])
    assert attack_of(downtown, scene, "lawful").refused == ()


@pytest.mark.parametrize("licence", ["lawful", "careless"])
def test_guided_vehicles_follow_their_lanes_while_the_target_is_on_none(
    downtown: RoadMap, street: Callable[..., Scene], licence: str
) -> None:
    """The plan is the harmless one above, but the way of a target 60 m off its lane is unknown."""
    scene = street([(40.0, 60.0), (80.0, 0.0)], [8.0, 9.0])
    assert SituationView.of(downtown, scene).target is None
    assert attack_of(downtown, scene, licence).refused == (1,)
    assert attack_of(downtown, scene, "reckless").refused == ()


def test_a_lawful_manoeuvre_is_driven_beside_guided_plans(
    downtown: RoadMap, street: Callable[..., Scene]
) -> None:
    """The leader has been in view for three seconds."""
    scene = street([(30.0, 0.0), (52.0, 0.0)], [12.0, 12.0])
    scene = replace(scene, history=replace(scene.history, t0_s=scene.history.t0_s + 3.0 - scene.time_s))
    kept = replace(Commitments.start("hard-stop", np.random.default_rng(0)), since_s={"v1": 0.0})
    attack = attack_of(downtown, scene, "lawful", kept)
    assert list(attack.driven) == [1]
    assert attack.driven[1][2][-1] == 0.0


def test_a_vehicle_that_gets_no_plan_begins_no_manoeuvre(
    downtown: RoadMap, street: Callable[..., Scene]
) -> None:
    """It is the leader above, about to leave the net."""
    scene = street([(30.0, 0.0), (52.0, 0.0)], [12.0, 12.0])
    scene = replace(scene, history=replace(scene.history, t0_s=scene.history.t0_s + 3.0 - scene.time_s))
    kept = replace(Commitments.start("hard-stop", np.random.default_rng(0)), since_s={"v1": 0.0})
    attack = attack_of(downtown, scene, "lawful", kept, leaves="v1")
    assert (attack.driven, attack.commitments.active) == ({}, {})


@pytest.mark.parametrize(
    ("speed_mps", "rests_until_s", "refused"), [(3.0, 60.0, (1,)), (3.0, 0.0, ()), (8.0, 60.0, ())]
)
def test_a_vehicle_that_sets_off_after_a_manoeuvre_follows_its_lane(
    downtown: RoadMap,
    street: Callable[..., Scene],
    speed_mps: float,
    rests_until_s: float,
    refused: tuple[int, ...],
) -> None:
    scene = street([(30.0, 0.0), (80.0, 0.0)], [8.0, speed_mps])
    kept = Commitments.start("any", np.random.default_rng(0))
    kept = replace(kept, rested_s={"v1": scene.time_s + rests_until_s})
    assert attack_of(downtown, scene, "lawful", kept).refused == refused


def test_reckless_is_as_in_the_paper(downtown: RoadMap, street: Callable[..., Scene]) -> None:
    assert attack_of(downtown, street([(60.0, 0.0), (40.0, 0.0)], [5.0, 13.0]), "reckless") is UNRESTRICTED


@pytest.mark.parametrize(
    ("licence", "attack", "other"), [("lawful", "rear-end", "reckless"), ("reckless", "cut-out", "lawful")]
)
def test_an_attack_that_the_licence_does_not_have_is_refused(licence: str, attack: str, other: str) -> None:
    with pytest.raises(ConfigError, match=f"attack = '{attack}' is none of licence = '{licence}'.*'{other}'"):
        make_policy("diffusion", {"licence": licence, "attack": attack})
