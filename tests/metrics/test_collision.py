"""Collisions of whole records: one per contact, initial ones, speeds and faces, comparison with SUMO's list."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.core.record import Controller, SumoCollision
from advdiff_sumo.metrics.background_metrics import (
    background_collisions,
    compare_with_sumo,
    replayed_collisions,
)
from advdiff_sumo.metrics.collision import collisions, target_collision
from advdiff_sumo.metrics.target_contact import target_contact


def test_rear_end_at_the_worked_time(straight, record_of) -> None:
    # 16 m between bumpers, closing at 5 m/s: 3.2 s; the target's centre is then at 48 m, its bumper at 50 m
    record = record_of(straight("ego", (0, 0), 0, 15), straight("lead", (20, 0), 0, 10))
    (hit,) = collisions(record)
    assert hit.time_s == pytest.approx(3.2, abs=1e-6)
    assert hit.rows == (0, 1)
    assert hit.faces == ("front", "rear")
    assert hit.point_m == pytest.approx([50.0, 0.0], abs=1e-6)
    assert hit.relative_speed_mps == pytest.approx(5.0)
    assert hit.closing_speed_mps == pytest.approx(5.0)
    assert not hit.initial
    assert target_collision(record, [hit]) is hit


def test_head_on_and_crossing_speeds_add_as_vectors(straight, record_of) -> None:
    (head_on,) = collisions(record_of(straight("a", (0, 0), 0, 10), straight("b", (50, 0), math.pi, 10)))
    assert head_on.time_s == pytest.approx(2.3)
    assert head_on.relative_speed_mps == pytest.approx(20.0)
    assert head_on.heading_difference_rad == pytest.approx(math.pi)
    crossing = record_of(straight("a", (-20, 0), 0, 10), straight("b", (0, -20), math.pi / 2, 10))
    (side,) = collisions(crossing)
    # fronts at -18 + 10 t; a's front reaches b's side at x = -1 as b's front reaches a's side at y = -1: 1.7 s
    assert side.time_s == pytest.approx(1.7)
    assert side.relative_speed_mps == pytest.approx(math.hypot(10, 10))
    assert side.closing_speed_mps == pytest.approx(10.0)


def test_lasting_contact_counts_once_and_a_second_one_again(straight, record_of) -> None:
    ego = straight("ego", (0, 0), 0, 0, steps=61)
    other = straight("other", (8, 0), math.pi, 0, steps=61)
    t = 0.1 * np.arange(61)
    away = 4.0 - 0.5 + 4.0 * np.abs(np.cos(0.5 * math.pi * t / 1.5))  # in contact around 1.5 s and 4.5 s
    moving = replace(other, xy_m=np.stack((away, np.zeros(61)), axis=-1))
    found = collisions(record_of(ego, moving))
    assert [round(c.time_s) for c in found] == [1, 4]


def test_overlap_from_the_start_is_initial(straight, record_of) -> None:
    record = record_of(straight("ego", (0, 0), 0, 5), straight("other", (3, 0), 0, 5))
    (hit,) = collisions(record)
    assert hit.initial
    assert hit.time_s == 0.0
    assert target_collision(record, [hit]) is None


def test_inserted_on_top_is_initial_but_driven_into_is_not(straight, record_of) -> None:
    late = straight("late", (23, 0), 0, 10)
    late.xy_m[:20] = np.nan
    (hit,) = collisions(record_of(straight("ego", (20, 0), 0, 10), late))
    assert hit.initial
    assert hit.step == 20
    later = straight("late", (20, 0), 0, 5)
    later.xy_m[:20] = np.nan
    (driven,) = collisions(record_of(straight("ego", (0, 0), 0, 10), later))
    assert not driven.initial
    assert driven.time_s == pytest.approx(3.2)


def test_background_pairs_are_found_and_kept_apart(straight, record_of) -> None:
    record = record_of(
        straight("ego", (0, 50), 0, 10),
        straight("a", (0, 0), 0, 15),
        straight("b", (20, 0), 0, 10),
        straight("c", (0, 90), 0, 0),
        straight("d", (2, 90), 0, 0),
    )
    found = collisions(record)
    assert {c.rows for c in found} == {(1, 2), (3, 4)}
    assert [c.rows for c in background_collisions(record, found)] == [(1, 2)]


@pytest.mark.parametrize(
    ("movers", "replayed"), [("POLICY", 0), ("SUMO", 0), ("REPLAYED", 1), ("REPLAYED POLICY", 0)]
)
def test_contacts_of_two_that_follow_their_log_are_counted_apart(
    straight, record_of, movers: str, replayed: int
) -> None:
    record = record_of(
        straight("ego", (0, 50), 0, 10), straight("a", (0, 0), 0, 15), straight("b", (20, 0), 0, 10)
    )
    for row, mover in zip((1, 2), (movers.split() * 2)[:2], strict=True):
        record.controller[row] = Controller[mover]
    found = collisions(record)
    assert len(found) == 1
    assert len(replayed_collisions(record, found)) == replayed
    assert len(background_collisions(record, found)) == 1 - replayed


def test_first_contact_by_hand_needs_no_overlap_at_any_instant(straight, record_of) -> None:
    small = (0.5, 0.5)
    a = straight("a", (0, 0), 0, 30, steps=11, size=small)
    b = straight("b", (9, 0), math.pi, 30, steps=11, size=small)  # 60 m/s, 3 m apart, then 3 m past
    (hit,) = collisions(record_of(a, b))
    assert hit.time_s == pytest.approx((9 - 0.5) / 60)


def test_sumo_list_is_compared_instant_by_instant(straight, record_of) -> None:
    record = record_of(straight("ego", (0, 0), 0, 15, steps=36), straight("lead", (20, 0), 0, 10, steps=36))
    # boxes overlap from 3.2 s: at the instants 33, 34, 35 (32 is a touch within rounding)
    ours = compare_with_sumo(record)
    assert (ours.listed, ours.sumo_only) == (0, 0)
    assert ours.ours_only in (3, 4)
    listed = tuple(SumoCollision(k, "ego", "lead", "collision", "WC_1") for k in (20, 33, 34, 35))
    both = compare_with_sumo(replace(record, sumo_collisions=listed))
    assert (both.listed, both.sumo_only) == (4, 1)
    assert both.ours_only == ours.ours_only - 3
    stranger = SumoCollision(3, "ego", "unknown", "collision", "WC_1")
    assert compare_with_sumo(replace(record, sumo_collisions=(stranger,))).sumo_only == 1


def test_a_record_of_one_agent_or_one_instant_has_no_collisions(straight, record_of) -> None:
    assert collisions(record_of(straight("ego", (0, 0), 0, 5))) == []
    assert (
        collisions(record_of(straight("a", (0, 0), 0, 5, steps=1), straight("b", (1, 0), 0, 5, steps=1)))
        == []
    )


def test_whole_records_agree_with_the_check_of_single_steps(straight, record_of) -> None:
    rng = np.random.default_rng(5)
    cars = []
    for n in range(24):
        start, yaw = tuple(rng.uniform(-30, 30, 2)), float(rng.uniform(-3, 3))
        cars.append(straight(f"v{n}", start, yaw, float(rng.uniform(0, 25)), steps=55))
        cars[-1].xy_m[: int(rng.integers(0, 10))] = np.nan
        cars[-1].xy_m[int(rng.integers(40, 56)) :] = np.nan
    tracks = record_of(*cars).tracks
    first: dict[tuple[int, int], float] = {}
    for k in range(tracks.steps - 1):
        for row in range(tracks.agents):
            states = (
                tracks.xy_m[:, k],
                tracks.yaw_rad[:, k],
                tracks.xy_m[:, k + 1],
                tracks.yaw_rad[:, k + 1],
            )
            others = np.arange(tracks.agents) <= row
            for _ in range(tracks.agents):
                hit = target_contact(*states, tracks.size_m, row, ignore=others)
                if hit is None:
                    break
                first.setdefault((row, hit.row), 0.1 * (k + hit.fraction))
                others[hit.row] = True
    found = {c.rows: c.time_s for c in reversed(collisions(record_of(*cars)))}
    assert len(first) >= 4
    assert found.keys() == first.keys()
    for pair, seconds in first.items():
        assert found[pair] == pytest.approx(seconds, abs=1e-6)
