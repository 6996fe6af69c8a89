"""Adds green phases for pedestrians to traffic light programs; vehicles that go straight over them then have red."""

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

WALK_MPS = 1.2  # walking speed for the time until vehicles get green
WALK_S = 10  # length of a phase for pedestrians only
_TRANSITION_LETTERS = YELLOW | {RED_YELLOW, BLINKING}
_STOP_LETTERS = frozenset((PLAIN_RED, STOP_THEN_YIELD))


@dataclass(frozen=True)
class SignalledCrossing:
    """A crossing of a junction with a traffic light.

    Attributes:
        index: its index in the states of the program.
        straight: indices of the links that go straight on over it.
        turning: indices of the links that turn over it; they yield to pedestrians.
        length_m: length from kerb to kerb.
        all_red_s: time that a vehicle needs from its stop line until its rear has passed the crossing.
    """

    index: int
    straight: frozenset[int]
    turning: frozenset[int]
    length_m: float
    all_red_s: float = 0.0

    @property
    def clearance_s(self) -> int:
        """Time that a pedestrian needs to cross, rounded up."""
        return math.ceil(self.length_m / WALK_MPS)


def add_crossings(
    program: ET.Element, crossings: Sequence[SignalledCrossing], approach_mps: float = 0.0
) -> None:
    """Add green for pedestrians on *crossings* to *program*.

    1. A crossing gets green in phases in which the links straight over it have red. Links that turn over it yield (g).
    2. Crossings without green in any phase share a phase at the end of the program with red for all vehicles. If
       vehicles have green just before it, a yellow time for the speed *approach_mps* and all-red are inserted.
    3. After their green, pedestrians have red for as long as they need to cross before vehicles get green.
    """
    size = max(crossing.index for crossing in crossings) + 1
    phases = program.findall("phase")
    states = [list(phase.get("state", "").ljust(size, PLAIN_RED)) for phase in phases]
    clearing = [_is_clearing(states[number - 1], state) for number, state in enumerate(states)]
    for state, is_clearing in zip(states, clearing, strict=True):
        for crossing in crossings:
            is_green = not is_clearing and _is_free(state, crossing)
            state[crossing.index] = PROTECTED_GREEN if is_green else PLAIN_RED
        for crossing in crossings:
            if state[crossing.index] == PROTECTED_GREEN:
                for link in crossing.turning:
                    state[link] = YIELDING_GREEN if state[link] == PROTECTED_GREEN else state[link]
    for phase, state in zip(phases, states, strict=True):
        phase.set("state", "".join(state))
    _add_walk_phase(program, crossings, approach_mps)
    _add_clearance_phases(program, crossings)


def _is_clearing(before: Sequence[str], state: Sequence[str]) -> bool:
    """Return whether *state* only clears the junction: *before* had yellow, and no link gets a new green."""
    greens = [
        {(index, light) for index, light in enumerate(lights) if light in GREEN} for lights in (before, state)
    ]
    return not YELLOW.isdisjoint(before) and greens[1] <= greens[0]


def _is_free(state: Sequence[str], crossing: SignalledCrossing) -> bool:
    """Return whether no light is in transition and the links straight over *crossing* have red."""
    if any(light in _TRANSITION_LETTERS for light in state):
        return False
    return all(state[link] in _STOP_LETTERS for link in crossing.straight)


def _add_walk_phase(program: ET.Element, crossings: Sequence[SignalledCrossing], approach_mps: float) -> None:
    """Append a phase with green for the crossings that have no green so far; see :func:`add_crossings`."""
    phases = program.findall("phase")
    without_green = [
        c for c in crossings if all(phase.get("state", "")[c.index] != PROTECTED_GREEN for phase in phases)
    ]
    if not without_green:
        return
    last = phases[-1].get("state", "")
    if any(light in GREEN for light in last):
        yellow = "".join(PLAIN_YELLOW if light in GREEN else light for light in last)
        for crossing in crossings:
            yellow = yellow[: crossing.index] + PLAIN_RED + yellow[crossing.index + 1 :]
        ET.SubElement(program, "phase", duration=f"{yellow_at_s(approach_mps):g}", state=yellow)
        all_red_s = min(rounded_up_s(max(c.all_red_s for c in without_green)), LONGEST_ALL_RED_S)
        if all_red_s > 0.0:
            ET.SubElement(program, "phase", duration=f"{all_red_s:g}", state=PLAIN_RED * len(last))
    walk = [PLAIN_RED] * len(last)
    for crossing in without_green:
        walk[crossing.index] = PROTECTED_GREEN
    ET.SubElement(program, "phase", duration=str(WALK_S), state="".join(walk))


def _transition_s(phases: Sequence[ET.Element], number: int) -> float:
    """Return the duration of phase *number* and a clearing phase after it; 0 if phase *number* has no yellow."""
    phase, following = phases[number % len(phases)], phases[(number + 1) % len(phases)]
    if YELLOW.isdisjoint(phase.get("state", "")):
        return 0.0
    is_clearing = _is_clearing(phase.get("state", ""), following.get("state", ""))
    return sum(float(p.get("duration", "0")) for p in ((phase, following) if is_clearing else (phase,)))


def _add_clearance_phases(program: ET.Element, crossings: Sequence[SignalledCrossing]) -> None:
    """After each green for pedestrians, insert a phase with red for them in which all other lights are unchanged.

    Together with a transition of the vehicles' lights after it, it lasts as long as a pedestrian needs to cross.
    """
    phases = program.findall("phase")
    for number, phase in enumerate(phases):
        state = phase.get("state", "")
        next_state = phases[(number + 1) % len(phases)].get("state", "")
        ending = [
            c
            for c in crossings
            if state[c.index] == PROTECTED_GREEN and next_state[c.index] != PROTECTED_GREEN
        ]
        if not ending:
            continue
        clearance_s = math.ceil(max(c.clearance_s for c in ending) - _transition_s(phases, number + 1))
        if clearance_s > 0:
            clearance = deepcopy(phase)
            clearance.attrib.pop("minDur", None)
            clearance.attrib.pop("maxDur", None)
            clearance.set("duration", str(clearance_s))
            red = {c.index for c in ending}
            clearance.set("state", "".join(PLAIN_RED if n in red else light for n, light in enumerate(state)))
            program.insert(list(program).index(phase) + 1, clearance)
