"""Near misses worked by hand on the crossing of ``encounters.crossing``; cars are 4 x 2 m."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.core.frames import unit
from advdiff_sumo.metrics.collision import collisions
from advdiff_sumo.metrics.criticality import smallest_value, time_to_collision
from advdiff_sumo.metrics.near_miss import ResolvedBy, near_miss, resolution_clause
from tests.metrics.encounters import DT_S, Car, braking, driven, record_of, straight


def bend(name: str, xy: tuple[float, float], yaw: float, speed: float, radius: float, steps: int) -> Car:
    """Return a car on a circle of *radius* m, which turns left if the radius is positive."""
    turn = speed / radius * DT_S * np.arange(steps)
    left = np.array([-np.sin(yaw), np.cos(yaw)])
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    path = np.asarray(xy) + radius * (np.sin(turn)[:, None] * ahead + (1 - np.cos(turn))[:, None] * left)
    return Car(name, path, yaw + turn, np.full(steps, speed))


def test_no_near_miss_without_a_vehicle_near(road) -> None:
    assert (
        near_miss(record_of(straight("ego", (-150, -1.6), 0, 10), straight("far", (-90, -1.6), 0, 10)), road)
        is None
    )


def test_a_vehicle_that_appears_on_the_target_is_no_near_miss(road) -> None:
    """They overlap by 0.5 m from 3 s on, which is an initial contact, not a near miss that needs 9 m/s²."""
    ego = straight("ego", (-150, -4.8), 0, 10, steps=81)
    appears = straight("appears", (-146.5, -4.8), 0, 10, steps=81)
    appears.xy_m[:30] = np.nan
    assert near_miss(record_of(ego, appears), road) is None


def test_a_vehicle_that_appears_on_the_target_and_separates_may_be_a_near_miss_later(road) -> None:
    """It is 6 m/s faster, 8.5 m ahead at 4.5 s, and stands 20 m on at 7 s. The target brakes late: 25.3 of 28.5 m."""
    t = DT_S * np.arange(91)
    speed = np.where(t < 4.5, 16.0, np.maximum(0.0, 16.0 - 6.4 * (t - 4.5)))
    appears = driven("appears", (-146.5 - 18.0, -4.8), 0, speed)
    appears.xy_m[:30] = np.nan
    ego = driven("ego", (-150, -4.8), 0, braking(10, 6.2, 6.0, 91))
    record = record_of(ego, appears)
    assert [c.initial for c in collisions(record)] == [True]
    found = near_miss(record, road)
    assert found is not None
    assert found.time_s > 4.5


def test_gentle_braking_behind_a_leader_is_not_critical(road) -> None:
    ego = driven("ego", (-150, -1.6), 0, braking(12, 1.5, 3.0, 81))
    lead = driven("lead", (-118, -1.6), 0, braking(12, 0.5, 3.0, 81))
    found = near_miss(record_of(ego, lead), road)
    assert found is None or not found.critical


def test_a_cut_in_for_which_the_target_brakes_at_the_last_moment(road) -> None:
    # 8 m ahead and 8 m/s slower: closing 8 m/s in 0.75 s leaves 2 m or less; 8²/2/2 = 16 m/s² would be needed
    steps = 61
    cutter = driven(
        "cutter", (-138, -1.6), 0, np.full(steps, 6.0), left=np.maximum(-3.2, -0.4 * np.arange(steps))
    )
    speed = np.maximum(5.0, 14.0 - 9.0 * np.maximum(0.0, 0.1 * np.arange(steps) - 0.2))
    found = near_miss(record_of(driven("ego", (-150, -4.8), 0, speed), cutter), road)
    assert found is not None
    assert found.critical
    assert found.brake_mps2 > 4.0
    assert found.resolved_by is ResolvedBy.TARGET


def test_the_other_resolves_the_near_miss(road) -> None:
    # 12 m ahead it comes 1.2 m into the lane at 6 m/s against 13, and leaves it again after a second
    steps = 61
    t = 0.1 * np.arange(steps)
    left = np.where(t < 0.5, -4.0 * t, np.minimum(0.0, -2.0 + 8.0 * np.maximum(0.0, t - 1.0)))
    cutter = driven("cutter", (-134, -1.6), 0, np.full(steps, 6.0), left=left)
    found = near_miss(record_of(straight("ego", (-150, -4.8), 0, 13, steps=steps), cutter), road)
    assert found is not None
    assert found.resolved_by is ResolvedBy.OTHER


def test_a_vehicle_approaching_behind_a_standing_target_is_not_critical(road) -> None:
    # 26 m bumper to bumper, braking 8²/2/1.6 = 20 m from 8 m/s on; at its start the time to collision is 26/8 s = 3.2
    # s, after 1 s 18/8 = 2.2 s: near, but the target stands
    behind = driven("behind", (-50, -1.6), 0, braking(8, 1.0, 2.0, 61))
    assert near_miss(record_of(straight("ego", (-20, -1.6), 0, 0.0, steps=61), behind), road) is None


def test_a_vehicle_approaching_behind_a_moving_target_is_not_critical(road) -> None:
    # 16 m behind and 10 m/s faster: 1.6 s; braking at 6 m/s² it loses them within 8.3 m
    behind = driven("behind", (-70, -1.6), 0, np.maximum(5.0, braking(15, 0.3, 6.0, 61)))
    found = near_miss(record_of(straight("ego", (-50, -1.6), 0, 5.0, steps=61), behind), road)
    assert found is None or not found.critical


def test_an_oncoming_car_that_keeps_to_its_bend_is_not_critical(road) -> None:
    # 30 m radius at 8 m/s: straight on it would reach the target's lane 3.2 m beside it in the 14 m between them;
    # in the bend it passes 3.2 m and more beside the target's centre, which stands or drives
    for speed in (0.0, 3.0):
        ego = straight("ego", (-60, -1.6), 0, speed, steps=41)
        oncoming = bend("oncoming", (-38, 5.2), np.pi + 0.35, 8.0, -30.0, 41)
        found = near_miss(record_of(ego, oncoming), road)
        assert found is None or found.brake_mps2 == 0.0, speed


def test_a_car_in_its_bend_as_the_record_ends_is_not_critical(road) -> None:
    # At the end it is 8 m ahead and 6 m to the left of the target's centre and heads 0.6 rad across its lane: straight
    # on it would be there in 6 / sin 0.6 = 10.6 m, at 9 m/s² of braking too. Its bend, with a radius of 10 m, takes it
    # 10 (1 - cos 0.6) = 1.7 m nearer only.
    steps, speed = 21, 5.4
    end_yaw = np.pi + 0.6
    centre = np.array([-60.0 + 1.8 * 2.0 + 8.0, -1.6 + 6.0]) + 10.0 * unit(np.array(end_yaw - 0.5 * np.pi))
    start_yaw = end_yaw + speed * 2.0 / 10.0
    start = centre + 10.0 * unit(np.array(start_yaw + 0.5 * np.pi))
    turning = bend("turning", tuple(start), start_yaw, speed, -10.0, steps)
    found = near_miss(record_of(straight("ego", (-60, -1.6), 0, 1.8, steps=steps), turning), road)
    assert found is not None  # straight on they would meet
    assert found.time_s == pytest.approx(2.0)
    assert not found.critical


@pytest.mark.parametrize(("gap_m", "least", "most"), [(14.4, 4.5, 5.5), (20.0, 3.0, 4.0)])
def test_a_leader_that_brakes_hard(road, gap_m, least, most) -> None:
    # From 12 m/s at 8 m/s² the leader stops within 9 m; the driver has gap + 9 m, and uses 0.75 s * 12 = 9 m before
    # it brakes: 12²/2/b = gap, thus b = 72/14.4 = 5 m/s², or 72/20 = 3.6
    ego = driven("ego", (-150, -1.6), 0, braking(12, 1.2, 7.0, 81))
    lead = driven("lead", (-146 + gap_m, -1.6), 0, braking(12, 0.5, 8.0, 81))
    found = near_miss(record_of(ego, lead), road)
    assert found is not None
    assert least <= found.brake_mps2 <= most
    assert found.critical == (gap_m < 20)
    assert found.resolved_by is ResolvedBy.TARGET


def test_steering_around_the_leader_does_not_make_it_uncritical(road) -> None:
    # As the leader of above, but the target, which brakes less, swerves 3.2 m to the left within a second
    t = DT_S * np.arange(61)
    left = np.clip(3.2 * (t - 1.8), 0.0, 3.2)
    ego = driven("ego", (-150, -4.8), 0, np.maximum(4.0, braking(12, 1.2, 5.0, 61)), left=left)
    lead = driven("lead", (-146 + 14.4, -4.8), 0, braking(12, 0.5, 8.0, 61))
    found = near_miss(record_of(ego, lead), road)
    assert found is not None
    assert found.critical
    assert found.resolved_by is ResolvedBy.TARGET


def test_the_hardest_braking_counts_not_the_least_time(road) -> None:
    # The leader as above needs 5 m/s². An oncoming car in its bend would be met sooner if it went straight on.
    ego = driven("ego", (-150, -1.6), 0, braking(12, 1.2, 7.0, 61))
    lead = driven("lead", (-146 + 14.4, -1.6), 0, braking(12, 0.5, 8.0, 61))
    oncoming = bend("oncoming", (-128, 3.6), np.pi + 0.35, 8.0, -30.0, 61)
    record = record_of(ego, lead, oncoming)
    nearest = smallest_value(time_to_collision(record.tracks, 0), record.tracks)
    found = near_miss(record, road)
    assert nearest is not None
    assert found is not None
    assert (nearest.row, found.row) == (2, 1)
    assert found.critical


def test_a_vehicle_driving_into_the_side_is_not_critical(road) -> None:
    # It drifts at 4 m/s into the side of the target, whose front is beside it at any braking, and stops short of it
    t = DT_S * np.arange(41)
    left = -np.minimum(2.6, 4.0 * np.maximum(0.0, t - 1.0))
    beside = driven("beside", (-150, 3.2), 0, np.full(41, 12.0), left=left)
    found = near_miss(record_of(straight("ego", (-150, -1.6), 0, 12.0), beside), road)
    assert found is None or not found.critical


def test_a_record_that_ends_before_the_near_miss_is_resolved(road) -> None:
    # 14 m behind a standing car at 12 m/s: 1.2 s to the contact, and neither reacts until the end
    ego = straight("ego", (-150, -1.6), 0, 12.0, steps=26)
    lead = straight("lead", (-150 + 30 + 4 + 14, -1.6), 0, 0.0, steps=26)
    found = near_miss(record_of(ego, lead), road)
    assert found is not None
    assert found.resolved_by is None
    assert resolution_clause(found.resolved_by) == "the record ends before it is resolved"
    assert resolution_clause(ResolvedBy.TARGET) == "resolved by: target"


def test_a_vehicle_that_appears_at_the_last_instant_leaves_it_unresolved(road) -> None:
    """Its last motion is unknown, so it cannot have resolved the near miss."""
    ego, lead = (
        straight("ego", (-150, -1.6), 0, 12.0),
        straight("lead", (-94, -1.6), 0, 0.0),
    )  # 4 m ahead at 4 s
    lead.xy_m[:-1] = np.nan
    found = near_miss(record_of(ego, lead), road)
    assert found is not None
    assert found.time_s == pytest.approx(4.0)
    assert found.resolved_by is None
