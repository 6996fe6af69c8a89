"""Replace netconvert's signal programs of a net by programs with stages for the given lamps.

Yellow and all-red times follow the formulas of :mod:`advdiff_sumo.maps.signal_times`.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import shapely
from shapely.geometry import LineString, Point

from advdiff_sumo.core.signal_letters import GREEN, PLAIN_RED, PLAIN_YELLOW, PROTECTED_GREEN, YIELDING_GREEN
from advdiff_sumo.maps.convert.layout.clear_stretches import BODIES_M
from advdiff_sumo.maps.convert.netplan import Ends, NetPlan
from advdiff_sumo.maps.convert.signals.signal_links import SignalLink, signal_links
from advdiff_sumo.maps.convert.signals.stages import Stage, stages, state_of
from advdiff_sumo.maps.convert.sources.source_map import Direction
from advdiff_sumo.maps.read_net import read_root
from advdiff_sumo.maps.signal_times import LONGEST_ALL_RED_S, clearance_s, rounded_up_s, yellow_at_s

PROGRAM = re.compile(r'[ \t]*<tlLogic id="(?P<id>[^"]*)".*?</tlLogic>\n?', re.DOTALL)
# By a link's present letter, the letters of the next stage with which it starts to go, or to go first.
MAY_START_FROM = {PLAIN_RED: GREEN, YIELDING_GREEN: frozenset((PROTECTED_GREEN,))}
CYCLE_S = 90.0  # intended cycle length
SHORTEST_GREEN_S = 5.0  # shortest green time under SUMO's actuated control
LONGEST_GREEN_S = 50.0  # longest green time under it


@dataclass(frozen=True)
class Phase:
    """A phase of a program; the duration of a *green* one is adapted to traffic."""

    state: str
    duration_s: float
    green: bool


def write_programs(net: Path, plan: NetPlan) -> None:
    """Replace the programs in *net*, which was written from *plan* and has no pedestrian crossings yet."""
    root = read_root(net, "net", "a SUMO net")
    links = signal_links(root, plan)

    def new_program(match: re.Match[str]) -> str:
        program_links = links.get(match["id"], [])
        return program_text(match["id"], phases_of(program_links, plan)) if program_links else match[0]

    net.write_text(PROGRAM.sub(new_program, net.read_text(encoding="utf-8")), encoding="utf-8")


def never_red(net: Path, plan: NetPlan) -> list[str]:
    """Return the lights of *plan* whose links never have red in any phase of the written *net*."""
    root = read_root(net, "net", "a SUMO net")
    states = {
        program.attrib["id"]: [phase.attrib["state"] for phase in program.iterfind("phase")]
        for program in root.iterfind("tlLogic")
    }
    stopped_edges = {
        row.attrib["from"]
        for row in root.iterfind("connection")
        if any(
            state[int(row.attrib["linkIndex"])] == PLAIN_RED for state in states.get(row.get("tl", ""), ())
        )
    }
    all_lights = frozenset[str]().union(*plan.lights.values())
    return sorted(all_lights.difference(*(plan.lights.get(edge, ()) for edge in stopped_edges)))


def phases_of(links: Sequence[SignalLink], plan: NetPlan) -> list[Phase]:
    """Return the phases of one signal: green stages with yellow and all-red between them."""
    size = max(link.index for link in links) + 1
    cycle = stages(links, plan.lamps, plan.long_conflicts, plan.lefthand, plan.lights)
    changes = [
        _change_phases(cycle[k], cycle[(k + 1) % len(cycle)], links, size, plan.long_conflicts)
        for k in range(len(cycle))
    ]
    lost_s = sum(phase.duration_s for change in changes for phase in change)
    green_s = min(max(round((CYCLE_S - lost_s) / len(cycle)), SHORTEST_GREEN_S), LONGEST_GREEN_S)
    return [
        phase
        for stage, change in zip(cycle, changes, strict=True)
        for phase in (Phase(state_of(stage, links, size), green_s, green=True), *change)
    ]


def _change_phases(
    stage: Stage,
    following: Stage,
    links: Sequence[SignalLink],
    size: int,
    long_conflicts: Collection[frozenset[Ends]],
) -> list[Phase]:
    """Return the yellow and all-red phases between two stages; links with green in both keep green."""
    ending = [link for link in links if link.index in stage - following]
    if not ending:
        return []
    state, next_state = (state_of(part, links, size) for part in (stage, following))
    starting = [
        link for link in links if next_state[link.index] in MAY_START_FROM.get(state[link.index], frozenset())
    ]
    ending_indices = {link.index for link in ending}
    yellow, clearing = (
        "".join(letter if index in ending_indices else light for index, light in enumerate(state))
        for letter in (PLAIN_YELLOW, PLAIN_RED)
    )
    phases = [Phase(yellow, yellow_s(ending), green=False)]
    clearance_s = all_red_s(ending, starting, long_conflicts)
    if clearance_s > 0.0:
        phases.append(Phase(clearing, clearance_s, green=False))
    return phases


def program_text(name: str, phases: Sequence[Phase]) -> str:
    """Return the program as XML, indented as netconvert does."""
    program = ET.Element("tlLogic", id=name, type="actuated", programID="0", offset="0")
    for phase in phases:
        row = ET.SubElement(program, "phase", duration=f"{phase.duration_s:g}", state=phase.state)
        if phase.green:
            row.set("minDur", f"{SHORTEST_GREEN_S:g}")
            row.set("maxDur", f"{LONGEST_GREEN_S:g}")
    ET.indent(program, "    ", level=1)
    return "    " + ET.tostring(program, encoding="unicode") + "\n"


def yellow_s(ending: Iterable[SignalLink]) -> float:
    """Return the yellow time in s of links that lose green together: the one for the fastest approach."""
    return yellow_at_s(max(link.approach_mps for link in ending))


def all_red_s(
    ending: Iterable[SignalLink],
    starting: Iterable[SignalLink],
    long_conflicts: Collection[frozenset[Ends]] = (),
) -> float:
    """Return the all-red time in s after which vehicles on *ending* links have left the paths of *starting* ones.

    It is 0 if no links are in conflict, and at most ``LONGEST_ALL_RED_S``. The limit does not hold for links in
    *long_conflicts*, which run along each other over a long distance: these are cleared completely, as a lane that
    serves both directions (MUTCD 2009, section 4H.03).
    """
    starting_links = list(starting)
    times_s = [
        _clearance_s(link, foe)
        if frozenset((link.ends, foe.ends)) in long_conflicts
        else min(_clearance_s(link, foe), LONGEST_ALL_RED_S)
        for link in ending
        for foe in starting_links
        if foe.index in link.foes
    ]
    return rounded_up_s(max(times_s, default=0.0))


def _clearance_s(link: SignalLink, foe: SignalLink) -> float:
    """Return the time in s from the stop line until the rear of a vehicle on *link* has left the path of *foe*."""
    line = LineString(link.line_m)
    shared = line.intersection(LineString(foe.line_m).buffer(BODIES_M))
    if shared.is_empty:
        return 0.0
    last_m = max(line.project(Point(point)) for point in shapely.get_coordinates(shared))
    speed_mps = link.approach_mps if link.direction is Direction.STRAIGHT else link.junction_mps
    return clearance_s(link.stop_offset_m + float(last_m), speed_mps)
