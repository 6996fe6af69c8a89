"""A target that changes lanes, or must, is left room on the lane beside.

Of three lanes the outermost leaves the road, so that a target on it whose route goes straight on must change.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.model_options import FUTURE_STEPS, MODEL_STEP_S
from advdiff_sumo.models.view import look
from advdiff_sumo.traffic.manoeuvres.licensed_attack import licensed_attack
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.target_lane_change import required_side
from advdiff_sumo.traffic.planning.futures import Futures
from tests.sim import nets
from tests.traffic.manoeuvres.scenes import scene_on

EDGES = """<edges>
<edge id="WM" from="W" to="M" numLanes="3" speed="25"/><edge id="ME" from="M" to="E" numLanes="2" speed="25"/>
<edge id="MR" from="M" to="R" speed="20"/>
</edges>"""
THROUGH, OFF = ("WM", "ME"), ("WM", "MR")
TARGET_MPS, OTHER_MPS = 20.0, 12.0


@pytest.fixture(scope="module")
def roads(tmp_path_factory: pytest.TempPathFactory) -> dict[bool, RoadMap]:
    """Return the net for right-hand traffic (False) and its mirror image (True)."""
    return {left: _road(tmp_path_factory.mktemp("exit"), left) for left in (False, True)}


def _road(folder: Path, left: bool) -> RoadMap:
    south = 80 if left else -80
    places = {"W": (0, 0), "M": (200, 0), "E": (400, 0), "R": (380, south)}
    nodes = "".join(f'<node id="{name}" x="{x}" y="{y}"/>' for name, (x, y) in places.items())
    return RoadMap.read(nets.build(folder, f"<nodes>{nodes}</nodes>", EDGES, lefthand=left))


def refused(
    road: RoadMap,
    route: tuple[str, ...],
    lane: int,
    ahead_m: float,
    sideways_m: float,
    target_lane: int = 0,
    drift_mps: float = 0.0,
) -> tuple[int, ...]:
    """Return the refused rows; the other, *ahead_m* of the target, moves *sideways_m* in 2.5 s.

    The target has moved sideways with *drift_mps* since it was on the centre line of its lane, 1 s ago.
    """
    cars = {"target": (target_lane, 110.0, TARGET_MPS), "other": (lane, 110.0 + ahead_m, OTHER_MPS)}
    scene = scene_on({name: (road.lanes[f"WM_{k}"], s, v) for name, (k, s, v) in cars.items()})
    past_s = scene.history.dt_s * np.arange(1 - scene.history.steps, 1)
    shift = np.zeros_like(scene.history.xy_m)
    shift[0, :, 1] = drift_mps * np.maximum(1.0 + past_s, 0.0)
    scene = replace(
        scene, routes=(route, THROUGH), history=replace(scene.history, xy_m=scene.history.xy_m + shift)
    )
    view = look(road, scene, np.zeros(2, dtype=np.bool_))
    time_s = MODEL_STEP_S * np.arange(FUTURE_STEPS + 1)
    xy = scene.history.xy_m[:, -1:] + scene.history.speed_mps[:, -1, None, None] * time_s[:, None] * (
        1.0,
        0.0,
    )
    xy[1, :, 1] += sideways_m * np.minimum(time_s / 2.5, 1.0)
    yaw, speed = np.zeros((2, len(time_s))), np.repeat(scene.history.speed_mps[:, -1:], len(time_s), axis=1)
    plans = Futures(xy, yaw, speed, scene.history.size_m, MODEL_STEP_S)
    return licensed_attack(road, view, plans, ("other",), "lawful", None, 2).refused


@pytest.mark.parametrize("left", [False, True])
def test_a_plan_that_cuts_off_a_target_that_must_change_lanes_is_refused(
    roads: dict[bool, RoadMap], left: bool
) -> None:
    """It is 8 m ahead, 8 m/s slower, and enters the same lane. After 0.75 s a target there would be 2 m behind."""
    moves = 3.2 if left else -3.2
    assert refused(roads[left], THROUGH, 2, 12.5, moves) == (1,)
    assert refused(roads[left], OFF, 2, 12.5, moves) == ()  # the target stays on its lane


@pytest.mark.parametrize(("lane", "ahead_m", "sideways_m"), [(2, 60.0, -3.2), (2, 12.5, 0.0), (1, 12.5, 0.0)])
def test_a_plan_that_leaves_room_or_keeps_its_lane_is_allowed(
    roads: dict[bool, RoadMap], lane: int, ahead_m: float, sideways_m: float
) -> None:
    assert refused(roads[False], THROUGH, lane, ahead_m, sideways_m) == ()


@pytest.mark.parametrize("left", [False, True])
def test_a_plan_that_enters_a_lane_from_the_other_side_than_the_target_is_refused(
    roads: dict[bool, RoadMap], left: bool
) -> None:
    """The target changes from the innermost lane to the middle one, which the other enters from the outermost."""
    side = -1.0 if left else 1.0
    changing, keeping = (
        refused(roads[left], THROUGH, 0, 12.5, 3.2 * side, target_lane=2, drift_mps=-drift * side)
        for drift in (1.0, 0.3)
    )
    assert changing == (1,)
    assert keeping == ()  # it drifts within its lane


def test_a_plan_that_moves_sideways_into_a_target_that_changes_lanes_is_refused(
    roads: dict[bool, RoadMap],
) -> None:
    """They are side by side."""
    assert refused(roads[False], THROUGH, 0, 2.0, 3.2, target_lane=2, drift_mps=-1.0) == (1,)
    assert refused(roads[False], THROUGH, 0, 2.0, 0.0, target_lane=2, drift_mps=-1.0) == ()


@pytest.mark.parametrize("left", [False, True])
@pytest.mark.parametrize(
    ("route", "lane", "outwards"),
    [
        (THROUGH, 0, False),
        (THROUGH, 1, None),
        (THROUGH, 2, None),
        (OFF, 0, None),
        (OFF, 1, True),
        (OFF, 2, True),
    ],
)
def test_the_side_to_which_the_route_makes_the_target_change(
    roads: dict[bool, RoadMap], left: bool, route: tuple[str, ...], lane: int, outwards: bool | None
) -> None:
    """Lane 0 is the outermost: the rightmost of right-hand traffic."""
    road = roads[left]
    scene = scene_on({"target": (road.lanes[f"WM_{lane}"], 110.0, TARGET_MPS)})
    side = required_side(SituationView.of(road, replace(scene, routes=(route,))))
    assert side == (None if outwards is None else "left" if outwards == left else "right")
