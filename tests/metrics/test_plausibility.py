"""Implausible motion worked by hand: one car per kind, on a road that is wide enough for all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.record import Controller, EndReason, EpisodeRecord
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.plausibility import Implausibility, implausibilities

STEPS, DT = 51, 0.1
TIME = DT * np.arange(STEPS)


@pytest.fixture(scope="module")
def road(networks: Path) -> RoadMap:
    return RoadMap.read(networks / "downtown.net.xml")


def found(
    road: RoadMap,
    speed: list[np.ndarray],
    left: list[np.ndarray | float],
    begin: list[float],
    policy: bool = True,
) -> list[Implausibility]:
    """Return the implausible motions of cars that drive along the longest lane; the first car is the target."""
    lane = max(
        (x for x in road.lanes.values() if not x.is_internal and x.permits("passenger")),
        key=lambda x: (x.length_m, x.id),
    )
    pace = np.array([np.broadcast_to(v, STEPS) for v in speed], dtype=np.float64)
    s = np.array(begin)[:, None] + np.cumsum(pace, axis=1) * DT
    offset = np.array([np.broadcast_to(v, STEPS) for v in left], dtype=np.float64)
    xy, yaw = lane.line.at(s, offset, extrapolate=True)
    count = len(pace)
    tracks = Tracks(
        ids=tuple("tabcd"[:count]),
        classes=np.zeros(count, dtype=np.int64),
        size_m=np.tile([4.0, 2.0], (count, 1)),
        xy_m=xy,
        yaw_rad=yaw,
        speed_mps=pace,
        valid=np.ones((count, STEPS), dtype=np.bool_),
        t0_s=0.0,
        dt_s=DT,
    )
    who = np.full((count, STEPS), Controller.POLICY if policy else Controller.SUMO, dtype=np.int64)
    who[0] = Controller.PLANNER
    return implausibilities(EpisodeRecord(0, 0, "", tracks, 0, who, (), EndReason.HORIZON), road)


def test_ordinary_driving(road: RoadMap) -> None:
    assert found(road, [5.0, 5.0 + 2.0 * TIME, 10.0 - 2.0 * TIME], [0.0, 0.0, 0.0], [5.0, 20.0, 60.0]) == []


def test_too_strong_an_acceleration_and_braking(road: RoadMap) -> None:
    """6 m/s² where 4 m/s² are possible, and 12 m/s² where 9 m/s² are."""
    hard = np.maximum(20.0 - 12.0 * TIME, 0.0)
    what = found(road, [0.0, 2.0 + 6.0 * TIME, hard], [0.0, 0.0, 0.0], [0.0, 20.0, -60.0])
    told = {(x.vehicle, x.what): x.value for x in what}
    assert told["a", "acceleration"] == pytest.approx(6.0, abs=0.01)
    assert told["b", "braking"] == pytest.approx(12.0, abs=0.1)
    assert ("a", "braking") not in told


def test_a_contact_and_a_drive_through(road: RoadMap) -> None:
    """At 10 m/s into a standing car 20 m ahead, after 16 m, 1.6 s; it continues through it."""
    (hit,) = found(road, [0.0, 10.0, 0.0], [0.0, 0.0, 0.0], [-50.0, 10.0, 30.0])
    assert (hit.vehicle, hit.what, hit.other) == ("a", "drove through", "b")
    assert hit.time_s == pytest.approx(1.5, abs=0.11)
    assert hit.value == pytest.approx(2.0, abs=0.3)  # across is the shortest way out


def test_contacts_with_the_target_do_not_count(road: RoadMap) -> None:
    assert found(road, [0.0, 10.0], [0.0, 0.0], [30.0, 10.0]) == []


def test_off_the_road(road: RoadMap) -> None:
    away = np.maximum(TIME - 1.0, 0.0) * -8.0
    what = [x for x in found(road, [0.0, 8.0], [0.0, away], [-60.0, 20.0]) if x.what == "off the road"]
    assert [x.vehicle for x in what] == ["a"]
    assert what[0].value == pytest.approx(100.0)


def test_vehicles_driven_by_sumo_do_not_count(road: RoadMap) -> None:
    assert found(road, [0.0, 2.0 + 6.0 * TIME], [0.0, 0.0], [-60.0, 20.0], policy=False) == []
