"""Frames and relative poses by hand."""

from __future__ import annotations

import math

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from advdiff_sumo.models.geometry import RELATIVE_FEATURES, into_frame, relative_features, rotate, wrap_angle

NORTH = math.pi / 2


def test_wrap_angle_by_hand() -> None:
    angle = torch.tensor([0.0, 3 * math.pi / 2, -3 * math.pi / 2, 4 * math.pi + 0.1], dtype=torch.float64)
    torch.testing.assert_close(
        wrap_angle(angle), torch.tensor([0.0, -NORTH, NORTH, 0.1], dtype=torch.float64)
    )


def test_a_point_ahead_on_the_left() -> None:
    """From (2, 1) looking north, (1, 4) is 3 m ahead and 1 m to the left."""
    seen = into_frame(torch.tensor([1.0, 4.0]), torch.tensor([2.0, 1.0]), torch.tensor(NORTH))
    torch.testing.assert_close(seen, torch.tensor([3.0, 1.0]))


@settings(max_examples=60, deadline=None)
@given(st.floats(-50, 50), st.floats(-50, 50), st.floats(-7, 7))
def test_turning_there_and_back(x: float, y: float, yaw: float) -> None:
    xy, angle = torch.tensor([x, y], dtype=torch.float64), torch.tensor(yaw, dtype=torch.float64)
    turned = rotate(xy, angle)
    torch.testing.assert_close(rotate(turned, -angle), xy)
    torch.testing.assert_close(turned.norm(), xy.norm())


def test_relative_features_by_hand() -> None:
    """0 at the origin looks north at 5 m/s; 1 at (−4, 3) drives west at 10 m/s: 3 ahead, 4 left, turned +90°."""
    xy = torch.tensor([[[0.0, 0.0], [-4.0, 3.0]]])
    seen = relative_features(xy, torch.tensor([[NORTH, math.pi]]), torch.tensor([[5.0, 10.0]]))
    assert seen.shape == (1, 2, 2, RELATIVE_FEATURES)
    wanted = [0.15, 0.2, math.exp(-0.5), 0.0, 1.0, 0.0, 1.0, -0.5, 0.5]
    torch.testing.assert_close(seen[0, 0, 1], torch.tensor(wanted), atol=1e-6, rtol=0.0)
    # seen from 1, which looks west: 0 is 4 m behind (east) and 3 m to the left (south), turned −90°
    back = [-0.2, 0.15, math.exp(-0.5), 0.0, -1.0, 0.0, -0.5, -1.0, 1.0]
    torch.testing.assert_close(seen[0, 1, 0], torch.tensor(back), atol=1e-6, rtol=0.0)
    own = [0.0, 0.0, 1.0, 1.0, 0.0, 0.5, 0.0, 0.0, 0.5]
    torch.testing.assert_close(seen[0, 0, 0], torch.tensor(own), atol=2e-4, rtol=0.0)


def test_gradients_of_coinciding_agents_are_numbers() -> None:
    xy = torch.zeros(1, 3, 2, requires_grad=True)
    yaw, speed = torch.zeros(1, 3, requires_grad=True), torch.zeros(1, 3, requires_grad=True)
    relative_features(xy, yaw, speed).square().sum().backward()  # type: ignore[no-untyped-call] # torch's own
    for leaf in (xy, yaw, speed):
        assert leaf.grad is not None
        assert bool(torch.isfinite(leaf.grad).all())
