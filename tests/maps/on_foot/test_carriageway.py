"""Which lanes of a net make up the carriageway."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest

from advdiff_sumo.maps.on_foot.carriageway import Carriageway


@pytest.mark.parametrize(
    ("permissions", "drives"),
    [
        ("", True),
        ('allow="bus taxi"', True),
        ('allow="bicycle"', True),
        ('disallow="pedestrian tram"', True),
        ('allow="pedestrian"', False),
        ('allow="pedestrian wheelchair scooter container drone"', False),
        ('allow="subway"', False),
        ('disallow="all"', False),
    ],
)
def test_lanes_that_nobody_drives_on_are_none_of_it(permissions: str, drives: bool) -> None:
    lane = f'<lane id="a_0" index="0" speed="10" length="50" width="3" {permissions} shape="0,0 50,0"/>'
    road = Carriageway(ET.fromstring(f'<net><edge id="a" from="x" to="y">{lane}</edge></net>'))  # noqa: S314 - our own
    assert [strip.lane for strip in road.strips] == ["a_0"] * drives
