"""Distances of bodies: the fast functions give the same as a comparison of all discs."""

from __future__ import annotations

import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from advdiff_sumo.traffic.baselines.disc_gaps import Bodies, depths, gaps

SIZE = torch.tensor([4.6, 1.8])
ALL = slice(None)


def bodies(seed: int, spread_m: float, *shape: int) -> Bodies:
    draw = torch.Generator().manual_seed(seed)
    xy = spread_m * torch.randn(*shape, 2, generator=draw)
    size = SIZE * (0.2 + torch.rand(*shape, 2, generator=draw))
    return Bodies.of(xy, 3.0 * torch.randn(*shape, generator=draw), size)


def exhaustive(mine: Bodies, yours: Bodies) -> Tensor:
    """Return the smallest distance between the discs of each pair of bodies."""
    delta = mine.centres[..., :, None, :] - yours.centres[..., None, :, :]
    near = delta.square().sum(-1).flatten(-2).amin(-1)
    return torch.sqrt(near + 1e-9) - mine.radius - yours.radius


def test_gaps_by_hand() -> None:
    """Two boxes of 4.6 m in line with centres 10 m apart have a gap of 5.4 m; at 4 m they overlap by 0.6 m."""
    first = Bodies.of(torch.zeros(1, 2), torch.zeros(1), SIZE)
    second = Bodies.of(torch.tensor([[10.0, 0.0], [4.0, 0.0]]), torch.zeros(2), SIZE)
    assert torch.allclose(gaps(first, second), torch.tensor([5.4, -0.6]), atol=1e-4)
    assert torch.allclose(depths(first, second), torch.tensor([0.0, 0.6]), atol=1e-4)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), spread=st.sampled_from([1.0, 4.0, 12.0, 60.0]))
def test_the_fast_comparison_equals_the_exhaustive_one(seed: int, spread: float) -> None:
    mine, yours = bodies(seed, spread, 4, 2, 6), bodies(seed + 1, spread, 5, 6)
    every = mine.at(ALL, ALL, None)
    assert torch.equal(gaps(every, yours), exhaustive(every, yours))
    assert torch.equal(depths(every, yours), (-exhaustive(every, yours)).clamp(min=0.0))
    assert torch.equal(depths(mine.at(ALL, 0), mine.at(ALL, 1)), depths(mine, mine.at(ALL, [1, 0]))[:, 0])


def test_bodies_at_nan_do_not_count_as_far() -> None:
    lost = Bodies.of(torch.full((1, 2), torch.nan), torch.zeros(1), SIZE)
    assert bool(depths(lost, bodies(0, 5.0, 1)).isnan().all())
    assert bool(depths(bodies(0, 5.0, 1), lost).isnan().all())
