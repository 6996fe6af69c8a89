"""Which links of a signal have green together.

The links that one lamp governs are a group. Groups go together unless ways of theirs cross; a turn under a circular
lamp may have green with oncoming traffic to which it yields (a permitted turn), one under an arrow never. A group
under a light whose ways nothing crosses goes with another group of its road.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from types import MappingProxyType

import numpy as np

from advdiff_sumo.core.signal_letters import PLAIN_RED, PROTECTED_GREEN, YIELDING_GREEN
from advdiff_sumo.maps.convert.narrow import Ends
from advdiff_sumo.maps.convert.signals.signal_links import SignalLink
from advdiff_sumo.maps.convert.sources.source_map import CIRCULAR, Direction, Lamp

SAME_AXIS = 0.7  # cosine of the angle between approaches that may have green together
ACROSS = {
    False: Direction.LEFT,
    True: Direction.RIGHT,
}  # by driving on the left: turns that cross oncoming traffic
LIGHTS = PLAIN_RED, YIELDING_GREEN, PROTECTED_GREEN  # the later, the freer
Stage = frozenset[int]  # links with green


@dataclass(frozen=True, eq=False)
class Group:
    """Links of one road that get green together; *protected* ones under an arrow, in conflict with nobody.

    Where it *follows*, nothing crosses its ways and it is green only while another group of its *road* is.
    """

    links: tuple[SignalLink, ...]
    protected: bool
    road: int = 0
    follows: bool = False

    @property
    def indices(self) -> frozenset[int]:
        """Indices of the links."""
        return frozenset(link.index for link in self.links)


def stages(
    links: Sequence[SignalLink],
    lamps: Mapping[str, Collection[Lamp]],
    apart: Collection[frozenset[Ends]],
    lefthand: bool,
    lights: Mapping[str, frozenset[str]] = MappingProxyType({}),
) -> list[Stage]:
    """Return the links that have green in each stage of a cycle; each link has it in one at least.

    Args:
        links: of the signal.
        lamps: of the approaches, by edge, where the source tells them. Elsewhere a circular lamp is taken, and an
            arrow for the turn across oncoming traffic where lanes are for that turn alone.
        apart: pairs of ways that run so close to each other for so long that none can yield to the other.
        lefthand: whether traffic keeps left.
        lights: names of the lights of the approaches, by edge; edges that share one are one road.
    """
    groups = []
    for number, road in enumerate(_roads(links, lights, apart)):
        edges = {link.origin[0] for link in road}
        told = frozenset[Lamp]().union(*(lamps.get(edge, ()) for edge in edges))
        own = _groups(road, told or _guessed(road, lefthand), number)
        groups += _with_followers(own) if edges & lights.keys() else own
    groups.sort(key=lambda group: group.protected)  # stable: circular lamps first
    return _in_order(_needed(_covered(groups, apart), links))


def _roads(
    links: Sequence[SignalLink],
    lights: Mapping[str, frozenset[str]],
    apart: Collection[frozenset[Ends]],
) -> list[list[SignalLink]]:
    """Return the links of each road: those of an edge, and of edges side by side that share lights."""
    approaches: dict[str, list[SignalLink]] = defaultdict(list)
    for link in links:
        approaches[link.origin[0]].append(link)
    roads: list[list[SignalLink]] = []
    for edge, own in approaches.items():
        joined = own
        for road in list(roads):
            shared = any(
                lights.get(edge, frozenset()) & lights.get(link.origin[0], frozenset()) for link in road
            )
            if shared and not any(_parted(a, b, apart) for a in road for b in joined):
                roads.remove(road)
                joined = road + joined
        roads.append(joined)
    return sorted(roads, key=lambda road: min(link.index for link in road))


def _parted(link: SignalLink, foe: SignalLink, apart: Collection[frozenset[Ends]]) -> bool:
    """Return whether links of two edges can be under no light together: neither could yield to the other."""
    crossing = foe.index in link.foes and _cosine(link, foe) < SAME_AXIS
    return crossing or frozenset((link.ends, foe.ends)) in apart


def _with_followers(groups: Sequence[Group]) -> list[Group]:
    """Return the groups of one road, those in conflict with nobody as followers of the others, if there are any."""
    free = [not any(link.foes for link in group.links) for group in groups]
    return [
        replace(group, follows=is_free and not all(free)) for group, is_free in zip(groups, free, strict=True)
    ]


def _guessed(links: Sequence[SignalLink], lefthand: bool) -> set[Lamp]:
    """Return a circular lamp and, where the turn across oncoming traffic has lanes of its own, an arrow."""
    across = {link.origin for link in links if link.direction is ACROSS[lefthand]}
    others = {link.origin for link in links if link.direction is not ACROSS[lefthand]}
    arrow = Lamp(frozenset({ACROSS[lefthand]}), protected=True)
    return {CIRCULAR, arrow} if across and others and not across & others else {CIRCULAR}


def _groups(links: Sequence[SignalLink], lamps: Collection[Lamp], road: int) -> list[Group]:
    """Return the group of each lamp; links that no lamp governs are under a circular one."""
    arrows = [lamp for lamp in lamps if lamp.protected]
    governed, circular, held = (
        frozenset[Direction]().union(*(lamp.directions for lamp in some))
        for some in (
            lamps,
            (lamp for lamp in lamps if not lamp.protected),
            (lamp for lamp in lamps if lamp.exclusive),
        )
    )
    permitted = (circular - held) | (frozenset(Direction) - governed)
    ordered = sorted(arrows, key=lambda lamp: (len(lamp.directions), sorted(lamp.directions)))
    groups = []
    for lamp in (Lamp(permitted, protected=False), *ordered):
        own = tuple(link for link in links if link.direction in lamp.directions)
        if own:
            groups.append(Group(own, lamp.protected, road))
    return groups


def _covered(groups: Sequence[Group], apart: Collection[frozenset[Ends]]) -> list[Stage]:
    """Return stages of groups that go together, each begun by the first group that has not had green."""
    result: list[Stage] = []
    waiting = sorted(groups, key=attrgetter("follows"))
    while waiting:
        chosen = [waiting[0]]
        others = (*waiting[1:], *(group for group in groups if group not in waiting))
        for group in sorted(others, key=attrgetter("follows")):  # stable
            in_company = not group.follows or any(group.road == other.road for other in chosen)
            if in_company and all(_go_together(group, other, apart) for other in chosen):
                chosen.append(group)
        waiting = [group for group in waiting if group not in chosen]
        result.append(frozenset[int]().union(*(group.indices for group in chosen)))
    return result


def _needed(all_stages: Iterable[Stage], links: Sequence[SignalLink]) -> list[Stage]:
    """Return the stages that let some link go, or go first, which no other one lets."""
    size = max(link.index for link in links) + 1
    states = {stage: state_of(stage, links, size) for stage in all_stages}
    return [
        stage
        for stage, state in states.items()
        if not any(stage != other and _lets_go(states[other], state) for other in states)
    ]


def _lets_go(one: str, other: str) -> bool:
    """Return whether each link goes under the state *one* as it does under *other*, or better."""
    return all(LIGHTS.index(own) >= LIGHTS.index(least) for own, least in zip(one, other, strict=True))


def _in_order(all_stages: Sequence[Stage]) -> list[Stage]:
    """Return the stages so that each is followed by the one that shares most links with it."""
    ordered, rest = list(all_stages[:1]), list(all_stages[1:])
    while rest:
        ordered.append(max(rest, key=lambda stage: len(stage & ordered[-1])))
        rest.remove(ordered[-1])
    return ordered


def _go_together(one: Group, other: Group, apart: Collection[frozenset[Ends]]) -> bool:
    same_road = one.road == other.road
    for link in one.links:
        for foe in other.links:
            if frozenset((link.ends, foe.ends)) in apart:
                return False
            if foe.index in link.foes and not same_road and not _permitted(link, foe, one, other):
                return False
    return True


def _permitted(link: SignalLink, foe: SignalLink, own: Group, others: Group) -> bool:
    """Return whether one of two links in conflict may yield to the other while both have green."""
    if own.protected or others.protected or abs(_cosine(link, foe)) < SAME_AXIS:
        return False
    first, second = (foe, link) if foe.index in link.yields_to else (link, foe)
    if first.index not in second.yields_to:
        return False
    return second.direction is not Direction.STRAIGHT or first.target == second.target


def _cosine(link: SignalLink, foe: SignalLink) -> float:
    """Return the cosine of the angle between two approaches."""
    ways = [line[-1] - line[-2] for line in (link.approach_m, foe.approach_m)]
    return float(ways[0] @ ways[1] / (np.hypot(*ways[0]) * np.hypot(*ways[1])))


def state_of(stage: Stage, links: Sequence[SignalLink], size: int) -> str:
    """Return the state of a program's phase: ``G``, ``g`` for those that yield to others with green, or ``r``."""
    by_index = {link.index: link for link in links}
    letters = [PLAIN_RED] * size
    for index in sorted(stage):
        against = by_index[index].foes & stage
        first = all(index in by_index[foe].yields_to for foe in against)
        protected = first and not against & by_index[index].yields_to
        letters[index] = PROTECTED_GREEN if protected else YIELDING_GREEN
    return "".join(letters)
