"""A vehicle that cuts in brakes on the target's lane, not before, however long it takes to get there."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.licence import LAWFUL, Licence
from advdiff_sumo.traffic.manoeuvres.commitments import Commitment, Commitments
from advdiff_sumo.traffic.manoeuvres.continuation import continue_manoeuvres
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import SpeedProfile
from tests.traffic.manoeuvres.scenes import view_of


@pytest.mark.parametrize(
    ("over_m", "width_m", "licence", "brakes_later"),
    [
        (-0.5, 1.8, LAWFUL, True),
        (0.2, 1.8, LAWFUL, True),
        (0.2, 0.8, LAWFUL, True),
        (0.5, 1.8, LAWFUL, False),
        (0.5, 0.8, LAWFUL, False),
        (0.2, 1.8, None, False),
    ],
)
def test_a_cut_in_brakes_only_after_the_entry_unless_it_is_reckless(
    motorway: RoadMap, over_m: float, width_m: float, licence: Licence | None, brakes_later: bool
) -> None:
    """Its box reaches *over_m* over the line between lanes of 3.5 m; it enters at 0.3 m.

    It should brake now, but drives on until it has entered. It does not move sideways yet. At a mean lateral speed of
    1.1 m/s it has covered 3 x² − 2 x³ of the distance after a share x of the time. At the entry half of both widths
    less 0.3 m are left: 2.35 m for a car, 1.85 m for a motorcycle.
    """
    view = view_of(motorway, time_s=5.0, target=(0, 80.0, 15.0), other=(1, 120.0, 15.0))
    lane = view.target.way.present_lane if view.target is not None else None
    assert lane is not None
    across = 0.5 * (lane.width_m + width_m) - over_m
    beside = lane.line.at(120.0, across)[0] - view.scene.history.xy_m[1, -1]
    view.scene.history.xy_m[1] += beside
    view.scene.history.size_m[1, 1] = width_m
    view = SituationView.of(motorway, view.scene)
    cuts_in = Commitment(
        "cut-in", SpeedProfile(then_mps2=-6.5), 3.0, 4.5, is_positioning=False, goal_lane=lane.id
    )
    memory = Commitments({"cut-in": 1.0}, active={"other": cuts_in})
    going, _ = continue_manoeuvres(view, memory, 8.0, licence)
    assert [m.kind for m in going] == ["cut-in"]
    x = np.linspace(0.0, 1.0, 1001)
    entered = 0.5 * (lane.width_m + width_m) - 0.3
    share = float(np.interp(1.0 - entered / across, 3.0 * x**2 - 2.0 * x**3, x))
    expected = share * across / 1.1 if brakes_later else 0.0
    assert going[0].profile.switch_s == pytest.approx(expected, abs=0.06)  # times are multiples of 0.05 s
    assert np.isclose(going[0].profile.then_mps2, -6.5)


def test_a_cut_in_ends_if_no_braking_could_avoid_it_after_the_entry(motorway: RoadMap) -> None:
    """Both drive at 30 m/s, 26 m apart, a safe gap. The other stops in 53 m, the target in 22.5 and 64 m at 7 m/s²."""
    view = view_of(motorway, time_s=5.0, target=(0, 80.0, 30.0), other=(1, 110.5, 30.0))
    lane = view.target.way.present_lane if view.target is not None else None
    assert lane is not None
    cuts_in = Commitment(
        "cut-in", SpeedProfile(then_mps2=-8.5), 3.0, 4.5, is_positioning=False, goal_lane=lane.id
    )
    memory = Commitments({"cut-in": 1.0}, active={"other": cuts_in})
    assert continue_manoeuvres(view, memory, 8.0, LAWFUL)[0] == []
