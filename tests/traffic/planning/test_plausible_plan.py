"""What becomes of a proposal, and how many of its vehicles the safeguard changed."""

from __future__ import annotations

from collections.abc import Callable

import torch

from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.view import View
from advdiff_sumo.traffic.background_plan import Rules, outlook, plausible_plan
from advdiff_sumo.traffic.planning.drawn import Drawn

PLACES = [(60.0, 0.0), (75.0, 0.0), (45.0, 0.0), (90.0, 0.0), (30.0, 0.0)]


def proposal(view: View, aside_m: float) -> Drawn:
    """Return that everybody drives straight on, and the second vehicle *aside_m* to the left of that."""
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
    view, lanes = outlook(downtown, scene)
    counts = {}
    for aside_m in (0.0, 9.0):
        plan = plausible_plan(downtown, view, lanes, proposal(view, aside_m), (None, 0), Rules("reckless", 0))
        counts[aside_m] = plan.safeguarded
        assert set(plan.tracks.ids) == {"v1", "v2", "v3", "v4"}
    assert counts == {0.0: (0, 4), 9.0: (1, 4)}


def test_who_follows_the_target_keeps_back_unless_it_is_reckless(
    downtown: RoadMap, street: Callable[..., Scene]
) -> None:
    """At 8 m/s 3 m behind the target: 4 m until the next plan, 4.6 m to stop, less 4.2 m, and a metre are 5.4 m."""
    scene = street([*PLACES[:1], (52.4, 0.0)], [8.0] * 2)
    view, lanes = outlook(downtown, scene)
    speeds = {}
    for name in ("lawful", "careless", "reckless"):
        rules = Rules(name, 0)  # type: ignore[arg-type] # names of licences
        plan = plausible_plan(downtown, view, lanes, proposal(view, 0.0), (None, 0), rules)
        speeds[name] = float(plan.tracks.speed_mps[0, 0])
    assert speeds["reckless"] == 8.0
    assert speeds["lawful"] == speeds["careless"] < 7.0
