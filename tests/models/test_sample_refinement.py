"""Refinement of samples, for cars whose latents are their positions: overlaps are removed, all else stays."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import pytest
import torch
from torch import Tensor, nn

from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.diffusion.sample_refinement import (
    RefinementOptions,
    fixed_neighbours_decode,
    overlap_penalty,
    refine_samples,
)
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.codec import LatentCodec
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.traffic import TrafficModel

NOTHING = cast("Context", None)
EDGE = [(60.0 - 8.0 * k, 1.8) for k in range(6)]  # the road is to the right of it as one drives along


class Places:
    """Two numbers a car: how far from where it is now it stands in its one future instant."""

    shape = (1, 2)

    def raw(self, batch: SceneBatch, context: Context, generator: torch.Generator | None) -> Tensor:
        return torch.zeros(*batch.pose.shape[:2], 1, 2, dtype=batch.past.dtype)

    def decode(self, x: Tensor, context: Context, batch: SceneBatch) -> Rollout:
        xy = batch.pose[..., None, :2] + x
        flat = torch.zeros_like(xy[..., 0])
        return Rollout(xy, flat + batch.pose[..., None, 2], flat, flat, flat)


def test_cars_inside_each_other_part_and_the_third_stays(driving: Callable[..., SceneBatch]) -> None:
    """Two cars of 4 × 2 m, 5 m apart, were drawn 1 m apart; a third one is far away."""
    scene = driving([(0.0, 0.0, 0.0, 5.0), (5.0, 0.5, 0.0, 5.0), (40.0, 0.0, 0.0, 5.0)])
    drawn = torch.zeros(1, 3, 1, 2, dtype=torch.float64)
    drawn[0, 0, 0, 0] = 4.0
    how = RefinementOptions(steps=100)
    before = overlap_penalty(Places().decode(drawn, NOTHING, scene), scene, how)
    assert (before[0, :2] > 0.5).all()
    made = refine_samples(drawn, Places().decode, NOTHING, scene, how)
    after = overlap_penalty(Places().decode(made, NOTHING, scene), scene, how)
    assert float(after.max()) < 0.1
    xy = Places().decode(made, NOTHING, scene).xy[0, :, 0]
    apart = (xy[1] - xy[0]).abs()
    assert bool((apart > torch.tensor([4.0, 2.0])).any())
    assert torch.equal(made[0, 2], drawn[0, 2])


class Speeds:
    """One number a car: its speed; it drives straight on for four instants of half a second."""

    def decode(self, x: Tensor, context: Context, batch: SceneBatch) -> Rollout:
        speed = x[..., 0, 0, None].expand(-1, -1, 4)
        ahead = speed * 0.5 * torch.arange(1, 5, dtype=x.dtype)
        flat = torch.zeros_like(ahead)
        xy = batch.pose[..., None, :2] + torch.stack((ahead, flat), dim=-1)
        return Rollout(xy, flat, speed, flat, flat)


def test_who_was_drawn_through_a_standing_car_stays_behind_it(driving: Callable[..., SceneBatch]) -> None:
    """At 14 m/s it is 14 m ahead after two instants; a car stands at 10.5 m, which it overlaps at no instant."""
    scene = driving([(0.0, 0.0, 0.0, 14.0), (10.5, 0.0, 0.0, 0.0)])
    scene.parked[0, 1] = True
    drawn = torch.tensor([14.0, 0.0], dtype=torch.float64).reshape(1, 2, 1, 1)
    made = refine_samples(drawn, Speeds().decode, NOTHING, scene, RefinementOptions(steps=300, keep=0.0))
    assert float(Speeds().decode(made, NOTHING, scene).xy[0, 0, -1, 0]) < 10.5 - 4.0


def test_the_held_gradient_is_of_the_same_futures(
    driving: Callable[..., SceneBatch], options: ModelOptions, lively: Callable[[nn.Module], nn.Module]
) -> None:
    """Held decoding gives the network's futures; its gradient is the whole one where nobody hears anybody."""
    torch.manual_seed(3)
    model = cast("TrafficModel", lively(TrafficModel(options)).double().requires_grad_(False))
    codec, decoder = LatentCodec(options, model), FastDecoder(model.decoder)
    for cars in ([(0.0, 0.0, 0.0, 8.0)], [(0.0, 0.0, 0.0, 8.0), (12.0, 1.0, 0.3, 5.0)]):
        scene = driving(cars)
        context = model.encoder(scene)
        x = torch.randn(1, len(cars), 1, options.latent, dtype=torch.float64, requires_grad=True)
        whole, held = (
            codec.decode(x, context, scene),
            fixed_neighbours_decode(codec, decoder)(x, context, scene),
        )
        assert torch.allclose(held.xy, whole.xy, atol=1e-9)
        wanted, made = (torch.autograd.grad(r.xy.square().sum(), x)[0] for r in (whole, held))
        alike = torch.nn.functional.cosine_similarity(made.flatten(), wanted.flatten(), dim=0)
        assert float(alike) > (0.9999 if len(cars) == 1 else 0.8)


def test_cars_that_are_apart_keep_their_numbers_to_the_bit(driving: Callable[..., SceneBatch]) -> None:
    scene = driving([(0.0, 0.0, 0.0, 5.0), (6.0, 0.0, 0.0, 5.0)])
    drawn = torch.randn(1, 2, 1, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(1)) * 0.1
    assert torch.equal(refine_samples(drawn, Places().decode, NOTHING, scene), drawn)


@pytest.mark.parametrize("still", ["parked", "moved"])
def test_who_is_parked_or_not_ours_does_not_move(driving: Callable[..., SceneBatch], still: str) -> None:
    scene = driving([(0.0, 0.0, 0.0, 5.0), (3.0, 0.5, 0.0, 0.0)])
    getattr(scene, still)[0, 1] = still == "parked"
    made = refine_samples(torch.zeros(1, 2, 1, 2, dtype=torch.float64), Places().decode, NOTHING, scene)
    assert float(made[0, 1].abs().max()) == 0.0
    assert float(made[0, 0].abs().max()) > 0.1


def test_without_steps_or_without_weights_nothing_changes(driving: Callable[..., SceneBatch]) -> None:
    scene = driving([(0.0, 0.0, 0.0, 5.0), (3.0, 0.5, 0.0, 0.0)])
    drawn = torch.zeros(1, 2, 1, 2, dtype=torch.float64)
    for how in (RefinementOptions(steps=0), RefinementOptions(vehicles=0.0, road=0.0)):
        assert torch.equal(refine_samples(drawn, Places().decode, NOTHING, scene, how), drawn)


def test_who_was_drawn_off_the_road_comes_back(driving: Callable[..., SceneBatch]) -> None:
    """A car of 2 m beside an edge at 1.8 m to its left was drawn 2 m to the left."""
    scene = driving([(40.0, 0.0, 0.0, 5.0)], edges=[EDGE])
    drawn = torch.tensor([0.0, 2.0], dtype=torch.float64).reshape(1, 1, 1, 2)
    how = RefinementOptions(steps=150)
    assert float(overlap_penalty(Places().decode(drawn, NOTHING, scene), scene, how).max()) > 1.0
    made = refine_samples(drawn, Places().decode, NOTHING, scene, how)
    assert 0.3 < float(made[0, 0, 0, 1]) < 1.0  # its left side at the edge, no farther back than it has to
