"""Before an attack the target has driven for some seconds with the attacker in view."""

from __future__ import annotations

from dataclasses import replace

import pytest

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.ordinary_driving import in_view_since, is_due
from advdiff_sumo.traffic.manoeuvres.repertoire import KINDS
from tests.traffic.manoeuvres.scenes import view_of


@pytest.mark.parametrize(
    ("time_s", "since_s", "due"), [(2.5, 0.0, False), (3.0, 0.0, True), (4.5, 2.0, False), (5.0, 2.0, True)]
)
def test_a_stop_is_due_after_three_seconds_in_view(
    motorway: RoadMap, time_s: float, since_s: float, due: bool
) -> None:
    view = view_of(motorway, time_s=time_s, target=(0, 50.0, 10.0), leader=(0, 75.0, 10.0))
    stop = Manoeuvre("hard-stop", 1, view.ways[1])
    assert is_due(view, stop, {"leader": since_s}) is due
    assert is_due(view, replace(stop, sets_up=True), {"leader": since_s})


def test_a_change_of_lanes_may_begin_so_much_earlier_as_it_takes_to_the_line(motorway: RoadMap) -> None:
    """A third of a lane of 3.2 to 3.75 m at 1.1 m/s: over a second."""
    for time_s, due in ((1.5, False), (2.0, True)):
        view = view_of(motorway, time_s=time_s, target=(0, 50.0, 20.0), other=(1, 90.0, 20.0))
        change = next(m for m in KINDS["cut-in"](view, 1) if m.goal is not None)
        assert 1.0 <= change.enters_s(view.scene.history.xy_m[1, -1]) < 1.5
        assert is_due(view, change, {"other": 0.0}) is due


def test_somebody_is_in_view_since_it_came(motorway: RoadMap) -> None:
    view = view_of(motorway, time_s=4.0, target=(0, 50.0, 10.0), leader=(0, 75.0, 10.0))
    assert in_view_since(view, {"target": 0.0, "gone": 1.0}) == {"target": 0.0, "leader": 4.0}
