"""Stage "simnet": what it pays for, how its stretch grows, and that it learns four windows by heart."""

from __future__ import annotations

import pytest
import torch

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.losses import reconstruction
from advdiff_sumo.models.simnet import new_simnet
from advdiff_sumo.training.presets import SimnetOptions
from advdiff_sumo.training.simnet_stage import SimnetStage, first_steps, unrolled_steps
from advdiff_sumo.training.stage import Moment, means
from tests.training.conftest import TINY


def moment(step: int, total: int) -> Moment:
    return Moment(step, total, torch.Generator().manual_seed(0))


def test_the_stretch_grows_straight_and_stays() -> None:
    options = SimnetOptions(first_steps=2, steps=12, growth_share=0.5)
    assert [unrolled_steps(p, options) for p in (0.0, 0.1, 0.25, 0.5, 1.0)] == [2, 4, 7, 12, 12]
    assert unrolled_steps(0.0, SimnetOptions(growth_share=0.0)) == 12


@torch.no_grad()
def test_only_the_stretch_is_paid(batch: SceneBatch) -> None:
    simnet = new_simnet(TINY)
    stage = SimnetStage(simnet, SimnetOptions(first_steps=3, steps=12))
    paid = float(stage.loss(batch, moment(0, 10))["loss"])
    known = (batch.future_valid & batch.moved[..., None])[:, :, :3]
    error = reconstruction(simnet(batch), batch)[:, :, :3]
    assert paid == pytest.approx(float(error[known].mean()), rel=1e-5)
    short = first_steps(batch, 3)
    assert short.future.shape[2] == short.future_valid.shape[2] == 3


def test_it_learns_four_windows_by_heart(batch: SceneBatch) -> None:
    stage = SimnetStage(new_simnet(TINY), SimnetOptions(growth_share=0.5))
    with torch.no_grad():
        before = means(stage.evaluate(batch, moment(0, 1).generator))
    optimiser = torch.optim.Adam([p for p in stage.module.parameters() if p.requires_grad], lr=5e-3)
    for step in range(60):
        loss = stage.loss(batch, moment(step, 60))["loss"]
        optimiser.zero_grad()
        torch.autograd.backward(loss)
        torch.nn.utils.clip_grad_norm_(stage.module.parameters(), 5.0)
        optimiser.step()
    with torch.no_grad():
        after = means(stage.evaluate(batch, moment(0, 1).generator))
    assert after["loss"] < 0.5 * before["loss"]
    assert after["ade_m"] < before["ade_m"]
    assert {"fde_m", "collision_rate", "off_road_rate"} < set(after)
