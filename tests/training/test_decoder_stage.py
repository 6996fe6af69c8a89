"""Stage "decoder": what it pays for, what stays as it is, and that it learns to keep vehicles apart."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.training.decoder_stage import DecoderStage
from advdiff_sumo.training.displacement import logged_rollout
from advdiff_sumo.training.driving_penalties import following_penalty, lane_distance, travelled_m
from advdiff_sumo.training.presets import DecoderOptions
from advdiff_sumo.training.setup import with_closed_loop
from advdiff_sumo.training.stage import Moment, means


def moment(step: int = 0) -> Moment:
    return Moment(step, 10, torch.Generator().manual_seed(step))


def stage_of(bundle: Bundle, options: DecoderOptions | None = None) -> DecoderStage:
    return DecoderStage(with_closed_loop(bundle, 3), bundle.traffic.decoder, options or DecoderOptions())


def in_line(batch: SceneBatch, speed: tuple[float, float], gap_m: float) -> tuple[Rollout, SceneBatch]:
    """Return the first scene with two cars of 4 m along x, *gap_m* apart, the slower-numbered one behind."""
    one = batch.rows(slice(0, 1)).rows_of(torch.arange(2))
    there = torch.ones(1, 2, dtype=torch.bool)
    size = torch.tensor([[[4.0, 2.0], [4.0, 2.0]]])
    xy = torch.tensor([[0.0, 0.0], [4.0 + gap_m, 0.0]])[None, :, None].expand(1, 2, 12, 2)
    fast = torch.tensor(speed)[None, :, None].expand(1, 2, 12)
    nothing = torch.zeros(1, 2, 12)
    return Rollout(xy, nothing, fast, nothing, nothing), replace(one, present=there, moved=there, size=size)


@pytest.mark.parametrize(
    ("speed", "gap_m", "wanted"),
    [
        ((10.0, 10.0), 2.0, 1.0 - 2.0 / 6.5),  # 0.5 m and 0.6 s make 6.5 m
        ((10.0, 10.0), 6.5, 0.0),
        ((10.0, 0.0), 10.0, 0.25),  # 100 / 20 = 5 m/s² is a quarter more than 4
        ((10.0, 0.0), 12.5, 0.0),
        ((0.0, 0.0), 0.25, 0.5),
    ],
)
def test_following_by_hand(
    batch: SceneBatch, speed: tuple[float, float], gap_m: float, wanted: float
) -> None:
    behind, ahead = following_penalty(*in_line(batch, speed, gap_m))[0].tolist()
    assert behind == pytest.approx(wanted, abs=1e-5)
    assert ahead == 0.0


@pytest.mark.parametrize(
    ("y", "yaw", "wanted"),
    [
        (1.0, 0.0, 0.0),
        (2.0, 0.0, 0.8),
        (-2.2, 0.0, 1.0),
        (9.0, 0.0, 1.8),
        (2.0, 3.1, 0.0),
    ],  # against it: no lane
)
def test_lane_distance_by_hand(batch: SceneBatch, y: float, yaw: float, wanted: float) -> None:
    """One lane along x through the vehicle that stands at *y* beside it."""
    rollout, scene = in_line(batch, (0.0, 0.0), 10.0)
    past = scene.past.clone()
    past[:, :, -1] = torch.tensor([0.0, y, yaw, 0.0])
    valid = torch.zeros_like(scene.map_valid)
    valid[:, :, 0] = True
    cos, sin = torch.cos(torch.tensor(yaw)), torch.sin(torch.tensor(yaw))
    x = torch.linspace(-10.0, 10.0, scene.map_xy.shape[3])
    lane = torch.stack((cos * x - sin * y, -sin * x - cos * y), dim=-1)
    scene = replace(scene, past=past, map_valid=valid, map_xy=lane.expand(scene.map_xy.shape))
    standing = replace(
        rollout, xy=past[:, :, -1:, :2].expand(1, 2, 12, 2), yaw=past[:, :, -1:, 2].expand(1, 2, 12)
    )
    assert lane_distance(standing, scene)[0, 0].item() == pytest.approx(wanted, abs=1e-4)


def test_the_way_driven_ends_where_the_log_does(batch: SceneBatch) -> None:
    rollout, scene = in_line(batch, (2.0, 2.0), 0.0)
    ahead = torch.stack((torch.arange(1.0, 13.0), torch.zeros(12)), dim=-1)
    past, known = scene.past.clone(), torch.ones_like(scene.future_valid)
    past[:, :, -1, :2] = 0.0
    known[:, 1, 7:] = False
    made = travelled_m(
        replace(rollout, xy=ahead.expand(1, 2, 12, 2)), replace(scene, past=past, future_valid=known)
    )
    assert made[0].tolist() == pytest.approx([12.0, 7.0], abs=1e-3)


def test_the_anchor_is_nothing_at_first(bundle: Bundle, batch: SceneBatch) -> None:
    terms = stage_of(bundle).loss(batch, moment())
    assert float(terms["anchor"].detach()) == pytest.approx(0.0, abs=1e-6)
    parts = [float(value.detach()) for name, value in terms.items() if name != "loss"]
    assert float(terms["loss"].detach()) == pytest.approx(sum(parts), rel=1e-5)


def train(stage: DecoderStage, batch: SceneBatch, steps: int) -> None:
    optimiser = torch.optim.Adam(stage.module.parameters(), lr=5e-3)
    for step in range(steps):
        loss = stage.loss(batch, moment(step))["loss"]
        optimiser.zero_grad()
        torch.autograd.backward(loss)
        torch.nn.utils.clip_grad_norm_(stage.module.parameters(), 5.0)
        optimiser.step()


def test_it_learns_and_leaves_all_but_the_decoder_alone(bundle: Bundle, batch: SceneBatch) -> None:
    stage = stage_of(bundle)

    def others() -> dict[str, Tensor]:
        whole = stage.bundle.tensors()
        return {n: v.clone() for n, v in whole.items() if not n.startswith("traffic.decoder.")}

    kept, before = others(), means(stage.evaluate(batch, moment().generator))
    train(stage, batch, 12)
    after = means(stage.evaluate(batch, moment().generator))
    assert after["loss"] < 0.9 * before["loss"]
    assert after["reconstruction"] < before["reconstruction"]
    assert all(torch.equal(value, kept[name]) for name, value in others().items())


def test_half_precision_is_for_products_alone(bundle: Bundle, batch: SceneBatch) -> None:
    stage = stage_of(bundle)
    whole = float(stage.loss(batch, moment())["loss"].detach())
    with torch.autocast("cpu", torch.bfloat16):
        half = stage.loss(batch, moment())["loss"]
    torch.autograd.backward(half)
    assert half.dtype == torch.float32
    assert float(half.detach()) == pytest.approx(whole, rel=0.1)
    grads = [w.grad for w in stage.module.parameters() if w.grad is not None]
    assert grads
    assert all(g.dtype == torch.float32 and bool(torch.isfinite(g).all()) for g in grads)


def test_the_log_has_driven_its_own_way(bundle: Bundle, batch: SceneBatch) -> None:
    tally = stage_of(bundle).evaluate(batch, moment().generator)
    who = batch.moved & ~batch.parked & batch.future_valid.any(-1)
    assert tally["travelled"][1] == pytest.approx(float(travelled_m(logged_rollout(batch), batch)[who].sum()))
