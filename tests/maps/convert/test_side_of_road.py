"""Traffic side of a converted map if the user does not state it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.convert import convert_source
from advdiff_sumo.maps.convert.sources.source_map import SourceLane, SourceMap


def two_streets(side_m: float, location: str = "") -> SourceMap:
    """Return two streets with an eastbound lane each, and a westbound one *side_m* to its left."""
    lanes = []
    for y_m in (0.0, 50.0):
        east = np.array([[0.0, y_m], [100.0, y_m]])
        lanes.append(SourceLane(f"east{y_m:g}", False, east, width_m=3.5))
        west = np.array([[100.0, y_m + side_m], [0.0, y_m + side_m]])
        lanes.append(SourceLane(f"west{y_m:g}", False, west, width_m=3.5))
    return SourceMap(Path("town.osm"), location, tuple(lanes), ())


@pytest.mark.parametrize(
    ("source", "asked", "left", "told"),
    [
        (two_streets(3.5), None, False, False),
        (two_streets(-3.5), None, True, True),
        (two_streets(-3.5), False, False, False),
        (two_streets(-3.5), True, True, False),
        (two_streets(3.5, "singapore-onenorth"), None, True, False),  # the location decides first
    ],
)
def test_by_the_lanes_unless_stated(
    tmp_path: Path, source: SourceMap, asked: bool | None, left: bool, told: bool
) -> None:
    result = convert_source(source, tmp_path / "town.net.xml", lefthand=asked)
    assert RoadMap.read(result.net).lefthand is left
    sentence = "town.osm: traffic keeps left by where its lanes lie; --righthand says that it does not"
    assert result.source.warnings == ((sentence,) if told else ())
