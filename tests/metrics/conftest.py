"""A small crossing, and hand-made records of cars on it."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.maps import RoadMap
from tests.metrics import encounters
from tests.metrics.encounters import Car, crossing


@pytest.fixture(scope="session")
def road(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    """The crossing with the street along x having priority."""
    return crossing(tmp_path_factory.mktemp("priority"), "priority")


@pytest.fixture(scope="session")
def light_road(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    """The crossing with traffic lights."""
    return crossing(tmp_path_factory.mktemp("light"), "traffic_light")


@pytest.fixture(scope="session")
def stop_road(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    """The crossing as an all-way stop."""
    return crossing(tmp_path_factory.mktemp("stop"), "allway_stop")


@pytest.fixture(scope="session")
def straight() -> Callable[..., Car]:
    """Return a function that makes cars at constant velocity."""
    return encounters.straight


@pytest.fixture(scope="session")
def record_of() -> Callable[..., EpisodeRecord]:
    """Return a function that makes records; the first car is the target."""
    return encounters.record_of
