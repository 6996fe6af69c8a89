"""TTC, DRAC, PET and clearance against worked values."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from advdiff_sumo.core.boxes import corners
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.metrics.criticality import (
    TTC_HORIZON_S,
    Extreme,
    clearances,
    smallest_value,
    time_to_collision,
)
from advdiff_sumo.metrics.encroachment import post_encroachment
from advdiff_sumo.metrics.following import following_gaps
from advdiff_sumo.metrics.kinematics import snaps, velocities
from advdiff_sumo.metrics.metric_rows import episode_row
from tests.sim import nets


def test_ttc_of_two_seconds(straight, record_of) -> None:
    record = record_of(straight("ego", (0, 0), 0, 15, steps=2), straight("lead", (24, 0), 0, 5, steps=2))
    ttc = time_to_collision(record.tracks, 0)
    assert ttc[1] == pytest.approx([2.0, 1.9])  # 20 m at 10 m/s
    assert np.isnan(ttc[0]).all()


def test_rounding_does_not_decide_when_the_least_value_was(straight, record_of) -> None:
    tracks = record_of(
        straight("ego", (0, 0), 0, 0, steps=5), straight("other", (0, 3), 0, 0, steps=5)
    ).tracks
    values = np.array([[np.nan] * 5, [2.0, 1.0, 1.0 - 2e-16, 1.0 - 4e-16, 1.5]])
    assert smallest_value(values, tracks) == Extreme(1.0 - 4e-16, 1, pytest.approx(0.1))


def test_a_pedestrian_put_onto_the_next_path_does_not_walk_there(straight, record_of) -> None:
    """It passes 0.7 m ahead of a standing car at 1.4 m/s; 0.4 m to the side in one step would be 4 m/s towards it."""
    walker = replace(straight("walker", (3.3, -4), math.pi / 2, 1.4), agent_class=AgentClass.PEDESTRIAN)
    walker = replace(walker, size_m=(0.6, 0.6))
    walker.xy_m[10:, 0] -= 0.4
    tracks = record_of(straight("ego", (0, 0), 0, 0), walker).tracks
    velocity = velocities(tracks)[1]
    np.testing.assert_allclose(velocity, np.broadcast_to([0.0, 1.4], velocity.shape), atol=1e-9)
    assert np.isinf(time_to_collision(tracks, 0)[1]).all()


def test_an_instantaneous_lane_change_gives_no_velocity(straight, record_of) -> None:
    """The lateral distance falls from 4.4 to 1.2 m in one step; 16 m/s would give a TTC of 0.275 and 0.075 s."""
    beside = straight("beside", (2, 6.4), 0, 10)
    beside.xy_m[20:, 1] -= 3.2
    record = record_of(straight("ego", (0, 0), 0, 10), beside)
    velocity = velocities(record.tracks)
    np.testing.assert_allclose(velocity, np.broadcast_to([10.0, 0.0], velocity.shape), atol=1e-9)
    assert np.isinf(time_to_collision(record.tracks, 0)[1]).all()
    row = np.flatnonzero(snaps(record.tracks).any(axis=1)).tolist()
    assert (row, np.flatnonzero(snaps(record.tracks)[1]).tolist()) == ([1], [19])


def test_two_instantaneous_lane_changes_leave_the_speed_along_the_heading(straight, record_of) -> None:
    other = straight("other", (2, 6.4), 0, 10)
    other.xy_m[20:, 1] -= 3.2
    other.xy_m[21:, 1] += 3.2
    other.speed_mps[20] = 9.0
    velocity = velocities(record_of(straight("ego", (0, 0), 0, 10), other).tracks)
    assert velocity[1, 19:22].tolist() == [pytest.approx([x, 0.0]) for x in (10.0, 9.0, 10.0)]


def test_an_instantaneous_lane_change_of_an_oncoming_car_is_no_approach(
    tmp_path, straight, record_of
) -> None:
    """Without sublanes: from y = 4.8 to 1.6 in one step, 6 m before a standing car at y = -1.6."""
    poses = []
    with nets.stage(nets.street(tmp_path), sublane_m=0.0) as stage:
        stage.add("other", ["MW"], at=70.0, speed=10.0)
        stage.free("other")
        stage.api.vehicle.setSpeed("other", 10.0)
        for k in range(41):
            if k == 28:
                stage.api.vehicle.changeLane("other", 1, 60.0)
            stage.step()
            poses.append(stage.pose("other")[0])
    size = (nets.LENGTH_M, nets.WIDTH_M)
    ego = straight("ego", (97.5, -1.6), 0, 0, size=size)
    other = replace(straight("other", (0, 0), math.pi, 10, size=size), xy_m=np.array(poses))
    tracks = record_of(ego, other).tracks
    assert np.flatnonzero(snaps(tracks)[1]).tolist() == [27]
    assert tracks.xy_m[1, 28].tolist() == pytest.approx([103.5, 1.6])
    np.testing.assert_allclose(velocities(tracks)[1], np.broadcast_to([-10.0, 0.0], (41, 2)), atol=1e-9)
    assert np.isinf(time_to_collision(tracks, 0)[1]).all()


def test_a_quick_lane_change_counts_as_lateral_motion(straight, record_of) -> None:
    """Sideways at 4 m/s, 2.4 m apart: 0.6 s."""
    beside = straight("beside", (2, 4.4), 0, 10, drift=-4.0, steps=2)
    tracks = record_of(straight("ego", (0, 0), 0, 10, steps=2), beside).tracks
    assert time_to_collision(tracks, 0)[1] == pytest.approx([0.6, 0.5])


def test_ttc_of_crossing_and_missing_boxes(straight, record_of) -> None:
    record = record_of(
        straight("ego", (-20, 0), 0, 10, steps=2),
        straight("cross", (0, -20), math.pi / 2, 10, steps=2),
        straight("after", (0, -30), math.pi / 2, 10, steps=2),
        straight("beside", (0, 2.5), 0, 0, steps=2),
        straight("far", (500, 0), 0, 0, steps=2),
    )
    ttc = time_to_collision(record.tracks, 0)[:, 0]
    assert ttc[1] == pytest.approx(1.7)
    assert ttc[2:].tolist() == [math.inf] * 3  # passes 1 m/s late, beside, beyond the horizon


def test_lane_ttc_and_drac_by_the_formula(straight, record_of, road) -> None:
    record = record_of(straight("ego", (-100, -1.6), 0, 15), straight("lead", (-80, -1.6), 0, 10))
    ahead = following_gaps(record.tracks, 0, road, record.route)
    assert ahead.gap_m[1, 0] == pytest.approx(16.0)
    assert ahead.time_to_collision()[1, 0] == pytest.approx(3.2)
    assert ahead.deceleration_to_avoid()[1, 0] == pytest.approx(25.0 / 32.0)
    assert ahead.time_to_collision()[1, 12] == pytest.approx(2.0)


def test_leader_beyond_the_junction_counts_and_the_next_lane_does_not(straight, record_of, road) -> None:
    record = record_of(
        straight("ego", (-40, -1.6), 0, 10, steps=2),
        straight("beyond", (30, -1.6), 0, 10, steps=2),
        straight("beside", (-20, -4.8), 0, 10, steps=2),
        straight("behind", (-60, -1.6), 0, 10, steps=2),
        straight("oncoming", (-20, 1.6), math.pi, 10, steps=2),
    )
    gap = following_gaps(record.tracks, 0, road, record.route).gap_m
    assert gap[1, 0] == pytest.approx(66.0, abs=0.01)
    assert np.isnan(gap[2:]).all()
    assert np.isinf(following_gaps(record.tracks, 0, road, ("WC", "CE")).time_to_collision()[1, 0])


def test_a_vehicle_standing_beside_the_lane_is_not_ahead_in_it(straight, record_of, road) -> None:
    """Otherwise DRAC would be large for pedestrians on the pavement. The lane reaches down to y = -6.4."""
    record = record_of(
        straight("ego", (-150, -4.8), 0, 12, steps=2),
        straight("pavement", (-100, -8.5), 0, 0, steps=2, size=(0.6, 0.6)),
        straight("parked", (-100, -7.2), 0, 0, steps=2),  # up to y = -6.2: 0.2 m in the lane
        straight(
            "askew", (-100, -7.2), 0.3, 0, steps=2
        ),  # half 4 sin 0.3 + half 2 cos 0.3 = 1.55: up to -5.65
    )
    gap = following_gaps(record.tracks, 0, road, record.route).gap_m
    assert np.isnan(gap[1:3]).all()
    assert gap[3, 0] == pytest.approx(46.0)


def test_an_oncoming_vehicle_in_the_lane_closes_in_at_the_sum_of_speeds(straight, record_of, road) -> None:
    """It counts as approaching, not as a leader of the same speed."""
    ego, wrong = straight("ego", (-150, -4.8), 0, 12), straight("wrong", (-98, -4.8), math.pi, 8)
    ahead = following_gaps(record_of(ego, wrong).tracks, 0, road, ("WC", "CE"))
    assert ahead.closing_mps[1, 0] == pytest.approx(20.0)
    assert ahead.time_to_collision()[1, 0] == pytest.approx(2.4)  # 52 - 4 = 48 m at 20 m/s
    assert ahead.deceleration_to_avoid()[1, 0] == pytest.approx(400.0 / 96.0)


def test_a_vehicle_passed_within_the_lane_is_ahead_until_the_bumpers_are_level(
    straight, record_of, road
) -> None:
    """A motorcycle at the lane's edge with a lateral gap of 0.4 m; side by side it requires no braking."""
    car = straight("ego", (-150, -2.2), 0, 12, size=(4.0, 1.8))  # from y = -3.1 to -1.3
    slow = straight("motorcycle", (-140, -0.5), 0, 8, size=(2.0, 0.8))  # up from y = -0.9
    record = record_of(car, slow)
    ahead = following_gaps(record.tracks, 0, road, record.route)
    seconds, drac = ahead.time_to_collision()[1], ahead.deceleration_to_avoid()[1]
    assert seconds[:18] == pytest.approx((7.0 - 0.4 * np.arange(18)) / 4.0)  # 7 m at first, 0.2 m at 1.7 s
    assert drac[17] == pytest.approx(16.0 / 0.4)
    assert np.isnan(seconds[18:]).all()
    assert np.isnan(drac[18:]).all()
    row = episode_row(record, road)
    assert row["min_lane_ttc_s"] == pytest.approx(0.05)
    assert (row["min_ttc_s"], row["max_drac_mps2"]) == (None, pytest.approx(40.0))


def test_the_gap_decreases_to_zero_until_a_rear_end_contact(straight, record_of, road) -> None:
    """8 m at 4 m/s: contact at 2.0 s; one instant before, 0.4 m at 4 m/s."""
    ego, lead = straight("ego", (-150, -1.6), 0, 12), straight("lead", (-138, -1.6), 0, 8)
    row = episode_row(record_of(ego, lead), road)
    assert row["collision_time_s"] == pytest.approx(2.0)
    assert row["min_lane_ttc_s"] == pytest.approx(0.1)
    assert row["max_drac_mps2"] == pytest.approx(16.0 / 0.8)


def test_pet_of_a_crossing_of_one_and_a_half_seconds(straight, record_of) -> None:
    # the ego's rear leaves the square |x| <= 1 at -20 + 10 t - 2 = 1, t = 2.3 s;
    # the other's front reaches y = -1 at -36 - 3 + 2 + 10 t = -1 + ... : -39 + 10 t + 2 = -1, t = 3.6 s + 0.2 s
    record = record_of(
        straight("ego", (-20, 0), 0, 10), straight("other", (0, -41), math.pi / 2, 10, steps=41)
    )
    pet = post_encroachment(record.tracks, 0)
    # enters at (41 - 2 - 1) / 10 = 3.8 s, 1.5 s after 2.3 s
    assert pet is not None
    assert pet.value == pytest.approx(1.5, abs=0.021)
    assert pet.row == 1
    assert pet.time_s == pytest.approx(3.8, abs=0.021)


def test_pet_is_undefined_for_followers_and_paths_that_do_not_cross(straight, record_of) -> None:
    record = record_of(
        straight("ego", (-20, 0), 0, 10),
        straight("follower", (-35, 0), 0, 10),
        straight("parallel", (-20, 4), 0, 8),
        straight("ends before", (0, -60), math.pi / 2, 10),
    )
    assert post_encroachment(record.tracks, 0) is None


def test_pet_is_zero_in_a_crossing_collision(straight, record_of) -> None:
    record = record_of(straight("ego", (-20, 0), 0, 10), straight("other", (0, -20), math.pi / 2, 10))
    pet = post_encroachment(record.tracks, 0)
    assert pet is not None
    assert pet.value == 0.0


def test_clearance_of_a_pass(straight, record_of) -> None:
    record = record_of(
        straight("ego", (0, 0), 0, 10), straight("parked", (20, 2.5), 0, 0), straight("far", (20, 40), 0, 0)
    )
    nearest = smallest_value(clearances(record.tracks, 0), record.tracks)
    assert nearest is not None
    assert nearest.value == pytest.approx(0.5)
    assert (nearest.row, nearest.time_s) == (1, pytest.approx(1.6))  # bumpers level: 20 - 4 = 16 m


pose = st.tuples(st.floats(-25, 25), st.floats(-25, 25), st.floats(-3, 3), st.floats(0, 15))


@settings(max_examples=60, deadline=None)
@given(pose, pose)
def test_ttc_agrees_with_moving_the_boxes(straight, record_of, first, second) -> None:
    cars = [straight(n, p[:2], p[2], p[3], steps=2) for n, p in zip("ab", (first, second), strict=True)]
    tracks = record_of(*cars).tracks
    ttc = float(time_to_collision(tracks, 0)[1, 0])
    assert float(time_to_collision(tracks, 1)[0, 0]) == pytest.approx(ttc, abs=1e-6)

    def apart(seconds: float) -> float:
        shapes = [
            shapely.Polygon(
                corners(
                    np.array([x + v * seconds * math.cos(yaw), y + v * seconds * math.sin(yaw)]),
                    np.array(yaw),
                    np.array([4.0, 2.0]),
                )
            )
            for x, y, yaw, v in (first, second)
        ]
        inner = [s.buffer(-1e-6, join_style="mitre") for s in shapes]
        return inner[0].distance(inner[1])

    assert all(apart(t) > 0.0 for t in np.arange(0.0, min(ttc, TTC_HORIZON_S), 0.25))
    if math.isfinite(ttc):
        assert apart(ttc) < 1e-4
