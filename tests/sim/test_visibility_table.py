"""What a SUMO-driven target sees of a vehicle that moveToXY holds, and what ``visible_ids`` returns."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.boxes import corners, overlap
from advdiff_sumo.sim.sumo_perception import visible_ids
from tests.sim.nets import EAST, LENGTH_M, NORTH, WEST, WIDTH_M, Stage, stage

SOUTH = -NORTH
EASTBOUND = ("WM", "ME")
SIZE_M = np.array((LENGTH_M, WIDTH_M))
SUBLANES = {"lane model": 0.0, "sublanes": 0.4}
REACTION_MPS = 1.0  # below its cruise of 13 to 14 m/s


@dataclass(frozen=True)
class Seen:
    """What one target did and saw while it approached the background vehicle."""

    hit_mps: float | None
    slowest_mps: float
    leader: bool
    visible: bool

    @property
    def reacted(self) -> bool:
        return self.slowest_mps < 13.0 - REACTION_MPS


def drive(s: Stage, x: float, y: float, yaw: float, speed_mps: float = 0.0) -> Seen:
    """Let a target at 13 m/s in the right lane, which may not change lane, meet a background vehicle."""
    s.add("b", EASTBOUND, lane=1, at=100)
    s.hold("b", x, y, yaw)
    s.step()
    s.add("t", EASTBOUND, at=10, speed=13)
    s.api.vehicle.setLaneChangeMode("t", 0)
    hit, slowest, leader, visible = None, np.inf, False, False
    for _ in range(250):
        x += 0.1 * speed_mps * np.cos(yaw)
        s.hold("b", x, y, yaw)
        s.step()
        if "t" not in s.api.vehicle.getIDList():
            break
        where, heading = s.pose("t")
        pace = s.api.vehicle.getSpeed("t")
        boxes = (corners(xy, np.asarray(a), SIZE_M) for xy, a in ((where, heading), (np.array((x, y)), yaw)))
        if hit is None and overlap(*boxes):
            hit = pace
        if hit is None:  # before
            slowest = min(slowest, pace)
            visible |= "b" in visible_ids(s.api, "t")
            leader |= (s.api.vehicle.getLeader("t", 100.0) or ("",))[0] == "b"
    return Seen(hit, slowest, leader, visible)


@pytest.mark.parametrize("sublane_m", SUBLANES.values(), ids=SUBLANES)
def test_centred_in_its_lane_it_stops(street: Path, sublane_m: float) -> None:
    with stage(street, sublane_m=sublane_m) as s:
        seen = drive(s, 150, -4.8, EAST)
    assert seen.hit_mps is None
    assert seen.slowest_mps < 0.01
    assert seen.leader
    assert seen.visible


@pytest.mark.parametrize("sublane_m", SUBLANES.values(), ids=SUBLANES)
def test_straddling_from_the_next_lane_it_drives_through(street: Path, sublane_m: float) -> None:
    """Sublanes do not help: a moved vehicle is a leader only in the lane of its own front."""
    with stage(street, sublane_m=sublane_m) as s:
        seen = drive(s, 150, -3.15, EAST)
    assert seen.hit_mps is not None
    assert seen.hit_mps > 13.0
    assert not seen.reacted
    assert not seen.leader
    assert seen.visible  # as a neighbour, which its models consider when they change lane


@pytest.mark.parametrize("sublane_m", SUBLANES.values(), ids=SUBLANES)
def test_straddling_with_the_front_in_its_lane_it_stops(street: Path, sublane_m: float) -> None:
    with stage(street, sublane_m=sublane_m) as s:
        seen = drive(s, 150, -3.25, EAST)
    assert seen.hit_mps is None
    assert seen.slowest_mps < 0.01
    assert seen.leader
    assert seen.visible


@pytest.mark.parametrize("sublane_m", SUBLANES.values(), ids=SUBLANES)
def test_blocking_across_with_the_front_in_the_next_lane_it_drives_through(
    street: Path, sublane_m: float
) -> None:
    with stage(street, sublane_m=sublane_m) as s:
        seen = drive(s, 150, -4.0, NORTH)
    assert seen.hit_mps is not None
    assert seen.hit_mps > 13.0
    assert not seen.leader
    assert seen.visible


@pytest.mark.parametrize("sublane_m", SUBLANES.values(), ids=SUBLANES)
def test_blocking_across_with_the_front_off_the_road_it_drives_through_and_sees_nothing(
    street: Path, sublane_m: float
) -> None:
    with stage(street, sublane_m=sublane_m) as s:
        seen = drive(s, 150, -5.5, SOUTH)
    assert seen.hit_mps is not None
    assert seen.hit_mps > 13.0
    assert not seen.reacted
    assert not seen.leader
    assert not seen.visible


def test_head_on_it_brakes_to_a_stop_and_is_hit(street: Path) -> None:
    for sublane_m in SUBLANES.values():
        with stage(street, sublane_m=sublane_m) as s:
            seen = drive(s, 250, -4.8, WEST, speed_mps=8.0)
        assert seen.hit_mps is not None
        assert seen.hit_mps < 1.0, "it had braked almost to a stop"
        assert seen.leader
        assert seen.visible


def test_a_target_that_may_change_lane_dodges(street: Path) -> None:
    with stage(street) as s:
        s.add("b", EASTBOUND, at=100)
        s.hold("b", 150, -4.8, EAST)
        s.add("t", EASTBOUND, at=10, speed=13)
        lanes = []
        for _ in range(130):
            s.step()
            lanes.append(s.api.vehicle.getLaneID("t"))
            assert "b" in visible_ids(s.api, "t") or s.pose("t")[0][0] > 150
    assert lanes[0] == "WM_0"
    assert "WM_1" in lanes
