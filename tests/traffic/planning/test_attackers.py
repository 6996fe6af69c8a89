"""Who attacks, by hand: the target drives east from the origin at 10 m/s."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.traffic.planning.attackers import STICKY_M, choose, closest_m
from advdiff_sumo.traffic.planning.futures import Futures, coasting

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


def futures() -> Futures:
    x = np.array(list(CARS.values()), dtype=np.float64)
    return coasting(x[:, :2], x[:, 2], x[:, 3], np.tile([4.0, 2.0], (len(x), 1)), 8, 0.5)


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
def test_who_is_in_a_position_for_what(attack: str, names: list[str]) -> None:
    assert sorted(chosen(attack)) == sorted(names)


def test_the_nearest_ones_first_and_never_the_target() -> None:
    near = closest_m(futures())
    order = chosen("any")
    assert [near[NAMES.index(x)] for x in order] == sorted(near[NAMES.index(x)] for x in order)
    assert "target" not in order
    assert chosen("any", count=2) == order[:2]


def test_only_who_can_be_moved() -> None:
    assert chosen("any", moved=("ahead", "far")) == ["ahead"]
    assert chosen("any", moved=()) == []


def test_an_attacker_is_kept_until_somebody_comes_much_nearer() -> None:
    """The one ahead ends up 16 − 4 = 12 m away, the one behind 11 − 4 = 7 m: 5 m are not enough to change."""
    near = dict(zip(NAMES, closest_m(futures()), strict=True))
    assert near["ahead"] == pytest.approx(12.0)
    assert near["behind"] == pytest.approx(7.0)
    both = ("ahead", "behind")
    assert chosen("any", count=1, moved=both) == ["behind"]
    assert chosen("any", count=1, moved=both, before="ahead") == ["ahead"]
    assert near["ahead"] - near["beside"] > STICKY_M
    assert chosen("any", count=1, before="ahead", moved=("ahead", "beside")) == ["beside"]
