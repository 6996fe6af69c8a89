"""Reasons why our safe distance and the monitor's disagree, on values worked by hand."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.export import ExportScene, make_exporter
from advdiff_sumo.maps import RoadMap

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

from check_monitor import ACROSS, CLOSE, OTHER, TOUCHING, obstacles, why_apart


@pytest.mark.parametrize(
    ("spare_m", "gap_m", "why"),
    [
        ([np.nan], [np.nan], ACROSS),
        ([-20.7], [0.1], TOUCHING),
        ([np.nan, -0.4], [np.nan, 12.0], CLOSE),
        ([0.3], [8.0], CLOSE),
        ([-3.0], [6.0], OTHER),
    ],
)
def test_why_two_judges_disagree_on_the_safe_distance(
    spare_m: list[float], gap_m: list[float], why: str
) -> None:
    assert why_apart(np.array(spare_m), np.array(gap_m)) == why


def test_obstacles_have_the_names_of_the_episode(tmp_path: Path, networks: Path) -> None:
    speed, name = np.ones((2, 11)), "f-1/a b%20--é"
    xy = np.stack(([400.0 + np.arange(11), 450.0 + np.arange(11)], 100.0 * speed), axis=-1)
    tracks = Tracks(
        ("ego", name), np.zeros(2, int), 2.0 * np.ones((2, 2)), xy, 0.0 * speed, speed, speed > 0, 0.0, 0.1
    )
    scene = ExportScene("named", tracks, 0, RoadMap.read(networks / "motorway.net.xml"))
    (path,) = make_exporter("commonroad").write(scene, tmp_path)
    assert sorted(obstacles(path).values()) == sorted([name, "target"])
