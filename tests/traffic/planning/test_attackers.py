"""The choice of attackers, worked by hand: the target drives east from the origin at 10 m/s."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.traffic.licence import LicenceName
from advdiff_sumo.traffic.planning.attackers import STICKY_M, can_attack, choose, closest_m
from advdiff_sumo.traffic.planning.futures import Futures, constant_velocity_futures

#          x, y, yaw, speed
CARS = {
    "target": (0, 0, 0, 10),
    "ahead": (20, 0, 0, 9),
    "behind": (-15, 0, 0, 11),
    "beside": (3, 3.5, 0, 10),
    "oncoming": (60, 3.5, np.pi, 10),
    "crossing": (40, -38, np.pi / 2, 10),
    "far": (200, 100, 0, 5),
}
NAMES = list(CARS)
SIZES = np.tile([4.0, 2.0], (3, 1))


def futures() -> Futures:
    x = np.array(list(CARS.values()), dtype=np.float64)
    return constant_velocity_futures(x[:, :2], x[:, 2], x[:, 3], np.tile([4.0, 2.0], (len(x), 1)), 8, 0.5)


def chosen(attack: str, count: int = 8, before: str = "", moved: tuple[str, ...] = tuple(NAMES)) -> list[str]:
    may = np.isin(NAMES, moved)
    rows = choose(futures(), may, attack, count, np.array([name == before for name in NAMES]))
    return [NAMES[row] for row in rows.tolist()]


@pytest.mark.parametrize(
    ("attack", "names"),
    [
        ("any", ["beside", "crossing", "oncoming", "behind", "ahead"]),
        ("cut-in", ["beside"]),
        ("brake", ["ahead"]),
        ("rear-end", ["behind"]),
        ("head-on", ["oncoming"]),
        ("junction", ["crossing"]),
    ],
)
def test_vehicles_in_position_for_each_attack(attack: str, names: list[str]) -> None:
    assert sorted(chosen(attack)) == sorted(names)


def test_nearest_attackers_come_first_and_the_target_is_none() -> None:
    near = closest_m(futures())
    order = chosen("any")
    assert [near[NAMES.index(x)] for x in order] == sorted(near[NAMES.index(x)] for x in order)
    assert "target" not in order
    assert chosen("any", count=2) == order[:2]


def test_only_moved_vehicles_attack() -> None:
    assert chosen("any", moved=("ahead", "far")) == ["ahead"]
    assert chosen("any", moved=()) == []


def test_an_attacker_is_kept_until_another_vehicle_comes_much_nearer() -> None:
    """The vehicle ahead ends up 16 − 4 = 12 m away, the one behind 11 − 4 = 7 m: 5 m nearer is not enough."""
    near = dict(zip(NAMES, closest_m(futures()), strict=True))
    assert near["ahead"] == pytest.approx(12.0)
    assert near["behind"] == pytest.approx(7.0)
    both = ("ahead", "behind")
    assert chosen("any", count=1, moved=both) == ["behind"]
    assert chosen("any", count=1, moved=both, before="ahead") == ["ahead"]
    assert near["ahead"] - near["beside"] > STICKY_M
    assert chosen("any", count=1, before="ahead", moved=("ahead", "beside")) == ["beside"]


@pytest.mark.parametrize(
    ("licence", "names"),
    [
        ("reckless", set(NAMES)),
        ("careless", {"beside", "oncoming", "crossing", "far"}),
        ("lawful", {"beside", "oncoming", "crossing", "far"}),
    ],
)
def test_lawful_attackers_are_not_guided_behind_the_target_or_ahead_in_its_lane(
    licence: LicenceName, names: set[str]
) -> None:
    may = can_attack(futures(), np.ones(len(NAMES), dtype=np.bool_), licence)
    assert {name for name, can in zip(NAMES, may, strict=True) if can} == names


def test_a_lead_vehicle_beyond_a_bend_counts_as_leading() -> None:
    """The target turns left by 90° on a radius of 20 m; one car is 10 m past the bend, one 10 m off its path."""
    angle = np.linspace(0.0, 0.5 * np.pi, 9)
    bend = np.stack((20.0 * np.sin(angle), 20.0 - 20.0 * np.cos(angle)), axis=-1)
    cars = np.array([[0.0, 0.0], [20.0, 30.0], [30.0, 30.0]])
    still = constant_velocity_futures(
        cars, np.array([0.0, 0.5 * np.pi, 0.5 * np.pi]), np.array([8.0, 0.0, 0.0]), SIZES, 8, 0.5
    )
    still.put(0, bend[1:], angle[1:], np.full(8, 8.0))
    assert can_attack(still, np.ones(3, dtype=np.bool_), "lawful").tolist() == [False, False, True]


def test_only_reckless_attackers_are_guided_against_a_standing_target() -> None:
    cars = np.array([[0.0, 0.0], [5.0, 3.5], [20.0, 3.5]])
    standing = constant_velocity_futures(cars, np.zeros(3), np.array([1.9, 8.0, 8.0]), SIZES, 8, 0.5)
    every = np.ones(3, dtype=np.bool_)
    assert not can_attack(standing, every, "lawful").any()
    assert can_attack(standing, every, "reckless").all()
