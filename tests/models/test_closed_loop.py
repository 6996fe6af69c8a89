"""The closed-loop decoder: what it sees, worked out by hand, and what it owes to the decoder that it grows from."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import cast

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor, nn

from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.closed_loop_decoder import ClosedLoopDecoder
from advdiff_sumo.models.decoder import Decoder
from advdiff_sumo.models.lane_attention import NEAREST, LanePieces, closest
from advdiff_sumo.models.losses import discs
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.neighbours import Neighbours, nearest_agents
from advdiff_sumo.models.proximity import (
    EXTRAPOLATION_S,
    box_clearance,
    extrapolated_gaps,
    lead_gaps,
    pair_features,
)
from advdiff_sumo.models.road_edges import RoadEdges

Stir = Callable[[nn.Module], nn.Module]
SIZE = torch.tensor([[[4.0, 2.0], [4.0, 2.0]]])


@pytest.fixture
def decoders(options: ModelOptions, lively: Stir) -> tuple[Decoder, ClosedLoopDecoder]:
    """Return an open decoder and a closed-loop one with its weights and nothing learned yet."""
    torch.manual_seed(0)
    opened = cast(Decoder, lively(Decoder(options)))
    closed = ClosedLoopDecoder(options)
    lacking = closed.load_state_dict(opened.state_dict(), strict=False)
    assert not lacking.unexpected_keys
    return opened, closed


def given_latents(batch: SceneBatch, options: ModelOptions) -> tuple[Tensor, Tensor]:
    """Return z (B, A, Z) and h (B, A, D), 0 for padding."""
    generator = torch.Generator().manual_seed(1)
    z = torch.randn(batch.scenes, batch.agents, options.latent, generator=generator)
    h = torch.randn(batch.scenes, batch.agents, options.hidden, generator=generator)
    return z, h * batch.present[..., None]


def test_it_begins_as_the_open_decoder(
    decoders: tuple[Decoder, ClosedLoopDecoder], batch: SceneBatch, options: ModelOptions
) -> None:
    opened, closed = decoders
    with torch.no_grad():
        wanted, made = (decoder(*given_latents(batch, options), batch) for decoder in (opened, closed))
    torch.testing.assert_close(made.states(), wanted.states())


def test_every_weight_that_it_adds_learns(options: ModelOptions, lively: Stir, batch: SceneBatch) -> None:
    torch.manual_seed(0)
    decoder = cast(ClosedLoopDecoder, lively(ClosedLoopDecoder(options)))
    rollout = decoder(*given_latents(batch, options), batch)
    grads = torch.autograd.grad(rollout.states().square().mean(), list(decoder.parameters()))
    assert all(bool(torch.isfinite(g).all()) for g in grads)
    silent = [n for (n, _), g in zip(decoder.named_parameters(), grads, strict=True) if not g.any()]
    assert silent == []


def test_some_rows_are_those_of_the_whole_and_the_only_ones_that_move(
    options: ModelOptions, lively: Stir, batch: SceneBatch
) -> None:
    torch.manual_seed(0)
    decoder = FastDecoder(cast(ClosedLoopDecoder, lively(ClosedLoopDecoder(options)).requires_grad_(False)))
    z, h = given_latents(batch, options)
    rows = torch.tensor([3, 1])
    whole, trace = decoder.whole(z, h, batch, 6)
    own = z[:, rows].clone().requires_grad_()
    some = decoder.some(own, h, batch, rows, 6, trace)
    torch.testing.assert_close(some.states(), whole.states()[:, rows], atol=1e-5, rtol=1e-5)
    (slope,) = torch.autograd.grad(some.xy.sum(), own)
    assert bool(slope.any())
    assert bool(torch.isfinite(slope).all())


@pytest.mark.parametrize(
    ("x", "speed", "gaps"),
    [
        (10.0, (0.0, 0.0), [6.0] * 5),  # 10 m apart, 2 m of each box between
        (30.0, (10.0, 0.0), [26.0, 21.0, 16.0, 11.0, 1.0]),  # comes 10 m nearer each second
        (30.0, (10.0, 10.0), [26.0] * 5),
    ],
)
def test_gaps_of_boxes_in_line(x: float, speed: tuple[float, float], gaps: list[float]) -> None:
    xy, yaw = torch.tensor([[[0.0, 0.0], [x, 0.0]]]), torch.zeros(1, 2)
    made = extrapolated_gaps(Neighbours.of(xy, yaw, torch.tensor([speed]), SIZE, torch.tensor([0])))
    assert made.shape == (len(EXTRAPOLATION_S), 1, 1, 2)
    assert made[:, 0, 0, 1].tolist() == pytest.approx(gaps, abs=1e-3)


@settings(max_examples=40, deadline=None)
@given(st.floats(-15.0, 15.0), st.floats(-15.0, 15.0), st.floats(-math.pi, math.pi), st.floats(0.0, 20.0))
def test_gaps_are_alike_from_both_sides(x: float, y: float, yaw: float, speed: float) -> None:
    xy, turn = torch.tensor([[[0.0, 0.0], [x, y]]]), torch.tensor([[0.3, yaw]])
    made = extrapolated_gaps(Neighbours.of(xy, turn, torch.tensor([[speed, 5.0]]), SIZE, torch.arange(2)))
    torch.testing.assert_close(made[:, 0, 0, 1], made[:, 0, 1, 0], atol=1e-3, rtol=1e-4)


def test_who_drives_ahead_in_the_corridor() -> None:
    """A follower at 10 m/s, a leader at 4 m/s with 16 m between, one beside, one behind."""
    xy = torch.tensor([[[0.0, 0.0], [20.0, 0.0], [10.0, 8.0], [-12.0, 0.0]]])
    speed, size = torch.tensor([[10.0, 4.0, 4.0, 4.0]]), torch.tensor([4.0, 2.0]).expand(1, 4, 2)
    near = Neighbours.of(xy, torch.zeros(1, 4), speed, size, torch.tensor([0]))
    lead = lead_gaps(near)
    assert float(lead.gap_m[0, 0, 1]) == pytest.approx(16.0)
    assert float(lead.closing_mps[0, 0, 1]) == pytest.approx(6.0)
    assert lead.inside[0, 0].tolist() == pytest.approx([0.0, 1.0, 0.0, 0.0], abs=2e-3)
    headway, brake = (column[0, 0, 1] for column in pair_features(near)[-2:])
    assert float(headway) == pytest.approx(math.exp(-1.6), abs=2e-3)
    assert float(brake) == pytest.approx(36.0 / 32.0 / 8.0, abs=1e-3)


def test_clearance_of_both_sides_of_a_box() -> None:
    """Boxes 2 m wide on a road 6 m wide: in its middle, 0.5 m from its left edge, and half beyond that."""
    first, last = (torch.tensor([[[[x, -3.0], [-x, 3.0]]]]).expand(1, 3, 2, 2) for x in (-50.0, 50.0))
    edges = RoadEdges.between(first, last, torch.ones(1, 3, 2, dtype=torch.bool))
    place, turn = torch.tensor([[[0.0, 0.0], [5.0, 1.5], [0.0, 3.0]]]), torch.zeros(1, 3)
    made = 5.0 * box_clearance(place, turn, torch.tensor([4.0, 2.0]).expand(1, 3, 2), edges)
    left, right = made[0].unflatten(-1, (2, 5)).unbind(1)  # type: ignore[no-untyped-call] # torch's
    assert left[:, 0].tolist() == pytest.approx([2.0, 0.5, -1.0], abs=1e-3)
    assert right[:, 4].tolist() == pytest.approx([2.0, 2.5, 1.0], abs=1e-3)


def test_where_a_lane_lies() -> None:
    """Straight ahead, 1 m to the right of the vehicle; then crossing from right to left 5 m ahead of it."""
    straight = torch.tensor([[-4.0, -1.0], [4.0, -1.0], [8.0, -1.0]])
    across = torch.tensor([[5.0, -4.0], [5.0, 4.0], [5.0, 8.0]])
    made = closest(torch.stack((straight, across)))
    assert made[0].tolist() == pytest.approx([0.2, 0.2, 1.0, 0.0], abs=1e-4)  # it is to the lane's left
    assert made[1].tolist() == pytest.approx([1.0, 1.0, 0.0, 1.0], abs=1e-4)


def test_lane_pieces_are_those_that_are_near_where_the_vehicle_is() -> None:
    """Pieces every 20 m along the road; who has driven 100 m sees those around 100 m, and more of what is coming."""
    begin = 20.0 * torch.arange(-10.0, 18.0)
    x = begin[:, None] + torch.linspace(0.0, 20.0, 6)
    xy = torch.stack((x, torch.zeros_like(x)), dim=-1)[None, None]
    valid = torch.ones(1, 1, 28, dtype=torch.bool)
    features = begin[None, None, :, None].expand(1, 1, 28, 13)
    seen = LanePieces(xy, features, valid).seen_from(torch.tensor([[[100.0, 0.0]]]), torch.zeros(1, 1))
    assert seen.xy.shape == (1, 1, NEAREST, 6, 2)
    assert sorted(seen.features[0, 0, :, 0].tolist()) == [40.0 + 20.0 * k for k in range(9)]
    torch.testing.assert_close(seen.xy[0, 0, :, 0, 0], seen.features[0, 0, :, 0] - 100.0)


def test_gaps_are_those_of_the_nearest_discs() -> None:
    """All 25 pairs of disc centres, worked out one by one at each of the instants."""
    generator = torch.Generator().manual_seed(4)
    xy = 10.0 * torch.rand(1, 6, 2, generator=generator, dtype=torch.float64)
    yaw, speed = (f * torch.rand(1, 6, generator=generator, dtype=torch.float64) for f in (6.0, 15.0))
    size = torch.tensor([[[4.5, 2.0], [12.0, 2.5], [2.2, 0.8], [4.5, 2.0], [0.6, 0.6], [8.0, 2.3]]]).double()
    made = extrapolated_gaps(Neighbours.of(xy, yaw, speed, size, torch.arange(6)))
    for k, after in enumerate(EXTRAPOLATION_S):
        ahead = torch.stack((torch.cos(yaw), torch.sin(yaw)), dim=-1)
        centres, radius = discs(xy + after * speed[..., None] * ahead, yaw, size)
        apart = torch.cdist(centres[0].flatten(0, 1), centres[0].flatten(0, 1)).reshape(6, 5, 6, 5)
        wanted = torch.sqrt(apart.amin((1, 3)).square() + 1e-6) - radius[0][:, None] - radius[0]
        torch.testing.assert_close(made[k, 0], wanted, atol=1e-6, rtol=0.0)


def test_neighbours_are_the_nearest_who_are_there() -> None:
    xy = torch.tensor([[[0.0, 0.0], [9.0, 0.0], [1.0, 0.0], [0.0, 3.0], [0.0, -5.0]]])
    present = torch.tensor([[True, True, False, True, True]])
    which = nearest_agents(xy, present, torch.tensor([0, 1]), 3)
    assert which is not None
    assert which[0, 0].tolist() == [0, 3, 4]
    assert which[0, 1].tolist() == [1, 0, 3]
    near = Neighbours.of(
        xy, torch.zeros(1, 5), torch.ones(1, 5), torch.ones(1, 5, 2), torch.tensor([0, 1]), which
    )
    assert near.oneself[0, 0].tolist() == [True, False, False]
    assert near.left_m[0, 0].tolist() == [0.0, 3.0, -5.0]
    assert near.among(xy)[0, 1].tolist() == xy[0, which[0, 1]].tolist()
    assert nearest_agents(xy, present, torch.tensor([0, 1]), 5) is None


def test_as_many_neighbours_as_agents_are_all_of_them(
    options: ModelOptions, lively: Stir, batch: SceneBatch
) -> None:
    torch.manual_seed(0)
    decoder = cast(ClosedLoopDecoder, lively(ClosedLoopDecoder(options)).requires_grad_(False))
    given = given_latents(batch, options)
    everybody = decoder(*given, batch).states()
    few = ClosedLoopDecoder(options.model_copy(update={"neighbours": batch.agents - 1}))
    few.load_state_dict(decoder.state_dict())
    with torch.no_grad():
        made = few(*given, batch).states()
    lonely = batch.present.sum(1) < batch.agents  # who is absent is left out first
    assert bool(lonely.any())
    torch.testing.assert_close(made[lonely], everybody[lonely])
