"""The plan made of a proposal, and the number of vehicles that the safeguard changed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from advdiff_sumo.core.scene import TRACK_ARRAYS, Scene, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.view import View
from advdiff_sumo.traffic.background_plan import Rules, plausible_plan, remaining_plan, view_and_lanes
from advdiff_sumo.traffic.licence import LicenceName
from advdiff_sumo.traffic.planning.drawn import Drawn
from tests.traffic.manoeuvres.scenes import scene_on

PLACES = [(60.0, 0.0), (75.0, 0.0), (45.0, 0.0), (90.0, 0.0), (30.0, 0.0)]


def proposal(view: View, aside_m: float) -> Drawn:
    """Return a proposal in which all drive straight on, the second vehicle offset by *aside_m* to the left."""
    x, y, yaw, speed = (value[..., None].expand(-1, -1, 12) for value in view.batch.pose.unbind(-1))
    along, aside = 0.5 * torch.arange(1.0, 13.0) * speed, torch.zeros_like(x)
    aside[0, 1] = aside_m
    cos, sin = torch.cos(yaw), torch.sin(yaw)
    xy = torch.stack((x + cos * along - sin * aside, y + sin * along + cos * aside), dim=-1)
    rollout = Rollout(xy, yaw, speed, torch.zeros_like(x), torch.zeros_like(x))
    return Drawn(rollout, {}, (), torch.zeros(len(view.ids), 0))


def test_plans_that_the_safeguard_changed_are_counted(
    downtown: RoadMap, street: Callable[..., Scene]
) -> None:
    """Four vehicles follow each other as fast as the target; then one of them is 9 m off its lane in half a second."""
    scene = street(PLACES, [8.0] * 5)
    view, lanes = view_and_lanes(downtown, scene)
    counts = {}
    for aside_m in (0.0, 9.0):
        plan = plausible_plan(downtown, view, lanes, proposal(view, aside_m), (None, 0), Rules("reckless", 0))
        counts[aside_m] = plan.safeguarded
        assert set(plan.tracks.ids) == {"v1", "v2", "v3", "v4"}
    assert counts == {0.0: (0, 4), 9.0: (1, 4)}


@pytest.mark.parametrize(("licence", "attackers"), [("lawful", ("v1",)), ("reckless", ("v1", "v4"))])
def test_a_vehicle_whose_proposal_the_licence_refuses_is_no_attacker(
    licence: LicenceName, attackers: tuple[str, ...], downtown: RoadMap, street: Callable[..., Scene]
) -> None:
    """Both keep their speed: the vehicle ahead may, the one behind would hit a target that brakes at 4 m/s²."""
    scene = street(PLACES, [8.0] * 5)
    view, lanes = view_and_lanes(downtown, scene)
    drawn = replace(proposal(view, 0.0), attackers=("v1", "v4"))
    plan = plausible_plan(downtown, view, lanes, drawn, (None, 0), Rules(licence, 2))
    assert plan.attackers == attackers


def test_the_rest_of_a_plan(downtown: RoadMap, street: Callable[..., Scene]) -> None:
    """Twelve half seconds, planned at 0 s; after 5 s in two calls two are left, and the next call is in 5 more."""
    scene = street(PLACES, [8.0] * 5)
    plan = scene.history.rows([1, 2, 3, 4])
    plan = replace(coasted(plan, 12), t0_s=scene.time_s + 0.5)

    def left(after_s: float, before: int, replan: int) -> int | None:
        now = replace(scene, history=scene.history.shifted(after_s))
        rest = remaining_plan(downtown, plan, before, now, replan)
        assert rest is None or rest.t0_s == pytest.approx(now.time_s + 0.5)
        return None if rest is None else rest.steps

    assert [left(0.5, 0, 4), left(1.0, 1, 4), left(1.5, 2, 4), left(2.0, 3, 4)] == [11, 10, 9, None]
    assert [left(1.0, 0, 4), left(2.0, 2, 4)] == [10, None]
    assert [left(2.5, 0, 12), left(5.0, 5, 12), left(5.0, 9, 12)] == [7, None, 2]
    assert [left(0.0, 0, 4), left(0.7, 0, 4), left(0.5, 0, 1)] == [None] * 3


def test_a_plan_is_continued_while_a_vehicle_leaves_the_net(road: RoadMap) -> None:
    """At 8 m/s a vehicle within 28 m of the road's end is left to SUMO: 20 m before it, not 60 m."""
    dead = [x for x in road.lanes.values() if not x.successors and not x.is_internal and x.length_m > 150.0]
    lane = min(dead, key=lambda x: x.id)
    places = {"target": 100.0, "stays": 60.0, "leaves": 20.0}
    scene = scene_on({name: (lane, lane.length_m - back, 8.0) for name, back in places.items()})
    plan = replace(coasted(scene.history.rows([1]), 12), t0_s=scene.time_s + 0.5)
    later = replace(scene, history=scene.history.shifted(0.5))
    rest = remaining_plan(road, plan, 0, later, 4)
    assert rest is not None
    assert (rest.ids, rest.steps) == (("stays",), 11)
    both = replace(coasted(scene.history.rows([1, 2]), 12), t0_s=scene.time_s + 0.5)
    assert remaining_plan(road, both, 0, later, 4) is None


def coasted(now: Tracks, steps: int) -> Tracks:
    """Return *steps* instants at the last positions."""
    arrays = {name: np.repeat(getattr(now, name)[:, -1:], steps, axis=1) for name in TRACK_ARRAYS[2:]}
    return replace(now, **arrays)


def test_followers_of_the_target_keep_a_gap_unless_they_are_reckless(
    downtown: RoadMap, street: Callable[..., Scene]
) -> None:
    """At 8 m/s 3 m behind the target: 4 m until the next plan, 4.6 m to stop, less 4.2 m, and a metre are 5.4 m."""
    scene = street([*PLACES[:1], (52.4, 0.0)], [8.0] * 2)
    view, lanes = view_and_lanes(downtown, scene)
    speeds = {}
    for name in ("lawful", "careless", "reckless"):
        rules = Rules(name, 0)  # type: ignore[arg-type] # names of licences
        plan = plausible_plan(downtown, view, lanes, proposal(view, 0.0), (None, 0), rules)
        speeds[name] = float(plan.tracks.speed_mps[0, 0])
    assert speeds["reckless"] == 8.0
    assert speeds["lawful"] == speeds["careless"] < 7.0
