"""Episodes made by hand on nets of several kinds, with everything that a format may stumble over."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.export import ExportScene
from advdiff_sumo.maps import RoadMap
from tests.export.drives import DT_S, STEPS, straight, tracks_of
from tests.export.outside import CommonRoadReader, commonroad_reader
from tests.sim import nets


def turning(x: float, y: float) -> FloatArray:
    """Return rows of somebody who drives two circles, so that the heading passes ±π."""
    time = DT_S * np.arange(STEPS)
    yaw = 3.0 + 2.0 * np.pi * time
    rows = np.column_stack((x + 3.0 * np.sin(yaw), y - 3.0 * np.cos(yaw), yaw, np.full(STEPS, 6.0 * np.pi)))
    rows[:, 2] = (rows[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    return rows


def everybody() -> Tracks:
    """Return a target and one of each kind: late, early gone, twice there, there for one instant, oddly named."""
    gap = straight(-40.0, -4.8, 0.0, 5.0)
    gap[8:12] = np.nan
    return tracks_of(
        ("target", AgentClass.CAR, (4.6, 1.8), straight(-30.0, -1.6, 0.0, 8.0)),
        (
            "late & <odd>--name",
            AgentClass.TRUCK,
            (9.5, 2.5),
            straight(1.6, -60.0, 0.5 * np.pi, 9.0, slice(5, None)),
        ),
        ("gone:early", AgentClass.BUS, (12.0, 2.55), straight(60.0, 1.6, np.pi, 7.0, slice(0, 12))),
        ("twice", AgentClass.MOTORCYCLE, (2.2, 0.8), gap),
        ("7", AgentClass.BICYCLE, (1.8, 0.6), straight(-20.0, -6.0, 0.0, 4.0)),
        ("on foot", AgentClass.PEDESTRIAN, (0.5, 0.5), straight(8.0, -10.0, 0.5 * np.pi, 1.3)),
        ("for an instant", AgentClass.CAR, (4.2, 1.7), straight(20.0, -1.6, 0.0, 3.0, slice(10, 11))),
        ("at first only", AgentClass.CAR, (4.3, 1.7), straight(35.0, -1.6, 0.0, 3.0, slice(0, 1))),
        ("back", AgentClass.CAR, (4.4, 1.75), straight(30.0, 1.6, 0.0, -2.0)),
        ("round", AgentClass.CAR, (4.5, 1.8), turning(-80.0, 5.0)),
    )


@pytest.fixture(scope="session")
def crossing_road(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    """A crossing of single lanes at the origin."""
    return RoadMap.read(nets.crossing(tmp_path_factory.mktemp("crossing")))


@pytest.fixture(scope="session")
def busy(crossing_road: RoadMap) -> ExportScene:
    """Everybody on the crossing."""
    return ExportScene("busy-0001", everybody(), 0, crossing_road)


@pytest.fixture(scope="session")
def plain(crossing_road: RoadMap) -> ExportScene:
    """A leader and the target behind it, both there all the time."""
    tracks = tracks_of(
        ("leader", AgentClass.CAR, (5.0, 1.8), straight(-60.0, -1.6, 0.0, 4.0)),
        ("ego", AgentClass.CAR, (5.0, 1.8), straight(-90.0, -1.6, 0.0, 12.0)),
    )
    return ExportScene("plain", tracks, 1, crossing_road)


@pytest.fixture(scope="session")
def on_net() -> Callable[[Path], ExportScene]:
    """Return what makes an episode on any net: two cars one behind the other on its longest lane."""

    def make(net: Path, steps: int = STEPS) -> ExportScene:
        road = RoadMap.read(net)
        lanes = [lane for lane in road.lanes.values() if lane.is_drivable and not lane.is_internal]
        lane = max(lanes, key=lambda one: (one.length_m, one.id))
        agents = []
        for name, start, speed in (("ego", 5.0, 10.0), ("other", 30.0, 5.0)):
            xy, yaw = lane.line.at(start + speed * DT_S * np.arange(steps))
            rows = np.column_stack((xy, yaw, np.full(steps, speed)))
            agents.append((name, AgentClass.CAR, (4.6, 1.8), rows))
        return ExportScene("net", tracks_of(*agents), 0, road)

    return make


@pytest.fixture(scope="session")
def commonroad() -> Iterator[CommonRoadReader]:
    """Return what commonroad-io and commonroad-crime read, or skip."""
    with commonroad_reader() as read:
        yield read
