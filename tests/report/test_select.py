"""Order of the episodes, choice of pictures, choice of the attacker."""

from __future__ import annotations

from typing import Any

from advdiff_sumo.metrics.severity import badge, worst_first
from advdiff_sumo.report.select import UNEVENTFUL_SHOWN, attacker_of, nearest_s, pictured_episodes


def _numbers(episodes: list[Any]) -> list[int]:
    return [row["episode"] for row in episodes]


def test_worst_first(rows: Any) -> None:
    episodes = [
        rows.episode(0),
        rows.episode(1, min_ttc_s=2.0),
        rows.episode(2, min_ttc_s=1.0),
        rows.episode(3, end="failed"),
        rows.struck(4, at_fault="other", closing_speed_mps=20.0),
        rows.struck(5, closing_speed_mps=3.0),
        rows.struck(6, closing_speed_mps=9.0),
        rows.struck(7, closing_speed_mps=None, collision_partner=None),
        rows.episode(8, min_clearance_m=0.4),
        rows.episode(9, offences="red_light"),
        rows.episode(10, critical=True, critical_brake_mps2=5.0),
    ]
    assert _numbers(worst_first(episodes)) == [6, 5, 7, 4, 3, 10, 9, 2, 1, 8, 0]
    assert [badge(row) for row in episodes[-4:]] == ["not judged", "no collision", "rule broken", "critical"]


def test_equal_episodes_keep_their_numbers_order(rows: Any) -> None:
    assert _numbers(worst_first([rows.episode(k) for k in (3, 1, 2)])) == [1, 2, 3]


def test_all_eventful_and_some_others_get_a_picture(rows: Any) -> None:
    quiet = [rows.episode(k) for k in range(UNEVENTFUL_SHOWN + 5)]
    loud = [rows.struck(100 + k) for k in range(40)] + [rows.episode(200, end="failed")]
    chosen = _numbers(pictured_episodes(worst_first(quiet + loud)))
    assert set(chosen) == {*range(100, 140), 200, *range(UNEVENTFUL_SHOWN)}


def test_attacker(rows: Any) -> None:
    assert attacker_of(rows.struck(0, "a", min_ttc_partner="b")) == "a"
    assert attacker_of(rows.episode(0, min_ttc_partner="b", min_clearance_partner="c")) == "b"
    assert attacker_of(rows.episode(0, min_clearance_partner="c")) == "c"
    assert attacker_of(rows.episode(0)) is None


def test_a_critical_near_miss_is_shown_with_its_own_partner_and_moment(rows: Any) -> None:
    passing = {"min_ttc_partner": "b", "min_clearance_partner": "c", "min_clearance_time_s": 3.0}
    near_miss = rows.episode(0, **passing, critical=True, near_miss_partner="d", near_miss_time_s=8.4)
    assert (attacker_of(near_miss), nearest_s(near_miss)) == ("d", 8.4)
    assert nearest_s(rows.episode(0, **passing)) == 3.0
    assert nearest_s(rows.episode(0)) is None
