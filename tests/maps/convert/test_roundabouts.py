"""Circulating vehicles have priority in roundabouts, in right-hand and left-hand traffic; blocks are none."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
import sumolib
from defusedxml import ElementTree
from small_maps import MapBuilder, Pose, step

from advdiff_sumo.maps.convert import convert_map
from advdiff_sumo.maps.convert.plain_xml import write_plain_xml
from advdiff_sumo.maps.convert.roundabouts import _turns_evenly

MIDDLE, TURN_M = 200.0, 10.0


class Circle(MapBuilder):
    """A roundabout: lanes "ring0" … round it, "in0" … towards it and "out0" … away from it."""

    def __init__(self, radius_m: float, *, left: bool, arms: int = 4, gap_deg: float = 25.0) -> None:
        """Make a roundabout in which a lane ends *gap_deg* before each arm and the next begins as far after it."""
        super().__init__()
        self.gap_rad, self.arms = math.radians(gap_deg), arms
        self.radius_m, self.side = radius_m, -1.0 if left else 1.0
        for arm in range(arms):
            self._arm(arm)
        for arm in range(arms):
            self.link(
                f"in{arm}", f"enter{arm}", f"ring{arm}", f"leave{(arm + 1) % arms}", f"out{(arm + 1) % arms}"
            )
            self.link(f"ring{arm}", f"on{(arm + 1) % arms}", f"ring{(arm + 1) % arms}")

    def second_entry(self) -> None:
        """Add a second lane that leads into "ring0" along its tangent."""
        first = self._on_ring(self.gap_rad)
        start = turned(step(turned(first), "S", 25.0, 1.0))
        self._place("tangent", start, "S", 25.0, connector=True)
        self._place("second", turned(step(turned(start), "S", 60.0, 1.0)), "S", 60.0)
        self.link("second", "tangent", "ring0")

    def _arm(self, arm: int) -> None:
        at = 2.0 * math.pi * arm / self.arms
        around = (2.0 * math.pi / self.arms - 2.0 * self.gap_rad) * self.radius_m
        self._place(f"ring{arm}", self._on_ring(at + self.gap_rad), "L", around, self.radius_m)
        across = 2.0 * self.gap_rad * self.radius_m
        self._place(f"on{arm}", self._on_ring(at - self.gap_rad), "L", across, self.radius_m, connector=True)
        turn = (0.5 * math.pi - self.gap_rad) * TURN_M
        end = self._place(f"leave{arm}", self._on_ring(at - self.gap_rad), "R", turn, TURN_M, connector=True)
        self._place(f"out{arm}", end, "S", 60.0)
        start = turned(step(turned(self._on_ring(at + self.gap_rad)), "L", turn, TURN_M))
        self._place(f"enter{arm}", start, "R", turn, TURN_M, connector=True)
        self._place(f"in{arm}", turned(step(turned(start), "S", 60.0, 1.0)), "S", 60.0)

    def _on_ring(self, angle: float) -> Pose:
        x, y = MIDDLE + self.radius_m * math.cos(angle), MIDDLE + self.radius_m * math.sin(angle)
        return x, y, angle + 0.5 * math.pi

    def _place(
        self,
        name: str,
        start: Pose,
        letter: str,
        length: float,
        radius: float = 999.0,
        connector: bool = False,
    ) -> Pose:
        """Add a lane, mirrored where traffic keeps left, and return its end before mirroring."""
        x, y, yaw = start
        mirrored = (x, MIDDLE + self.side * (y - MIDDLE), self.side * yaw)
        shown = {"L": "R", "R": "L"}.get(letter, letter) if self.side < 0 else letter
        shape, lengths = ("LSR", [0.0, length, 0.0]) if letter == "S" else (f"{shown}SL", [length, 0.0, 0.0])
        self.lane(name, mirrored, shape, lengths, radius, connector=connector)
        return step(start, letter, length, radius)


def turned(pose: Pose) -> Pose:
    return pose[0], pose[1], pose[2] + math.pi


def first_and_second(net: Any) -> tuple[set[str], set[str]]:
    """Return the source lanes with and without priority at junctions where connections of two lanes meet."""
    first, second = set(), set()
    for node in net.getNodes():
        links = [link for link in node.getConnections() if link.getFrom().getFunction() == ""]
        if len({link.getFrom() for link in links}) > 1:
            for link in links:
                name = link.getFromLane().getParam("source").split(":")[0]
                (first if link.getState() == "M" else second).add(name)
    return first, second


@pytest.mark.parametrize("left", [False, True])
@pytest.mark.parametrize(("arms", "gap_deg"), [(4, 25.0), (4, 38.0), (3, 52.0)])
def test_who_circulates_goes_first(tmp_path: Path, arms: int, gap_deg: float, left: bool) -> None:
    path = Circle(12.0, left=left, arms=arms, gap_deg=gap_deg).write(tmp_path / "m.json")
    result = convert_map(path, tmp_path / "m.net.xml", lefthand=left, guess_signals=True)
    (ring,) = result.plan.rings
    sources = {e.id: e.lanes[0].source.split(":")[0] for e in result.plan.edges}
    order = [sources[edge] for edge in ring.edges]
    at = order.index("ring0")
    assert (order[at:] + order[:at]) == [f"ring{k}" for k in range(arms)]
    assert {e.origin for e in result.plan.edges if e.id in ring.edges} == set(ring.junctions)
    net = sumolib.net.readNet(str(result.net), withInternal=True)
    assert first_and_second(net) == ({f"ring{k}" for k in range(arms)}, {f"in{k}" for k in range(arms)})
    assert {node.getType() for node in net.getNodes()} <= {"priority", "dead_end", "internal"}


@pytest.mark.parametrize("left", [False, True])
def test_an_arm_with_two_entries(tmp_path: Path, left: bool) -> None:
    road = Circle(20.0, left=left)
    road.second_entry()
    result = convert_map(road.write(tmp_path / "m.json"), tmp_path / "m.net.xml", lefthand=left)
    net = sumolib.net.readNet(str(result.net), withInternal=True)
    yielding = {"second", *(f"in{k}" for k in range(4))}
    assert first_and_second(net) == ({f"ring{k}" for k in range(4)}, yielding)


def test_netconvert_is_told(tmp_path: Path) -> None:
    plan = convert_map(Circle(12.0, left=False).write(tmp_path / "m.json"), tmp_path / "m.net.xml").plan
    edges = ElementTree.parse(write_plain_xml(plan, tmp_path, "somewhere", None)["edge-files"])
    (row,) = edges.iter("roundabout")
    (ring,) = plan.rings
    assert tuple(row.attrib["edges"].split()) == ring.edges
    assert tuple(row.attrib["nodes"].split()) == ring.junctions


def test_a_lane_across_the_island_makes_it_none(tmp_path: Path) -> None:
    road = Circle(25.0, left=False)
    road.straight("across", (MIDDLE - 10.0, MIDDLE, 0.0), 20.0)
    result = convert_map(road.write(tmp_path / "m.json"), tmp_path / "m.net.xml")
    assert result.plan.rings == ()


def test_a_circle_too_large_is_none(tmp_path: Path) -> None:
    path = Circle(45.0, left=False).write(tmp_path / "m.json")  # circumference 283 m
    assert convert_map(path, tmp_path / "m.net.xml").plan.rings == ()


def test_only_what_turns_evenly_the_right_way_is_round() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    circle = 15.0 * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    assert _turns_evenly(circle, 1.0)
    assert not _turns_evenly(circle, -1.0)
    assert _turns_evenly(circle[::-1], -1.0)
    assert _turns_evenly(circle * [1.4, 1.0], 1.0)
    block = np.asarray(shapely.box(0.0, 0.0, 40.0, 40.0).buffer(6.0).normalize().reverse().exterior.coords)[
        :-1
    ]
    assert not _turns_evenly(block, 1.0)
    assert not _turns_evenly(block[::-1], 1.0)
