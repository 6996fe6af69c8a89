"""Who has priority at a crossing of a main road (west–east) and a minor one, worked out by hand."""

from __future__ import annotations

from pathlib import Path

import pytest

from advdiff_sumo.maps import Link, RoadMap, links_over, priority_links
from advdiff_sumo.maps.junction_priority import come_head_on
from tests.sim import nets


@pytest.fixture
def sign(tmp_path: Path) -> RoadMap:
    return RoadMap.read(nets.crossing(tmp_path, "priority"))


@pytest.fixture
def lights(tmp_path: Path) -> RoadMap:
    return RoadMap.read(nets.crossing(tmp_path, "traffic_light"))


def way(road: RoadMap, link: Link) -> str:
    """Return where *link* leads, such as "W>E"."""
    return f"{road.lanes[link.from_lane].edge_id[0]}>{road.lanes[link.to_lane].edge_id[1]}"


def link_of(road: RoadMap, name: str) -> Link:
    return next(link for link in links_over(road, "C") if way(road, link) == name)


def test_all_links_over_a_junction(sign: RoadMap) -> None:
    ways = {way(sign, link) for link in links_over(sign, "C")}
    assert {f"{a}>{b}" for a in "NESW" for b in "NESW" if a != b} <= ways


@pytest.mark.parametrize(
    ("name", "others"),
    [
        ("W>E", set()),  # straight on along the main road
        ("W>N", {"E>W", "E>N"}),  # left, across those from ahead
        ("W>S", set()),
        # into the main road to the right, merging with W>E alone
        ("S>E", {"W>E"}),
        # straight over the main road: all that cross it, but not those that turn right beside it
        ("S>N", {"W>E", "W>N", "E>W", "E>S", "E>N"}),
    ],
)
def test_who_has_priority_by_the_signs(sign: RoadMap, name: str, others: set[str]) -> None:
    """Only those that need not wait themselves count: from the east to the south a left turn waits for W>E."""
    found = {way(sign, link) for link in priority_links(sign, link_of(sign, name), {})}
    waits_itself = {"E>S", "W>N"}
    assert found - waits_itself == others - waits_itself


def test_who_may_go_before_a_red_light(lights: RoadMap) -> None:
    """With green for the main road alone, who would run the light from the south meets the main road."""
    link = link_of(lights, "S>N")
    assert link.tls_id is not None
    letters = ["r"] * 16
    for name in ("W>E", "E>W"):
        index = link_of(lights, name).tls_index
        assert index is not None
        letters[index] = "G"
    found = {way(lights, other) for other in priority_links(lights, link, {link.tls_id: "".join(letters)})}
    assert found == {"W>E", "E>W"}
    assert not priority_links(lights, link, {link.tls_id: "r" * 16})


def test_who_comes_head_on(sign: RoadMap) -> None:
    west, east, south = (link_of(sign, name) for name in ("W>E", "E>S", "S>N"))
    assert come_head_on(sign, west, east)
    assert not come_head_on(sign, west, south)
    assert not come_head_on(sign, west, west)
