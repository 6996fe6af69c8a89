"""Dubins pieces are compared with circles that were computed by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_maps import step

from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.convert.sources.arcline import drop_repeats, sample_path


def piece(start: list[float], shape: str, lengths: list[float], radius: float) -> dict[str, object]:
    return {"start_pose": start, "shape": shape, "segment_length": lengths, "radius": radius}


def test_quarter_circle_to_the_left() -> None:
    line = sample_path([piece([0.0, 0.0, 0.0], "LSR", [0.5 * math.pi * 10.0, 0.0, 0.0], 10.0)])
    np.testing.assert_allclose(line[-1], [10.0, 10.0], atol=1e-12)
    np.testing.assert_allclose(np.hypot(line[:, 0], line[:, 1] - 10.0), 10.0, atol=1e-12)
    middle = 0.5 * (line[1:] + line[:-1])
    assert (10.0 - np.hypot(middle[:, 0], middle[:, 1] - 10.0)).max() <= 0.002 + 1e-9


def test_straight_piece_has_no_points_between() -> None:
    line = sample_path([piece([1.0, 2.0, 0.5 * math.pi], "LSR", [0.0, 7.0, 0.0], 999.999)])
    np.testing.assert_allclose(line, [[1.0, 2.0], [1.0, 9.0]], atol=1e-12)


def test_micrometre_pieces_leave_no_repeated_point() -> None:
    tiny = piece([5.0, 0.0, 0.0], "LSR", [1e-6, 0.0, 1e-6], 999.999)
    line = sample_path([piece([0.0, 0.0, 0.0], "LSR", [0.0, 5.0, 0.0], 10.0), tiny])
    assert np.hypot(*np.diff(line, axis=0).T).min() > 0.001


@pytest.mark.parametrize(
    "pieces",
    [
        [],
        [{}],
        [piece([0.0, 0.0], "LSR", [1.0, 1.0, 1.0], 5.0)],
        [piece([0.0, 0.0, 0.0], "LXR", [1.0, 1.0, 1.0], 5.0)],
        [piece([0.0, 0.0, 0.0], "LSR", [1.0, -1.0, 1.0], 5.0)],
        [piece([0.0, 0.0, 0.0], "LSR", [1.0, 1.0, 1.0], 0.0)],
        [piece([math.nan, 0.0, 0.0], "LSR", [1.0, 1.0, 1.0], 5.0)],
    ],
)
def test_malformed_paths_are_refused(pieces: list[dict[str, object]]) -> None:
    with pytest.raises(ValueError, match=r"arc-line|pieces|finite"):
        sample_path(pieces)


@given(
    shape=st.text("LSR", min_size=3, max_size=3),
    lengths=st.lists(st.floats(0.0, 30.0), min_size=3, max_size=3).filter(lambda v: sum(v) > 0.01),
    radius=st.floats(2.0, 999.999),
    yaw=st.floats(-3.1, 3.1),
)
def test_length_and_end_agree_with_step_by_step_motion(
    shape: str, lengths: list[float], radius: float, yaw: float
) -> None:
    line = sample_path([piece([3.0, -2.0, yaw], shape, lengths, radius)])
    pose = (3.0, -2.0, yaw)
    for letter, length in zip(shape, lengths, strict=True):
        pose = step(pose, letter, length, radius)
    np.testing.assert_allclose(line[-1], pose[:2], atol=1e-3)
    assert line_length_m(line) == pytest.approx(sum(lengths), rel=2e-3, abs=5e-3)


def test_drop_repeats_keeps_both_ends() -> None:
    line = np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 0.0], [1.0004, 0.0]])
    np.testing.assert_array_equal(drop_repeats(line), [[0.0, 0.0], [1.0004, 0.0]])
