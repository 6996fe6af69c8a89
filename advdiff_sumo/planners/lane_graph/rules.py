"""Find the right of way at links ahead: signals, stop signs, and links to yield to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

from advdiff_sumo.core.signal_letters import (
    PLAIN_YELLOW,
    PROTECTED_GREEN,
    RED,
    STOP_THEN_YIELD,
    SWITCHED_OFF,
    YELLOW,
)
from advdiff_sumo.maps import Link, RoadMap

_GO = frozenset((PROTECTED_GREEN, SWITCHED_OFF))


class Duty(IntEnum):
    """What a driver must do at a link."""

    GO = 0
    YIELD = 1
    STOP_THEN_YIELD = 2
    CLEAR = 3  # yellow: stop if that is comfortable
    STOP = 4


@dataclass(frozen=True)
class Rule:
    """The duty at one link.

    Attributes:
        duty: what the driver must do.
        yields_to: request indices of the junction's links that have the right of way.
        in_turn: True at an all-way stop: vehicles go in order of arrival.
    """

    duty: Duty
    yields_to: frozenset[int]
    in_turn: bool = False


def rule_at(road: RoadMap, link: Link, signals: Mapping[str, str]) -> Rule:
    """Return what a vehicle that takes *link* must do under *signals*."""
    response = road.yields_to(link)
    letter = link.signal(signals)
    if letter:
        return _signalled(letter, response)
    if link.state == "s":
        return Rule(Duty.STOP_THEN_YIELD, response)
    if link.state == "w":
        return Rule(Duty.STOP_THEN_YIELD, road.foes_of(link), in_turn=True)
    return Rule(Duty.YIELD if response else Duty.GO, response)


def _signalled(letter: str, response: frozenset[int]) -> Rule:
    """Return the rule under signal *letter*; *response* holds the links that the net says to yield to."""
    if letter in RED:
        return Rule(Duty.STOP, frozenset())
    if letter in YELLOW:
        return Rule(Duty.CLEAR, response if letter == PLAIN_YELLOW else frozenset())
    if letter in _GO:
        return Rule(Duty.GO, frozenset())
    if letter == STOP_THEN_YIELD:
        return Rule(Duty.STOP_THEN_YIELD, response)
    return Rule(Duty.YIELD if response else Duty.GO, response)


def may_go(link: Link, signals: Mapping[str, str]) -> bool:
    """Return whether the signal of *link*, if any, lets a vehicle enter the junction now."""
    return link.signal(signals) not in RED | YELLOW
