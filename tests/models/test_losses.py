"""Penalties by hand: discs, overlaps, the road's edge, and their gradients."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.losses import (
    disc_pairs,
    discs,
    edge_clearance,
    off_road,
    pair_overlap,
    reconstruction,
)
from advdiff_sumo.models.road_edges import RoadEdges

Driving = Callable[..., SceneBatch]
CAR = (4.0, 2.0)
EVERYBODY = torch.ones(1, 2, dtype=torch.bool)


def rollout_of(poses: Tensor) -> Rollout:
    """Return (1, A, 1) states from poses (A, 3) or (A, 4)."""
    poses = poses[None, :, None]
    speed = poses[..., 3] if poses.shape[-1] > 3 else torch.zeros_like(poses[..., 0])
    still = torch.zeros_like(speed)
    return Rollout(poses[..., :2], poses[..., 2], speed, still, still)


def sizes(agents: int = 2) -> Tensor:
    return torch.tensor(CAR, dtype=torch.float64).expand(1, agents, 2)


def poses(*rows: tuple[float, ...]) -> Tensor:
    return torch.tensor(rows, dtype=torch.float64)


def line(start: tuple[float, float], end: tuple[float, float]) -> list[tuple[float, float]]:
    """Return six points from *start* to *end*."""
    return [tuple((a + (b - a) * k / 5) for a, b in zip(start, end, strict=True)) for k in range(6)]  # type: ignore[misc] # two numbers


def test_five_discs_by_hand() -> None:
    """A 6 × 2 m box: radius 1, centres 2 m to both sides of the middle, 1 m apart; here looking north."""
    north = torch.tensor([math.pi / 2]).double()
    centres, radius = discs(poses((3.0, 1.0)), north, poses((6.0, 2.0)))
    assert float(radius) == 1.0
    wanted = poses(*((3.0, 1.0 + d) for d in (-2.0, -1.0, 0.0, 1.0, 2.0)))
    torch.testing.assert_close(centres[0], wanted)


def test_discs_of_what_is_wider_than_long_lie_in_the_middle() -> None:
    centres, radius = discs(poses((1.0, 2.0)), torch.zeros(1).double(), poses((0.5, 0.8)))
    assert float(radius) == pytest.approx(0.4)
    torch.testing.assert_close(centres[0], poses((1.0, 2.0)).expand(5, 2))


@pytest.mark.parametrize(
    ("other", "distance"),
    [
        ((0.0, 1.0, 0.0), 1.0),  # side by side: discs 1 m apart
        ((3.0, 0.0, 0.0), 1.0),  # one behind the other: 1 m from the nose disc to the tail disc
        ((4.0, 0.0, math.pi), 2.0),  # nose to nose, boxes just touching
        ((0.0, 2.0, 0.0), 2.0),
        ((1.0, 1.8, math.pi / 2), 0.8),  # across: its tail disc (1, 0.8) above the nose disc (1, 0)
    ],
)
def test_overlap_by_hand(other: tuple[float, float, float], distance: float) -> None:
    rollout = rollout_of(poses((0.0, 0.0, 0.0), other))
    squared, reach = disc_pairs(rollout, sizes())
    assert float(squared[0, 0, 1, 0].min().sqrt()) == pytest.approx(distance, abs=1e-6)
    assert float(reach[0, 0, 1, 0]) == 2.0
    overlap = pair_overlap(rollout, sizes(), EVERYBODY)
    assert overlap.shape == (1, 2, 2, 1)
    assert float(overlap[0, 0, 1, 0]) == pytest.approx(1.0 - distance / 2.0, abs=1e-6)
    assert float(overlap[0, 1, 0, 0]) == float(overlap[0, 0, 1, 0])
    assert float(overlap[0, 0, 0, 0]) == float(overlap[0, 1, 1, 0]) == 0.0  # nobody meets itself


POSE = st.tuples(st.floats(-8.0, 8.0), st.floats(-8.0, 8.0), st.floats(-math.pi, math.pi))


@settings(max_examples=60, deadline=None)
@given(POSE)
def test_overlap_is_zero_exactly_when_discs_are_apart(other: tuple[float, float, float]) -> None:
    pair = poses((0.0, 0.0, 0.0), other)
    centres, radius = discs(pair[:, :2], pair[:, 2], sizes()[0])
    nearest = float(torch.cdist(centres[0], centres[1]).min())
    reach = float(radius.sum())
    if abs(nearest - reach) < 1e-6:
        return  # just touching: rounding decides
    overlap = float(pair_overlap(rollout_of(pair), sizes(), EVERYBODY)[0, 0, 1, 0])
    assert (overlap == 0.0) is (nearest > reach)
    assert 0.0 <= overlap <= 1.0


@settings(max_examples=60, deadline=None)
@given(POSE)
def test_the_gradient_pushes_vehicles_apart(other: tuple[float, float, float]) -> None:
    pair = poses((0.0, 0.0, 0.0), other).requires_grad_()
    overlap = pair_overlap(rollout_of(pair), sizes(), EVERYBODY)[0, 0, 1, 0]
    (grad,) = torch.autograd.grad(overlap, pair)
    assert bool(torch.isfinite(grad).all())
    torch.testing.assert_close(grad[0, :2], -grad[1, :2])
    if not 0.0 < float(overlap.detach()) < 0.8:
        return  # deeper, a disc lies between two of the other vehicle, and the nearer one decides
    moved = pair.detach() - 1e-3 * grad / grad[:, :2].norm(dim=-1).max()
    less = float(pair_overlap(rollout_of(moved), sizes(), EVERYBODY)[0, 0, 1, 0])
    assert less < float(overlap.detach())


def test_the_gradient_by_hand() -> None:
    """Side by side 1 m apart: the other shall go left, at 1 / (r + r) a metre."""
    pair = poses((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)).requires_grad_()
    (grad,) = torch.autograd.grad(pair_overlap(rollout_of(pair), sizes(), EVERYBODY)[0, 0, 1, 0], pair)
    torch.testing.assert_close(grad[1, :2], torch.tensor([0.0, -0.5]).double(), atol=1e-8, rtol=0.0)


def test_absent_agents_meet_nobody() -> None:
    rollout = rollout_of(poses((0.0, 0.0, 0.0), (0.5, 0.0, 0.0)))
    assert not bool(pair_overlap(rollout, sizes(), torch.tensor([[True, False]])).any())


def test_one_in_the_place_of_another_has_a_gradient_of_numbers() -> None:
    pair = poses((0.0, 0.0, 0.3), (0.0, 0.0, 0.3)).requires_grad_()
    overlap = pair_overlap(rollout_of(pair), sizes(), EVERYBODY)
    assert float(overlap.detach()[0, 0, 1, 0]) == pytest.approx(1.0, abs=1e-4)
    (grad,) = torch.autograd.grad(overlap.sum(), pair)
    assert bool(torch.isfinite(grad).all())


def test_overlap_gradient_against_differences() -> None:
    pair = poses((0.0, 0.0, 0.1), (2.3, 0.9, 0.8), (-1.2, 1.4, -2.0), (30.0, 0.0, 0.0)).requires_grad_()
    there = torch.ones(1, 4, dtype=torch.bool)
    assert torch.autograd.gradcheck(lambda p: pair_overlap(rollout_of(p), sizes(4), there), (pair,))


RIGHT_EDGE = line((-30.0, -4.0), (30.0, -4.0))  # eastwards: the road is north of it
LEFT_EDGE = line((30.0, 4.0), (-30.0, 4.0))


def points(*rows: tuple[float, float]) -> Tensor:
    return torch.tensor(rows, dtype=torch.float64)[None, None]


def test_clearance_by_hand(driving: Driving) -> None:
    """A road between y = −4 and 4, seen by a car at (2, 1) that looks north-west."""
    scene = driving([(2.0, 1.0, 2.5, 0.0)], edges=[RIGHT_EDGE, LEFT_EDGE])
    asked = points((0.0, 0.0), (5.0, 3.0), (5.0, -3.5), (0.0, 6.0), (0.0, -4.5))
    made = edge_clearance(asked, scene)
    wanted = torch.tensor([4.0, 1.0, 0.5, -2.0, -0.5], dtype=torch.float64)
    torch.testing.assert_close(made[0, 0], wanted, atol=1e-6, rtol=0.0)


def test_clearance_in_the_own_frame(driving: Driving) -> None:
    scene = driving([(2.0, 1.0, math.pi / 2, 0.0)], edges=[RIGHT_EDGE])
    made = RoadEdges.of(scene).clearance(points((0.0, 0.0), (-6.0, 3.0)))  # (2, 1) and (−1, −5) in the scene
    torch.testing.assert_close(made[0, 0], torch.tensor([5.0, -1.0]).double(), atol=1e-6, rtol=0.0)


def test_without_an_edge_everything_is_road(driving: Driving) -> None:
    """Lanes are no edges, whichever side of them a point is on."""
    asked = points((0.0, 0.0), (0.0, 9.0), (3.0, -9.0))
    for scene in (
        driving([(0.0, 0.0, 0.0, 0.0)]),
        driving([(0.0, 0.0, 0.0, 0.0)], lanes=[RIGHT_EDGE, LEFT_EDGE]),
    ):
        assert bool((edge_clearance(asked, scene) > 100.0).all())
        car = rollout_of(
            poses(
                (0.0, 5.0, 0.0),
            )
        )
        assert not bool(off_road(car, scene).any())


def test_lanes_and_absent_pieces_are_no_edges(driving: Driving) -> None:
    scene = driving(
        [(0.0, 0.0, 0.0, 0.0)], lanes=[line((-30.0, 1.0), (30.0, 1.0))], edges=[RIGHT_EDGE, LEFT_EDGE]
    )
    absent = scene.map_valid.clone()
    absent[..., 1] = False
    asked = points((0.0, 0.5))
    assert float(edge_clearance(asked, scene)) == pytest.approx(3.5)
    assert float(edge_clearance(points((0.0, -3.0)), replace(scene, map_valid=absent))) == pytest.approx(7.0)


NOSE = math.tan(0.15)
"""An island from the east whose tip, an acute corner at the origin, points west; the road is around it."""
ISLAND = [line((40.0, -40.0 * NOSE), (0.0, 0.0)), line((0.0, 0.0), (40.0, 40.0 * NOSE))]


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize(
    ("point", "wanted"),
    [
        ((-3.0, 0.0), 3.0),
        ((-3.0, 1.0), math.hypot(3.0, 1.0)),  # beyond the line of one side, yet ahead of the tip: on the road
        ((-3.0, -1.0), math.hypot(3.0, 1.0)),
        ((20.0, 0.5), -(20.0 * math.sin(0.15) - 0.5 * math.cos(0.15))),
        ((20.0, 5.0), 5.0 * math.cos(0.15) - 20.0 * math.sin(0.15)),
    ],
)
def test_the_tip_of_an_island(
    driving: Driving, point: tuple[float, float], wanted: float, swapped: bool
) -> None:
    edges = ISLAND[::-1] if swapped else ISLAND
    scene = driving([(-10.0, 0.0, 0.0, 5.0)], edges=edges)
    assert float(edge_clearance(points(point), scene)) == pytest.approx(wanted, abs=1e-4)


def test_off_road_by_hand(driving: Driving) -> None:
    """A 4 × 2 m car along the road: at y = −3 its discs touch the edge; at −3.5 they are 0.5 m over, a quarter."""
    scene = driving([(0.0, 0.0, 0.0, 0.0)], edges=[RIGHT_EDGE, LEFT_EDGE])
    for y, wanted in ((0.0, 0.0), (-2.9, 0.0), (-3.5, 0.25), (3.5, 0.25), (-5.0, 1.0), (-12.0, 2.0)):
        made = off_road(rollout_of(poses((0.0, y, 0.0))), scene)
        assert made.shape == (1, 1, 1)
        assert float(made) == pytest.approx(wanted, abs=1e-6), y
    across = off_road(rollout_of(poses((0.0, -2.5, math.pi / 2))), scene)  # its tail disc at −3.5
    assert float(across) == pytest.approx(0.25, abs=1e-6)


@settings(max_examples=60, deadline=None)
@given(st.floats(-20.0, 20.0), st.floats(-2.9, 2.9))
def test_nothing_is_off_road_within_the_road(driving: Driving, x: float, y: float) -> None:
    scene = driving([(0.0, 0.0, 0.0, 0.0)], edges=[RIGHT_EDGE, LEFT_EDGE])
    assert not bool(off_road(rollout_of(poses((x, y, 0.0))), scene).any())


def test_walkers_may_leave_the_road(driving: Driving) -> None:
    scene = driving([(0.0, 0.0, 0.0, 0.0)], edges=[RIGHT_EDGE])
    walker = replace(scene, moved=torch.zeros_like(scene.moved))
    assert not bool(off_road(rollout_of(poses((0.0, -9.0, 0.0))), walker).any())


def test_off_road_gradient_against_differences_and_towards_the_road(driving: Driving) -> None:
    scene = driving([(0.0, 0.0, 0.4, 0.0)], edges=[RIGHT_EDGE, LEFT_EDGE])
    pose = poses((1.0, -3.7, 0.2)).requires_grad_()
    assert torch.autograd.gradcheck(lambda p: off_road(rollout_of(p), scene), (pose,))
    (grad,) = torch.autograd.grad(off_road(rollout_of(pose), scene).sum(), pose)
    assert float(grad[0, 1]) == pytest.approx(-0.5, abs=1e-6)  # 1 / (2 r) a metre: north is better
    assert float(grad[0, 0]) == pytest.approx(0.0, abs=1e-6)


def test_a_point_on_the_edge_has_a_gradient_of_numbers(driving: Driving) -> None:
    degenerate = [(5.0, -4.0)] * 6  # a piece without length
    scene = driving([(0.0, 0.0, 0.0, 0.0)], edges=[RIGHT_EDGE, degenerate])
    asked = points((0.0, -4.0), (5.0, -4.0)).requires_grad_()
    (grad,) = torch.autograd.grad(edge_clearance(asked, scene).sum(), asked)
    assert bool(torch.isfinite(grad).all())


def known(scene: SceneBatch, future: Tensor) -> SceneBatch:
    """Return *scene* with one known instant of future (A, 4)."""
    valid = torch.ones(1, len(future), 1, dtype=torch.bool)
    return replace(scene, future=future[None, :, None], future_valid=valid)


def test_reconstruction_by_hand(driving: Driving) -> None:
    """0.4 m further, 0.1 m to the left, 0.04 rad and 2 m/s off, where the truth looks north.

    Huber: ½ 0.4² + ½ (5 · 0.1)² + ½ (5 · 0.04)² + 0.5 (2 − ½).
    """
    scene = known(driving([(0.0, 0.0, 0.0, 0.0)]), poses((1.0, 2.0, math.pi / 2, 3.0)))
    guess = poses((0.9, 2.4, math.pi / 2 + 0.04 - 2.0 * math.pi, 5.0))
    made = reconstruction(rollout_of(guess), scene)
    assert made.shape == (1, 1, 1)
    assert float(made) == pytest.approx(0.08 + 0.125 + 0.02 + 0.75)


def test_reconstruction_is_zero_for_the_truth_and_where_it_is_unknown(driving: Driving) -> None:
    truth = poses((1.0, 2.0, 0.5, 3.0), (4.0, 5.0, 1.0, 2.0), (7.0, 1.0, -1.0, 0.0))
    scene = known(driving([(0.0, 0.0, 0.0, 0.0)] * 3), truth)
    assert not bool(reconstruction(rollout_of(truth), scene).any())
    scene.future_valid[0, 1] = False
    scene.moved[0, 2] = False
    assert (reconstruction(rollout_of(truth + 1.0), scene) > 0.0).flatten().tolist() == [True, False, False]


def test_reconstruction_gradient_against_differences(driving: Driving) -> None:
    truth = poses((1.0, 2.0, 0.5, 3.0), (4.0, 5.0, 1.0, 2.0))
    scene = known(driving([(0.0, 0.0, 0.0, 0.0)] * 2), truth)
    guess = (truth + poses((0.3, -0.2, 0.1, 0.4), (5.0, -3.0, 1.0, -4.0))).requires_grad_()
    assert torch.autograd.gradcheck(lambda g: reconstruction(rollout_of(g), scene), (guess,))


def test_padding_without_a_size_leaves_gradients_finite() -> None:
    xy = torch.zeros(1, 3, 2, 2, requires_grad=True)
    still = torch.zeros(1, 3, 2)
    size = torch.tensor([[[4.0, 2.0], [0.0, 0.0], [0.0, 0.0]]])
    rollout = Rollout(xy, still, still, still, still)
    present = torch.tensor([[True, False, False]])
    overlap = pair_overlap(rollout, size, present)
    assert float(overlap.detach().abs().max()) == 0.0
    overlap.sum().backward()
    assert xy.grad is not None
    assert bool(torch.isfinite(xy.grad).all())
