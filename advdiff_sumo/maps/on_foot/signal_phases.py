"""Green for people on foot in a signal's program, so that nobody who drives straight on has green with them."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass

from advdiff_sumo.core.signal_letters import (
    BLINKING,
    GREEN,
    PLAIN_RED,
    PLAIN_YELLOW,
    PROTECTED_GREEN,
    RED_YELLOW,
    STOP_THEN_YIELD,
    YELLOW,
    YIELDING_GREEN,
)
from advdiff_sumo.maps.signal_times import LONGEST_ALL_RED_S, rounded_up_s, yellow_at_s

WALK_MPS = 1.2  # by which people have cleared the crossing when others get green
WALK_S = 10
_CHANGES = YELLOW | {RED_YELLOW, BLINKING}
_HALTS = frozenset((PLAIN_RED, STOP_THEN_YIELD))


@dataclass(frozen=True)
class SignalledCrossing:
    """A crossing of a signalled junction.

    Attributes:
        index: its link in the program.
        straight: links that lead straight over it.
        turning: links that turn over it, which yield to who walks.
        length_m: from kerb to kerb.
        all_red_s: seconds in which a vehicle that leads over it, and passed its stop line last, has passed it.
    """

    index: int
    straight: frozenset[int]
    turning: frozenset[int]
    length_m: float
    all_red_s: float = 0.0

    @property
    def clearance_s(self) -> int:
        """Seconds that somebody needs who has just set out."""
        return math.ceil(self.length_m / WALK_MPS)


def add_crossings(
    program: ET.Element, crossings: Sequence[SignalledCrossing], approach_mps: float = 0.0
) -> None:
    """Give *crossings* green in *program* where those that lead straight over them are red.

    Turning traffic that has green then yields (``g``). Before others get green, people get red for as long as
    one needs to cross. A crossing that no phase serves gets a phase of its own, with red for all vehicles; where
    these have green just before, with yellow for the fastest of them (*approach_mps*) and all-red between.
    """
    size = max(crossing.index for crossing in crossings) + 1
    phases = program.findall("phase")
    states = [list(phase.get("state", "").ljust(size, PLAIN_RED)) for phase in phases]
    clearing = [_is_clearing(states[number - 1], state) for number, state in enumerate(states)]
    for state, waits in zip(states, clearing, strict=True):
        for crossing in crossings:
            state[crossing.index] = PROTECTED_GREEN if not waits and _may_walk(state, crossing) else PLAIN_RED
        for crossing in crossings:
            if state[crossing.index] == PROTECTED_GREEN:
                for link in crossing.turning:
                    state[link] = YIELDING_GREEN if state[link] == PROTECTED_GREEN else state[link]
    for phase, state in zip(phases, states, strict=True):
        phase.set("state", "".join(state))
    _serve_the_rest(program, crossings, approach_mps)
    _clear(program, crossings)


def _is_clearing(before: Sequence[str], state: Sequence[str]) -> bool:
    """Return whether vehicles that had yellow get clear in a phase, in which nobody goes who had to wait before."""
    greens = [
        {(index, light) for index, light in enumerate(part) if light in GREEN} for part in (before, state)
    ]
    return not YELLOW.isdisjoint(before) and greens[1] <= greens[0]


def _may_walk(state: Sequence[str], crossing: SignalledCrossing) -> bool:
    if any(light in _CHANGES for light in state):
        return False
    return all(state[link] in _HALTS for link in crossing.straight)


def _serve_the_rest(program: ET.Element, crossings: Sequence[SignalledCrossing], approach_mps: float) -> None:
    phases = program.findall("phase")
    rest = [
        c for c in crossings if all(phase.get("state", "")[c.index] != PROTECTED_GREEN for phase in phases)
    ]
    if not rest:
        return
    last = phases[-1].get("state", "")
    if any(light in GREEN for light in last):
        yellow = "".join(PLAIN_YELLOW if light in GREEN else light for light in last)
        for crossing in crossings:
            yellow = yellow[: crossing.index] + PLAIN_RED + yellow[crossing.index + 1 :]
        ET.SubElement(program, "phase", duration=f"{yellow_at_s(approach_mps):g}", state=yellow)
        all_red_s = min(rounded_up_s(max(crossing.all_red_s for crossing in rest)), LONGEST_ALL_RED_S)
        if all_red_s > 0.0:
            ET.SubElement(program, "phase", duration=f"{all_red_s:g}", state=PLAIN_RED * len(last))
    walk = [PLAIN_RED] * len(last)
    for crossing in rest:
        walk[crossing.index] = PROTECTED_GREEN
    ET.SubElement(program, "phase", duration=str(WALK_S), state="".join(walk))


def _change_s(phases: Sequence[ET.Element], number: int) -> float:
    """Return the seconds of yellow in phase *number*, 0 without, and of clearing in the next."""
    now, after = phases[number % len(phases)], phases[(number + 1) % len(phases)]
    if YELLOW.isdisjoint(now.get("state", "")):
        return 0.0
    clearing = _is_clearing(now.get("state", ""), after.get("state", ""))
    return sum(float(phase.get("duration", "0")) for phase in ((now, after) if clearing else (now,)))


def _clear(program: ET.Element, crossings: Sequence[SignalledCrossing]) -> None:
    """Put a phase before each end of people's green in which they have red and the vehicles what they had."""
    phases = program.findall("phase")
    for number, phase in enumerate(phases):
        after = phases[(number + 1) % len(phases)]
        state, following = phase.get("state", ""), after.get("state", "")
        ending = [
            c
            for c in crossings
            if state[c.index] == PROTECTED_GREEN and following[c.index] != PROTECTED_GREEN
        ]
        if not ending:
            continue
        clearance_s = math.ceil(max(c.clearance_s for c in ending) - _change_s(phases, number + 1))
        if clearance_s > 0:
            clear = deepcopy(phase)
            clear.attrib.pop("minDur", None)
            clear.attrib.pop("maxDur", None)
            clear.set("duration", str(clearance_s))
            red = {c.index for c in ending}
            clear.set("state", "".join(PLAIN_RED if n in red else light for n, light in enumerate(state)))
            program.insert(list(program).index(phase) + 1, clear)
