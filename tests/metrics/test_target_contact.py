"""The swept contact check: hand-worked times, then properties against fine sampling and shapely."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from advdiff_sumo.core.boxes import corners
from advdiff_sumo.metrics.continuous_collision import BoxMotion, first_contact
from advdiff_sumo.metrics.target_contact import standing_overlaps, target_contact

SIZE = np.array([[4.0, 2.0], [4.0, 2.0]])


def contact(a0, a1, b0, b1, size=SIZE, **rest):
    """Check the step of two boxes given as (x, y, yaw)."""
    start, end = np.array([a0, b0], dtype=float), np.array([a1, b1], dtype=float)
    return target_contact(start[:, :2], start[:, 2], end[:, :2], end[:, 2], size, 0, **rest)


def test_head_on_contact_is_found_at_the_worked_moment() -> None:
    # centres 7 m apart, bumpers 3 m; each moves 3 m: they touch after half the step, midway
    found = contact((0, 0, 0), (3, 0, 0), (7, 0, math.pi), (4, 0, math.pi))
    assert found is not None
    assert (found.row, found.fraction) == (1, pytest.approx(0.5, abs=1e-9))
    assert found.point_m == pytest.approx([3.5, 0.0], abs=1e-9)
    assert found.penetration_m == pytest.approx(2.0)  # sideways is the shortest way out, 2 m wide


def test_nothing_passes_through_at_60_mps_closing_speed() -> None:
    # the motorcycles (0.5 m long) are apart at both instants and have swapped places
    small = np.array([[0.5, 0.5], [0.5, 0.5]])
    found = contact((0, 0, 0), (3, 0, 0), (3, 0, math.pi), (0, 0, math.pi), size=small)
    assert found is not None
    assert found.fraction == pytest.approx(2.5 / 6.0)
    crossing = contact((0, -1.5, math.pi / 2), (0, 1.5, math.pi / 2), (-1.5, 0, 0), (1.5, 0, 0), size=small)
    assert crossing is not None
    assert crossing.fraction == pytest.approx(1.0 / 3.0)  # 1.5 - 3 t = 0.5


def test_grazing_pass_at_one_centimetre_is_no_contact() -> None:
    assert contact((0, 0, 0), (3, 0, 0), (3, 2.01, math.pi), (0, 2.01, math.pi)) is None
    found = contact((0, 0, 0), (3, 0, 0), (7, 1.99, math.pi), (4, 1.99, math.pi))
    assert found is not None
    assert found.fraction == pytest.approx(0.5)


def test_turning_box_hits_with_its_corner() -> None:
    # a 4 x 2 box turns by 90 degrees beside a wall-like box whose face is at y = 1.5: its front left corner,
    # at radius sqrt(5) and 26.565 degrees, reaches 1.5 at asin(1.5 / sqrt 5) - 26.565 degrees
    turn = math.asin(1.5 / math.sqrt(5.0)) - math.atan2(1.0, 2.0)
    size = np.array([[4.0, 2.0], [40.0, 2.0]])
    found = contact((0, 0, 0), (0, 0, math.pi / 2), (0, 2.5, 0), (0, 2.5, 0), size=size)
    assert found is not None
    assert found.fraction == pytest.approx(turn / (math.pi / 2), abs=1e-3)


def test_heading_turns_along_the_shorter_arc() -> None:
    found = contact((0, 0, 3.1), (0, 0, -3.1), (0, 2.2, 0), (0, 2.2, 0))
    assert found is None  # a turn through 0.08 rad moves the corner by 8 cm; the long way would hit


def test_absent_ignored_and_jumping_agents_do_not_touch() -> None:
    nan = (math.nan, math.nan, math.nan)
    assert contact((0, 0, 0), (3, 0, 0), nan, (4, 0, 0)) is None
    assert contact((0, 0, 0), (3, 0, 0), (4, 0, 0), nan) is None
    assert contact((0, 0, 0), (30, 0, 0), (15, 0, 0), (15, 0, 0)) is None  # 300 m/s: put there, not driven
    hit = (0, 0, 0), (3, 0, 0), (6, 0, 0), (6, 0, 0)
    assert contact(*hit) is not None
    assert contact(*hit, ignore=np.array([False, True])) is None


def test_first_of_several_partners_wins() -> None:
    start = np.array([[0, 0], [6, 0], [5, 0.5]], dtype=float)
    end = start + np.array([[3, 0], [0, 0], [0, 0]])
    found = target_contact(start, np.zeros(3), end, np.zeros(3), np.tile([4.0, 2.0], (3, 1)), 0)
    assert found is not None
    assert (found.row, found.fraction) == (2, pytest.approx(1.0 / 3.0))


def test_standing_overlaps_last_until_parted() -> None:
    yaw = np.zeros(2)
    together, near, apart = (np.array([[0.0, 0.0], [x, 0.0]]) for x in (3.5, 4.05, 4.2))
    first = standing_overlaps(None, together, together, yaw, SIZE, 0)
    assert first.tolist() == [False, True]
    still = standing_overlaps(first, together, near, yaw, SIZE, 0)
    assert still.tolist() == [False, True]
    gone = standing_overlaps(still, near, apart, yaw, SIZE, 0)
    assert not gone.any()
    assert not standing_overlaps(gone, apart, together, yaw, SIZE, 0).any()  # a real collision
    absent = np.array([[0.0, 0.0], [np.nan, np.nan]])
    assert standing_overlaps(gone, absent, together, yaw, SIZE, 0).any()  # inserted on top


pose = st.tuples(st.floats(-6, 6), st.floats(-6, 6), st.floats(-3.2, 3.2))
step = st.tuples(st.floats(-4, 4), st.floats(-4, 4), st.floats(-0.6, 0.6))
size = st.tuples(st.floats(0.5, 8.0), st.floats(0.4, 2.6))


def boxes(poses, sizes, fraction, steps):
    """Return shapely boxes of two agents at a fraction of their step."""
    state = np.array(poses) + fraction * np.array(steps)
    return [shapely.Polygon(c) for c in corners(state[:, :2], state[:, 2], np.array(sizes))]


@settings(max_examples=80, deadline=None)
@given(st.tuples(pose, pose), st.tuples(step, step), st.tuples(size, size))
def test_agrees_with_fine_sampling_and_shapely(poses, steps, sizes) -> None:
    start, move = np.array(poses), np.array(steps)
    motion = BoxMotion(start[:, :2], start[:, 2], move[:, :2], move[:, 2], 0.5 * np.array(sizes))
    found = first_contact(motion.rows(np.array([0])), motion.rows(np.array([1])))[0]
    until = 1.0 if np.isnan(found) else float(found)
    for fraction in np.arange(0.0, until, 1.0 / 60.0):
        # a touch shorter than a thousandth of the step may be missed: less than a centimetre deep
        a, b = (x.buffer(-0.01, join_style="mitre") for x in boxes(poses, sizes, fraction, steps))
        assert not a.intersects(b)
    if not np.isnan(found):
        a, b = boxes(poses, sizes, float(found), steps)
        assert a.distance(b) <= 1e-5


@settings(max_examples=60, deadline=None)
@given(st.tuples(pose, pose), st.tuples(step, step), st.tuples(size, size), pose)
def test_symmetric_and_unmoved_by_rigid_motions(poses, steps, sizes, motion) -> None:
    start, move = np.array(poses), np.array(steps)
    both = BoxMotion(start[:, :2], start[:, 2], move[:, :2], move[:, 2], 0.5 * np.array(sizes))
    a, b = both.rows(np.array([0])), both.rows(np.array([1]))
    there = first_contact(a, b)
    np.testing.assert_allclose(first_contact(b, a), there, atol=2e-3)
    x, y, turn = motion
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    moved = BoxMotion(
        both.xy_m @ rotation.T + (x, y),
        both.yaw_rad + turn,
        both.move_m @ rotation.T,
        both.turn_rad,
        both.half_m,
    )
    rotated = first_contact(moved.rows(np.array([0])), moved.rows(np.array([1])))
    if np.isnan(there[0]) == np.isnan(rotated[0]):  # a touch within rounding may go either way
        np.testing.assert_allclose(rotated, there, atol=2e-3)
    else:
        fraction = np.nanmax(np.concatenate((there, rotated)))
        first, second = boxes(poses, sizes, float(fraction), steps)
        assert shapely.intersection(first, second).area < 1e-3


@settings(max_examples=60, deadline=None)
@given(st.tuples(pose, pose), st.tuples(step, step), st.tuples(size, size))
def test_the_quick_reject_never_hides_a_contact(poses, steps, sizes) -> None:
    start, move, box = np.array(poses), np.array(steps), np.array(sizes)
    motion = BoxMotion(start[:, :2], start[:, 2], move[:, :2], move[:, 2], 0.5 * box)
    slow = first_contact(motion.rows(np.array([0])), motion.rows(np.array([1])))[0]
    end = start + move
    quick = target_contact(start[:, :2], start[:, 2], end[:, :2], end[:, 2], box, 0)
    assert (quick is None) == bool(np.isnan(slow))
    if quick is not None:
        assert quick.fraction == pytest.approx(slow, abs=1e-9)
