"""Features of encounters, worked by hand on the motorway."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.manoeuvres.encounter_features import (
    CIRCUMSTANCES,
    FEATURES,
    encounter_features,
    with_vehicle,
)
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.repertoire import KINDS
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import SpeedProfile
from tests.traffic.manoeuvres.scenes import view_of


def of(features: FloatArray, name: str) -> float:
    return float(features[FEATURES.index(name)])


def with_class(view: SituationView, row: int, agent_class: AgentClass) -> SituationView:
    classes = view.scene.history.classes.copy()
    classes[row] = agent_class
    history = replace(view.scene.history, classes=classes)
    return SituationView(view.road, replace(view.scene, history=history), view.ways)


def test_a_lorry_that_stops_ahead(motorway: RoadMap) -> None:
    """The target drives at 15 m/s. A lorry at 12 m/s, 45 m ahead in a slight bend, brakes at 6 m/s²; 4 are required."""
    view = view_of(motorway, target=(0, 50.0, 15.0), lorry=(0, 95.0, 12.0))
    view = with_class(view, 1, AgentClass.TRUCK)
    stop = Manoeuvre("hard-stop", 1, view.ways[1], SpeedProfile(then_mps2=-6.0))
    (x,) = encounter_features(view, [stop], np.array([4.0]))
    assert [name for name, flag in zip(KINDS, x, strict=False) if flag] == ["hard-stop"]
    wanted = {"needed_braking": -0.2, "target_speed": 1.0, "closing_speed": 0.3, "distance": 0.5}
    wanted |= {"brakes": 0.75, "heavy": 1.0}
    for name in CIRCUMSTANCES:
        assert of(x, name) == pytest.approx(wanted.get(name, 0.0), abs=0.01), name


def test_bearing_of_a_vehicle_beside_and_insufficient_braking(motorway: RoadMap) -> None:
    """On the left lane, 10 m ahead, the sine of the bearing is the lane width over the distance. 99 counts as 7."""
    view = view_of(motorway, target=(0, 50.0, 10.0), other=(1, 60.0, 10.0))
    width = motorway.lanes[view.ways[1].present_lane.id].width_m
    stop = Manoeuvre("cut-in", 1, view.ways[1])
    (x,) = encounter_features(view, [stop], np.array([99.0]))
    assert of(x, "aside") == pytest.approx(width / np.hypot(width, 10.0), abs=0.02)
    assert of(x, "needed_braking") == pytest.approx(0.4)


def test_features_are_those_of_the_revealed_vehicle(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, 10.0), leader=(0, 70.0, 10.0), stands=(0, 100.0, 0.0))
    revealing = Manoeuvre("cut-out", 1, view.ways[1], revealed_row=2)
    (x,) = encounter_features(view, [revealing], np.array([3.0]))
    assert of(x, "stands") == 1.0
    assert of(x, "distance") == pytest.approx(50.0 / 30.0 - 1.0, abs=1e-3)


def test_features_with_another_vehicle() -> None:
    typical = np.zeros((2, len(FEATURES)))
    lorry = with_vehicle(typical, AgentClass.BUS, oncoming=True)
    assert {name for name in FEATURES if of(lorry[0], name)} == {"heavy", "oncoming"}
    assert {name for name in FEATURES if of(with_vehicle(lorry, AgentClass.CAR)[1], name)} == {"oncoming"}
    assert {name for name in FEATURES if of(with_vehicle(lorry, AgentClass.BICYCLE, False)[1], name)} == {
        "unprotected",
        "from_side",
    }
    assert not typical.any()
