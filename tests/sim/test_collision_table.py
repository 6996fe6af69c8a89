"""What SUMO's own collision list reports about pairs of moved vehicles, and what is true (docs/sumo.md)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.boxes import corners, overlap
from advdiff_sumo.metrics.target_contact import standing_overlaps, target_contact
from advdiff_sumo.sim.world import Frame, World, read, register
from tests.sim.nets import EAST, NORTH, WEST, Stage, stage

EASTBOUND, WESTBOUND = ("WM", "ME"), ("EM", "MW")
MAJOR, MINOR = ("WC", "CE"), ("SC", "CN")
Pose = tuple[float, float, float]

MINGAP = "--collision.mingap-factor"
SETTINGS: dict[str, tuple[float, dict[str, object]]] = {
    "teleport": (0.0, {"--collision.action": None, "--collision.check-junctions": None, MINGAP: None}),
    "warn": (0.0, {MINGAP: None}),
    "sublanes": (0.4, {MINGAP: None}),
    "ours": (0.4, {}),
}


@dataclass(frozen=True)
class Row:
    """One row of the table: two vehicles, whether their boxes overlap, and SUMO's report in each setting."""

    net: str
    a: Pose
    b: Pose
    overlaps: bool
    said: tuple[str, str, str, str]  # in the order of SETTINGS; "" if SUMO reports nothing
    ways: tuple[tuple[str, ...], tuple[str, ...]] = (EASTBOUND, EASTBOUND)
    lanes: tuple[int, int] = (0, 0)
    kind: str = "car"


SEEN, SEEN_J, UNSEEN = ("", *["collision"] * 3), ("", *["junction"] * 3), ("",) * 4
TABLE = {
    "same lane, 3 m": Row("street", (100, -4.8, EAST), (102, -4.8, EAST), True, SEEN),
    "one centred, one straddles, both centres in one lane": Row(
        "street", (100, -4.8, EAST), (101, -3.6, EAST), True, SEEN
    ),
    "neighbouring lanes, bodies overlap by 0.6 m": Row(
        "street", (100, -3.8, EAST), (101, -2.6, EAST), True, UNSEEN, lanes=(0, 1)
    ),
    "centred and straddling from the next lane": Row(
        "street", (100, -4.8, EAST), (101, -3.15, EAST), True, UNSEEN, lanes=(0, 1)
    ),
    "crossing on a junction": Row(
        "crossing", (0, -1.6, EAST), (1.6, -1, NORTH), True, SEEN_J, (MAJOR, MINOR)
    ),
    "crossing, unregulated": Row(
        "unregulated", (0, -1.6, EAST), (1.6, -1, NORTH), True, UNSEEN, (MAJOR, MINOR)
    ),
    "straddling into the oncoming lane": Row(
        "street", (100, -0.5, EAST), (102, 1.0, WEST), True, UNSEEN, (EASTBOUND, WESTBOUND), (1, 1)
    ),
    "one off the road": Row("street", (100, -6.0, EAST), (101, -7.6, EAST), True, UNSEEN),
    "both off the road": Row("street", (100, -20, EAST), (101, -20, EAST), True, UNSEEN),
    "blocked by a perpendicular vehicle with its front in the next lane": Row(
        "street", (100, -4.8, EAST), (103, -4.0, NORTH), True, UNSEEN
    ),
    "false alarm: perpendicular, 3.6 m away": Row(
        "street", (100, -4.8, EAST), (107, -5.8, NORTH), False, SEEN
    ),
    "false alarm: 1 m bumper gap, Krauss": Row(
        "street", (100, -4.8, EAST), (106, -4.8, EAST), False, ("", "collision", "collision", ""), kind="krauss"
    ),
    "1 m bumper gap, IDM": Row("street", (100, -4.8, EAST), (106, -4.8, EAST), False, UNSEEN),
    "false alarm: 0.2 m bumper gap, IDM": Row(
        "street", (100, -4.8, EAST), (105.2, -4.8, EAST), False, ("", "collision", "collision", "")
    ),
}  # fmt: skip
SIZE_M = np.array((5.0, 1.8))


def put_in_place(s: Stage, row: Row) -> World:
    """Insert both; then b is moved to its pose from 9 m aside, which SUMO accepts, and a stays."""
    s.add("a", row.ways[0], lane=row.lanes[0], at=20, kind=row.kind)
    s.add("b", row.ways[1], lane=row.lanes[1], at=60, kind=row.kind)
    world = World()
    register(world, s.api, ["a", "b"])
    s.hold("a", *row.a)
    s.hold("b", *row.b)
    return world


def states(s: Stage, world: World) -> Frame:
    """Return what the package reads from SUMO."""
    gone = read(world, s.api, np.zeros(0, dtype=np.int64))
    assert not gone.size
    return world.frame()


@pytest.mark.parametrize("setting", SETTINGS)
@pytest.mark.parametrize("name", TABLE)
def test_what_sumo_says(name: str, setting: str, request: pytest.FixtureRequest) -> None:
    row, (sublane_m, otherwise) = TABLE[name], SETTINGS[setting]
    expected = row.said[list(SETTINGS).index(setting)]
    with stage(request.getfixturevalue(row.net), sublane_m=sublane_m, otherwise=otherwise) as s:
        put_in_place(s, row)
        s.step()  # SUMO checks a junction only from the step after the placement on
        said = []
        for _ in range(5):
            s.step()
            said.append(s.reported().get(frozenset("ab"), ""))
    assert said == [expected] * 5  # a lasting contact is reported at every step


@pytest.mark.parametrize("name", TABLE)
def test_our_boxes_tell_the_truth(name: str, request: pytest.FixtureRequest) -> None:
    row = TABLE[name]
    with stage(request.getfixturevalue(row.net)) as s:
        world = put_in_place(s, row)
        for _ in range(2):
            s.step()
        now = states(s, world)
    for k, pose in enumerate((row.a, row.b)):  # SUMO has them at their poses, on the road and off it
        np.testing.assert_allclose(now.xy_m[k], pose[:2], atol=1e-6)
        np.testing.assert_allclose(now.yaw_rad[k], pose[2], atol=1e-6)
    boxes = corners(now.xy_m, now.yaw_rad, world.size_m[:2])
    assert bool(overlap(boxes[0], boxes[1])) is row.overlaps
    at_once = standing_overlaps(None, now.xy_m, now.xy_m, now.yaw_rad, world.size_m[:2], 0)
    assert at_once.tolist() == [False, row.overlaps]


@pytest.mark.parametrize("name", TABLE)
def test_our_swept_contact_tells_the_truth(name: str, request: pytest.FixtureRequest) -> None:
    row = TABLE[name]
    aside = np.array((0.0, 9.0 if row.b[1] >= row.a[1] else -9.0))
    with stage(request.getfixturevalue(row.net)) as s:
        world = put_in_place(s, row)
        s.held["b"] = np.array(row.b[:2]) + aside, row.b[2]
        for _ in range(2):
            s.step()
        before = states(s, world)
        s.hold("b", *row.b)
        s.step()
        now = states(s, world)
    apart = target_contact(before.xy_m, before.yaw_rad, before.xy_m, before.yaw_rad, world.size_m[:2], 0)
    contact = target_contact(before.xy_m, before.yaw_rad, now.xy_m, now.yaw_rad, world.size_m[:2], 0)
    assert apart is None
    assert (contact is not None) is row.overlaps
    if contact is not None:
        assert contact.row == 1
        assert 0.0 < contact.fraction < 1.0


def test_the_default_action_takes_vehicles_off_the_junction(crossing: Path) -> None:
    row = TABLE["crossing on a junction"]
    with stage(crossing, sublane_m=0.0, otherwise={"--collision.action": None}) as s:
        put_in_place(s, row)
        s.step()
        s.step()
        assert s.reported() == {frozenset("ab"): "junction"}
        assert s.api.simulation.getStartingTeleportIDList() == ("a", "b")


def test_action_none_switches_the_list_off(street: Path) -> None:
    with stage(street, otherwise={"--collision.action": "none"}) as s:
        put_in_place(s, TABLE["same lane, 3 m"])
        for _ in range(5):
            s.step()
            assert s.reported() == {}
