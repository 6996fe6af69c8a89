"""Phases with people on foot, worked by hand."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest

from advdiff_sumo.maps.on_foot.signal_phases import SignalledCrossing, add_crossings


def program(*phases: tuple[int, str]) -> ET.Element:
    root = ET.Element("tlLogic", id="j")
    for duration, state in phases:
        ET.SubElement(root, "phase", duration=str(duration), state=state, minDur="5", maxDur="50")
    return root


def phases(root: ET.Element) -> list[tuple[int, str, bool]]:
    """Return duration, state and whether the duration may vary."""
    return [(int(p.get("duration", "")), p.get("state", ""), "minDur" in p.attrib) for p in root]


def test_green_while_those_straight_over_it_are_red() -> None:
    """Links 0: straight over; 1: turns over it; 2: elsewhere. 9 m take 8 s, of which the yellow is 3."""
    root = program((30, "GrrG"[:3]), (3, "yrr"), (30, "rGG"), (3, "ryy"))
    add_crossings(root, [SignalledCrossing(3, frozenset({0}), frozenset({1}), 9.0)])
    assert phases(root) == [
        (30, "Grrr", True),
        (3, "yrrr", True),
        (30, "rgGG", True),  # who turns yields to who walks
        (5, "rgGr", False),
        (3, "ryyr", True),
    ]


def test_nobody_sets_out_while_vehicles_get_clear() -> None:
    """9 m take 8 s, of which the yellow is 4 and the all-red 2."""
    root = program((30, "Gr"), (4, "yr"), (2, "rr"), (30, "rG"), (4, "ry"), (2, "rr"))
    add_crossings(root, [SignalledCrossing(2, frozenset({0}), frozenset(), 9.0)])
    assert [(seconds, state) for seconds, state, _ in phases(root)] == [
        (30, "Grr"),
        (4, "yrr"),
        (2, "rrr"),
        (30, "rGG"),
        (2, "rGr"),
        (4, "ryr"),
        (2, "rrr"),
    ]


def test_people_walk_while_a_turn_that_yielded_goes_first() -> None:
    """After the yellow of link 0 the turn 1 has ``G``: that is a stage, no clearing."""
    root = program((30, "Gg"), (4, "yg"), (10, "rG"), (4, "ry"))
    add_crossings(root, [SignalledCrossing(2, frozenset({0}), frozenset({1}), 2.4)])
    assert [state for _, state, _ in phases(root)] == ["Ggr", "ygr", "rgG", "ryr"]


def test_a_short_crossing_is_clear_when_the_yellow_ends() -> None:
    root = program((30, "Gr"), (3, "yr"), (30, "rG"), (3, "ry"))
    add_crossings(root, [SignalledCrossing(2, frozenset({0}), frozenset(), 3.6)])
    assert phases(root)[2:] == [(30, "rGG", True), (3, "ryr", True)]


def test_a_crossing_that_no_phase_serves_gets_its_own() -> None:
    """Both phases lead straight over it: 10 s for people, then 10 s to clear 12 m, with red for all."""
    root = program((30, "Gr"), (3, "yr"), (30, "rG"), (3, "ry"))
    add_crossings(root, [SignalledCrossing(2, frozenset({0, 1}), frozenset(), 12.0)])
    assert phases(root)[:4] == [(30, "Grr", True), (3, "yrr", True), (30, "rGr", True), (3, "ryr", True)]
    assert phases(root)[4:] == [(10, "rrG", False), (10, "rrr", False)]


def test_a_program_without_yellow_gets_some_before_the_phase_of_their_own() -> None:
    root = program((30, "Gg"))
    add_crossings(root, [SignalledCrossing(2, frozenset({0, 1}), frozenset(), 1.0)])
    assert phases(root) == [(30, "Ggr", True), (3, "yyr", False), (10, "rrG", False), (1, "rrr", False)]


@pytest.mark.parametrize(
    ("approach_mps", "passed_s", "yellow", "all_red"),
    [(8.0, 2.5, "3", "2.5"), (13.89, 2.6, "3.5", "3"), (25.0, 3.01, "5.5", "3.5"), (40.0, 9.0, "6", "6")],
)
def test_vehicles_that_had_green_last_get_clear_before_people_walk(
    approach_mps: float, passed_s: float, yellow: str, all_red: str
) -> None:
    """Yellow of 1 s + v / 6.096 m/s²: 2.31, 3.28, 5.10 and 7.56 s. All-red is that of the crossing passed last."""
    root = program((50, "GG"))
    served = SignalledCrossing(2, frozenset({0}), frozenset(), 12.0, 1.0)
    add_crossings(
        root, [served, SignalledCrossing(3, frozenset({1}), frozenset(), 9.0, passed_s)], approach_mps
    )
    assert [(phase.get("duration"), phase.get("state")) for phase in root] == [
        ("50", "GGrr"),
        (yellow, "yyrr"),
        (all_red, "rrrr"),
        ("10", "rrGG"),
        ("10", "rrrr"),
    ]
