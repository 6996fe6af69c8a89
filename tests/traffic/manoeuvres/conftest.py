"""The maps that the tests of manoeuvres share."""

from __future__ import annotations

from pathlib import Path

import pytest

from advdiff_sumo.maps import RoadMap


@pytest.fixture(scope="session")
def motorway(networks: Path) -> RoadMap:
    """Return the shipped motorway."""
    return RoadMap.read(networks / "motorway.net.xml")


@pytest.fixture(scope="session")
def downtown(networks: Path) -> RoadMap:
    """Return the shipped downtown."""
    return RoadMap.read(networks / "downtown.net.xml")
