"""The approach of the other and the manoeuvre of the target, computed by hand on a crossing at the origin."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sweep.situation import situation
from tests.metrics.encounters import Car, crossing, record_of, straight


@pytest.fixture(scope="module")
def road(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    return crossing(tmp_path_factory.mktemp("situation"), "priority")


def row(collides_s: float | None = 4.0, **values: object) -> dict[str, object]:
    """Return the row of a collision with "other"; None: it passes at 4 s."""
    hit = collides_s is not None
    return {
        "target_collision": hit,
        "collision_time_s": collides_s,
        "collision_partner": "other" if hit else None,
        "min_clearance_time_s": 4.0,
        "min_clearance_partner": "other",
        **values,
    }


@pytest.mark.parametrize(
    ("other", "word"),
    [
        (straight("other", (30.0, 0.0), 0.0, 4.0), "ahead"),
        (straight("other", (-20.0, 0.0), 0.0, 12.0), "behind"),
        (straight("other", (2.0, 3.2), 0.0, 10.0), "beside_left"),
        (straight("other", (2.0, -3.2), 0.0, 10.0), "beside_right"),
        (straight("other", (80.0, 0.0), np.pi, 10.0), "oncoming"),
        (straight("other", (40.0, 40.0), -np.pi / 2, 10.0), "from_left"),
        (straight("other", (40.0, -40.0), np.pi / 2, 10.0), "from_right"),
    ],
)
def test_the_approach_of_the_other(other: Car, word: str, road: RoadMap) -> None:
    """The target goes east from the origin at 10 m/s; both a contact and a pass count."""
    record = record_of(straight("ego", (0.0, 0.0), 0.0, 10.0), other)
    for values in (row(), row(None)):
        out = situation(record, values, road)
        assert (out["approach"], out["target_manoeuvre"]) == (word, "straight")
    assert situation(record, row(None), road)["approach_ahead_m"] is None
    assert situation(record, row(), road)["attacker_manoeuvre"] is None


@pytest.mark.parametrize(
    ("manoeuvres", "word"),
    [
        ({}, "natural"),
        ({"other": ("cut-in", 0.0)}, "cut-in"),
        ({"third": ("cut-in", 0.0)}, "natural"),
        ({"other": ("cut-in", -4.5)}, "natural"),
    ],
)
def test_the_attack_of_the_other(manoeuvres: dict[str, tuple[str, float]], word: str, road: RoadMap) -> None:
    """Contact is at 4 s; what was over 8 s before does not count."""
    ego, other = straight("ego", (0.0, 0.0), 0.0, 10.0), straight("other", (30.0, 0.0), 0.0, 4.0)
    record = record_of(ego, other, manoeuvres=manoeuvres)
    assert situation(record, row(), road)["attacker_manoeuvre"] == word


def test_leaving_the_road_has_no_partner(road: RoadMap) -> None:
    record = record_of(straight("ego", (0.0, 0.0), 0.0, 10.0), straight("other", (30.0, 0.0), 0.0, 4.0))
    assert situation(record, row(collision_partner=None), road)["approach"] is None


@pytest.mark.parametrize(
    ("turned_rad", "speed_mps", "word"),
    [(1.5, 5.0, "turn_left"), (-1.5, 5.0, "turn_right"), (0.2, 5.0, "straight"), (0.0, 0.1, "standing")],
)
def test_the_manoeuvre_of_the_target(turned_rad: float, speed_mps: float, word: str, road: RoadMap) -> None:
    """It turns evenly over the 3 s up to 4 s."""
    ego = straight("ego", (0.0, 0.0), 0.0, speed_mps)
    yaw = np.clip(0.1 * np.arange(41) - 1.0, 0.0, 3.0) * turned_rad / 3.0
    turning = Car(ego.name, ego.xy_m, yaw, ego.speed_mps, ego.size_m)
    record = record_of(turning, straight("other", (30.0, 0.0), 0.0, 4.0))
    assert situation(record, row(), road)["target_manoeuvre"] == word
