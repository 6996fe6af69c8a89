"""Choose which links of a signal have green together.

The links that one lamp controls are a group. Groups may have green together unless their links conflict. A turn under a
circular lamp may have green with oncoming traffic to which it yields (a permitted turn); a turn under an arrow may not.
A group under a light whose links are in no conflict has green together with another group of its road.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from types import MappingProxyType

import numpy as np

from advdiff_sumo.core.signal_letters import PLAIN_RED, PROTECTED_GREEN, YIELDING_GREEN
from advdiff_sumo.maps.convert.netplan import Ends
from advdiff_sumo.maps.convert.signals.signal_links import SignalLink
from advdiff_sumo.maps.convert.sources.source_map import CIRCULAR, Direction, Lamp

SAME_AXIS = 0.7  # smallest |cosine| of the angle between approaches of opposite or equal direction
# The turn that crosses oncoming traffic, by whether traffic keeps left.
ACROSS_ONCOMING = {False: Direction.LEFT, True: Direction.RIGHT}
LIGHTS = PLAIN_RED, YIELDING_GREEN, PROTECTED_GREEN  # ordered from least to most permissive
Stage = frozenset[int]  # indices of the links with green


@dataclass(frozen=True, eq=False)
class Group:
    """Links of one road that always have green together.

    Attributes:
        links: the links.
        protected: whether an arrow controls them, so that no conflicting link may have green with them.
        road: number of the road.
        follows: whether none of its links is in a conflict and it has green only together with another group of its
            road.
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
    long_conflicts: Collection[frozenset[Ends]],
    lefthand: bool,
    lights: Mapping[str, frozenset[str]] = MappingProxyType({}),
) -> list[Stage]:
    """Return the links that have green in each stage of a cycle; each link has green in at least one stage.

    Args:
        links: links of the signal.
        lamps: lamps of the approaches by edge, if the source lists them. Other approaches get a circular lamp, and an
            arrow for the turn across oncoming traffic if it has lanes of its own.
        long_conflicts: pairs of connections that run along each other over such a distance that neither can yield.
        lefthand: whether traffic keeps left.
        lights: names of the lights of the approaches by edge; edges that share a light form one road.
    """
    groups = []
    for number, road in enumerate(_roads(links, lights, long_conflicts)):
        edges = {link.origin[0] for link in road}
        known_lamps = frozenset[Lamp]().union(*(lamps.get(edge, ()) for edge in edges))
        road_groups = _groups(road, known_lamps or _guessed(road, lefthand), number)
        groups += _with_followers(road_groups) if edges & lights.keys() else road_groups
    groups.sort(key=lambda group: group.protected)  # stable; circular lamps first
    return _ordered(_without_redundant(_combine_groups(groups, long_conflicts), links))


def _roads(
    links: Sequence[SignalLink],
    lights: Mapping[str, frozenset[str]],
    long_conflicts: Collection[frozenset[Ends]],
) -> list[list[SignalLink]]:
    """Return the links of each road: those of an edge, or of several edges side by side that share lights."""
    approaches: dict[str, list[SignalLink]] = defaultdict(list)
    for link in links:
        approaches[link.origin[0]].append(link)
    roads: list[list[SignalLink]] = []
    for edge, joined in approaches.items():
        for road in list(roads):
            shared = any(
                lights.get(edge, frozenset()) & lights.get(link.origin[0], frozenset()) for link in road
            )
            if shared and not any(_cannot_share_light(a, b, long_conflicts) for a in road for b in joined):
                roads.remove(road)
                joined = road + joined
        roads.append(joined)
    return sorted(roads, key=lambda road: min(link.index for link in road))


def _cannot_share_light(
    link: SignalLink, foe: SignalLink, long_conflicts: Collection[frozenset[Ends]]
) -> bool:
    """Return whether links of two edges cannot share a light, because neither could yield to the other."""
    crossing = foe.index in link.foes and _cosine(link, foe) < SAME_AXIS
    return crossing or frozenset((link.ends, foe.ends)) in long_conflicts


def _with_followers(groups: Sequence[Group]) -> list[Group]:
    """Return the groups of one road; groups without conflicts become followers of the others, if there are others."""
    has_conflict = [any(link.foes for link in group.links) for group in groups]
    return [
        replace(group, follows=not conflict and any(has_conflict))
        for group, conflict in zip(groups, has_conflict, strict=True)
    ]


def _guessed(links: Sequence[SignalLink], lefthand: bool) -> set[Lamp]:
    """Return a circular lamp and, if the turn across oncoming traffic has lanes of its own, an arrow."""
    turn_lanes = {link.origin for link in links if link.direction is ACROSS_ONCOMING[lefthand]}
    other_lanes = {link.origin for link in links if link.direction is not ACROSS_ONCOMING[lefthand]}
    arrow = Lamp(frozenset({ACROSS_ONCOMING[lefthand]}), protected=True)
    has_own_lanes = turn_lanes and other_lanes and not turn_lanes & other_lanes
    return {CIRCULAR, arrow} if has_own_lanes else {CIRCULAR}


def _groups(links: Sequence[SignalLink], lamps: Collection[Lamp], road: int) -> list[Group]:
    """Return the group of each lamp; links that no lamp controls are added to those of the circular lamp."""
    arrows = [lamp for lamp in lamps if lamp.protected]
    controlled, circular, exclusive = (
        frozenset[Direction]().union(*(lamp.directions for lamp in selected))
        for selected in (
            lamps,
            (lamp for lamp in lamps if not lamp.protected),
            (lamp for lamp in lamps if lamp.exclusive),
        )
    )
    permitted = (circular - exclusive) | (frozenset(Direction) - controlled)
    ordered = sorted(arrows, key=lambda lamp: (len(lamp.directions), sorted(lamp.directions)))
    groups = []
    for lamp in (Lamp(permitted, protected=False), *ordered):
        lamp_links = tuple(link for link in links if link.direction in lamp.directions)
        if lamp_links:
            groups.append(Group(lamp_links, lamp.protected, road))
    return groups


def _combine_groups(groups: Sequence[Group], long_conflicts: Collection[frozenset[Ends]]) -> list[Stage]:
    """Return stages of compatible groups; each stage starts from the first group without green so far."""
    result: list[Stage] = []
    waiting = sorted(groups, key=attrgetter("follows"))
    while waiting:
        chosen = [waiting[0]]
        others = (*waiting[1:], *(group for group in groups if group not in waiting))
        for group in sorted(others, key=attrgetter("follows")):  # stable
            may_join = not group.follows or any(group.road == other.road for other in chosen)
            if may_join and all(_are_compatible(group, other, long_conflicts) for other in chosen):
                chosen.append(group)
        waiting = [group for group in waiting if group not in chosen]
        result.append(frozenset[int]().union(*(group.indices for group in chosen)))
    return result


def _without_redundant(all_stages: Iterable[Stage], links: Sequence[SignalLink]) -> list[Stage]:
    """Return the stages without those of which another stage is at least as permissive for every link."""
    size = max(link.index for link in links) + 1
    states = {stage: state_of(stage, links, size) for stage in all_stages}
    return [
        stage
        for stage, state in states.items()
        if not any(stage != other and _is_as_free(states[other], state) for other in states)
    ]


def _is_as_free(state: str, other: str) -> bool:
    """Return whether each letter of *state* is at least as permissive as that of *other*."""
    return all(LIGHTS.index(own) >= LIGHTS.index(least) for own, least in zip(state, other, strict=True))


def _ordered(all_stages: Sequence[Stage]) -> list[Stage]:
    """Return the stages ordered so that each is followed by the one that shares most links with it."""
    ordered, remaining = list(all_stages[:1]), list(all_stages[1:])
    while remaining:
        ordered.append(max(remaining, key=lambda stage: len(stage & ordered[-1])))
        remaining.remove(ordered[-1])
    return ordered


def _are_compatible(group: Group, other: Group, long_conflicts: Collection[frozenset[Ends]]) -> bool:
    """Return whether two groups may have green together."""
    same_road = group.road == other.road
    for link in group.links:
        for foe in other.links:
            if frozenset((link.ends, foe.ends)) in long_conflicts:
                return False
            if foe.index in link.foes and not same_road and not _permitted(link, foe, group, other):
                return False
    return True


def _permitted(link: SignalLink, foe: SignalLink, group: Group, foe_group: Group) -> bool:
    """Return whether one of two links in conflict may yield to the other while both have green."""
    if group.protected or foe_group.protected or abs(_cosine(link, foe)) < SAME_AXIS:
        return False
    first, second = (foe, link) if foe.index in link.yields_to else (link, foe)
    if first.index not in second.yields_to:
        return False
    return second.direction is not Direction.STRAIGHT or first.target == second.target


def _cosine(link: SignalLink, foe: SignalLink) -> float:
    """Return the cosine of the angle between two approaches."""
    along, foe_along = (line[-1] - line[-2] for line in (link.approach_m, foe.approach_m))
    return float(along @ foe_along / (np.hypot(*along) * np.hypot(*foe_along)))


def state_of(stage: Stage, links: Sequence[SignalLink], size: int) -> str:
    """Return the state of a program's phase: ``G``, ``g`` for links that yield to others with green, or ``r``."""
    by_index = {link.index: link for link in links}
    letters = [PLAIN_RED] * size
    for index in sorted(stage):
        green_foes = by_index[index].foes & stage
        has_priority = all(index in by_index[foe].yields_to for foe in green_foes)
        protected = has_priority and not green_foes & by_index[index].yields_to
        letters[index] = PROTECTED_GREEN if protected else YIELDING_GREEN
    return "".join(letters)
