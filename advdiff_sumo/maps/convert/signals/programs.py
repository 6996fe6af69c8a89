"""Writes the programs of a net's signals in place of netconvert's."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from advdiff_sumo.maps.convert.narrow import Ends
from advdiff_sumo.maps.convert.netplan import NetPlan
from advdiff_sumo.maps.convert.signals.change_intervals import all_red_s, yellow_s
from advdiff_sumo.maps.convert.signals.signal_links import SignalLink, signal_links
from advdiff_sumo.maps.convert.signals.stages import Stage, stages, state_of
from advdiff_sumo.maps.read_net import read_root

PROGRAM = re.compile(r'[ \t]*<tlLogic id="(?P<id>[^"]*)".*?</tlLogic>\n?', re.DOTALL)
RISES_FROM = {"r": "gG", "g": "G"}  # lights with which a link may go where it had to wait before
CYCLE_S = 90.0
SHORTEST_GREEN_S, LONGEST_GREEN_S = 5.0, 50.0  # between which SUMO's actuated control ends a green


@dataclass(frozen=True)
class Phase:
    """A phase of a program; a green one may last shorter or longer as traffic demands."""

    state: str
    duration_s: float
    green: bool


def write_programs(net: Path, plan: NetPlan) -> None:
    """Replace the programs in *net*, which was written from *plan* and has no crossings on foot yet."""
    root = read_root(net, "net", "a SUMO net")
    links = signal_links(root, plan)

    def ours(match: re.Match[str]) -> str:
        own = links.get(match["id"], [])
        return program_text(match["id"], phases_of(own, plan)) if own else match[0]

    net.write_text(PROGRAM.sub(ours, net.read_text(encoding="utf-8")), encoding="utf-8")


def phases_of(links: Sequence[SignalLink], plan: NetPlan) -> list[Phase]:
    """Return the phases of one signal: green stages with yellow and all-red between them."""
    size = max(link.index for link in links) + 1
    cycle = stages(links, plan.lamps, plan.apart, plan.lefthand)
    changes = [
        _change(cycle[k], cycle[(k + 1) % len(cycle)], links, size, plan.apart) for k in range(len(cycle))
    ]
    lost_s = sum(phase.duration_s for change in changes for phase in change)
    green_s = min(max(round((CYCLE_S - lost_s) / len(cycle)), SHORTEST_GREEN_S), LONGEST_GREEN_S)
    return [
        phase
        for stage, change in zip(cycle, changes, strict=True)
        for phase in (Phase(state_of(stage, links, size), green_s, green=True), *change)
    ]


def _change(
    stage: Stage,
    following: Stage,
    links: Sequence[SignalLink],
    size: int,
    apart: Collection[frozenset[Ends]],
) -> list[Phase]:
    """Return yellow and all-red between two stages; links with green in both keep it."""
    ending = [link for link in links if link.index in stage - following]
    if not ending:
        return []
    now, later = (state_of(part, links, size) for part in (stage, following))
    starting = [link for link in links if later[link.index] in RISES_FROM.get(now[link.index], "")]
    lost = {link.index for link in ending}
    yellow, clearing = (
        "".join(letter if index in lost else light for index, light in enumerate(now)) for letter in "yr"
    )
    phases = [Phase(yellow, yellow_s(ending), green=False)]
    clearance_s = all_red_s(ending, starting, apart)
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
