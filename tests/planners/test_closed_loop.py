"""The lane-graph planner among SUMO's drivers."""

from __future__ import annotations

from pathlib import Path

import pytest

from advdiff_sumo.core.record import EndReason
from advdiff_sumo.maps import RoadMap

from .harness import drive, outcome, scenes


@pytest.mark.parametrize("net", ["downtown", "downtown-left", "motorway"])
def test_it_is_never_at_fault_in_natural_traffic(networks: Path, net: str) -> None:
    road = RoadMap.read(networks / f"{net}.net.xml")
    start = next(scenes(road, 7, 1, 15.0))
    record, timing = drive(road, start, "lane_graph", 12.0)
    found = outcome(record, timing, road)
    assert not found.at_fault, found
    assert record.end is not EndReason.FAILED, found
    assert found.brake_mps2 < 9.0
    assert found.lateral_mps2 < 6.0


def test_the_same_seed_gives_the_same_drive(networks: Path) -> None:
    road = RoadMap.read(networks / "downtown.net.xml")
    start = next(scenes(road, 8, 1, 8.0))
    first, again = (drive(road, start, "lane_graph", 6.0)[0].tracks for _ in range(2))
    assert first.ids == again.ids
    assert first.xy_m.tobytes() == again.xy_m.tobytes()
