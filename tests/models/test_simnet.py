"""SimNet: it drives its own actions, sees what it did, and comes back from its file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import cast

import pytest
import torch
from torch import Tensor, nn

from advdiff_sumo.core.errors import WeightsError
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import BundleOptions, new_bundle, save_bundle
from advdiff_sumo.models.decoder import Forced
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.simnet import SimNet, begin_simnet, load_simnet, new_simnet, save_simnet
from advdiff_sumo.models.tensor_bicycle import step


@pytest.fixture(scope="module")
def simnet(options: ModelOptions, lively: Callable[[nn.Module], nn.Module]) -> SimNet:
    return cast(SimNet, lively(new_simnet(options, seed=3)))


@torch.no_grad()
def test_each_instant_is_the_action_of_the_one_before(simnet: SimNet, batch: SceneBatch) -> None:
    """Two steps by hand: act, drive the bicycle, look again."""
    rollout = simnet(batch, 2)
    accel, curvature = simnet.act(batch)
    pose = batch.pose
    xy, yaw, speed = step(pose[..., :2], pose[..., 2], pose[..., 3], accel, curvature, 0.5)
    torch.testing.assert_close(
        rollout.states()[:, :, 0], torch.cat((xy, yaw[..., None], speed[..., None]), -1)
    )
    again = simnet.act(batch.advanced(rollout.states()[:, :, :1]))
    torch.testing.assert_close((rollout.accel[:, :, 1], rollout.curvature[:, :, 1]), again)


@torch.no_grad()
def test_the_same_scene_gives_the_same_future(simnet: SimNet, batch: SceneBatch) -> None:
    one, other = simnet(batch), simnet(batch)
    assert all(torch.equal(a, b) for a, b in zip(vars(one).values(), vars(other).values(), strict=True))
    assert one.accel.shape == one.curvature.shape == (2, 5, 12)


@torch.no_grad()
def test_it_stays_within_the_limits_and_walkers_are_left_alone(
    simnet: SimNet, batch: SceneBatch, options: ModelOptions
) -> None:
    rollout = simnet(batch)
    assert float(rollout.accel.abs().max()) > 0.05
    assert float(rollout.accel.max()) <= options.accel_mps2
    assert float(rollout.accel.min()) >= -options.brake_mps2
    speed = torch.cat((batch.pose[..., None, 3], rollout.speed[..., :-1]), dim=-1)
    assert float((rollout.curvature.abs() * speed**2).max()) <= options.lateral_mps2 + 1e-4
    assert not bool(rollout.accel[0, 2].any() | rollout.curvature[0, 2].any())  # agent 2 walks


@torch.no_grad()
def test_others_react_to_who_is_forced(simnet: SimNet, batch: SceneBatch) -> None:
    mask = torch.zeros(2, 5, 12, dtype=torch.bool)
    mask[0, 0] = True
    states = torch.zeros(2, 5, 12, 4)
    states[0, 0] = torch.tensor([1.0, 2.0, 0.3, 4.0])
    free, forced = simnet(batch), simnet(batch, forced=Forced(states, mask))
    torch.testing.assert_close(forced.states()[0, 0], states[0, 0])
    assert float((forced.xy[0, 1] - free.xy[0, 1]).abs().max()) > 1e-4
    torch.testing.assert_close(forced.xy[1], free.xy[1])


@torch.no_grad()
def test_order_and_padding_change_nothing(
    simnet: SimNet,
    batch: SceneBatch,
    permuted: Callable[[SceneBatch, Tensor], SceneBatch],
    padded: Callable[[SceneBatch], SceneBatch],
) -> None:
    wanted, order = simnet(batch).states(), torch.tensor([3, 0, 4, 1, 2])
    there = batch.present
    made = simnet(permuted(batch, order)).states()
    torch.testing.assert_close(made[there[:, order]], wanted[:, order][there[:, order]], atol=1e-4, rtol=1e-4)
    wider = simnet(padded(batch)).states()[:, :5]
    torch.testing.assert_close(wider[there], wanted[there], atol=1e-4, rtol=1e-4)


def test_every_weight_but_the_prior_learns_from_the_last_instant(simnet: SimNet, batch: SceneBatch) -> None:
    total = simnet(batch, 3).xy[:, :, -1].square().sum()
    named = [(n, p) for n, p in simnet.named_parameters() if not n.startswith("encoder.prior")]
    grads = torch.autograd.grad(total, [p for _, p in named])
    assert [n for (n, _), g in zip(named, grads, strict=True) if not g.any()] == []


def test_standing_alone_without_a_map_gives_numbers(simnet: SimNet, batch: SceneBatch) -> None:
    alone = torch.zeros_like(batch.present)
    alone[:, 0] = True
    still = batch.past.clone()
    still[..., 3] = 0.0
    scene = replace(
        batch, past=still, present=alone, moved=alone, map_valid=torch.zeros_like(batch.map_valid)
    )
    total = simnet(scene).states().square().mean()
    grads = torch.autograd.grad(total, list(simnet.head.parameters()))
    assert all(bool(torch.isfinite(g).all()) for g in (total, *grads))


def test_it_comes_back_from_its_file(simnet: SimNet, tmp_path: Path) -> None:
    save_simnet(simnet, tmp_path / "s.safetensors", {"seed": 1})
    back = load_simnet(tmp_path / "s.safetensors")
    assert back.options == simnet.options
    assert all(torch.equal(v, back.state_dict()[n]) for n, v in simnet.state_dict().items())
    save_simnet(back, tmp_path / "t.safetensors", {"seed": 1})
    assert (tmp_path / "s.safetensors").read_bytes() == (tmp_path / "t.safetensors").read_bytes()


def test_it_begins_with_the_encoder_of_a_bundle(options: ModelOptions, tmp_path: Path) -> None:
    path = tmp_path / "traffic.safetensors"
    bundle = new_bundle(BundleOptions(model=options), seed=5)
    save_bundle(bundle, path, ("traffic",))
    begun = begin_simnet(path, ModelOptions(), seed=2)
    assert begun.options == options
    assert torch.equal(
        begun.encoder.state.state_dict()["0.weight"], bundle.traffic.encoder.state_dict()["state.0.weight"]
    )
    assert torch.equal(
        begun.head.state_dict()["0.weight"], new_simnet(options, 2).head.state_dict()["0.weight"]
    )
    save_simnet(begun, tmp_path / "s.safetensors")
    again = begin_simnet(tmp_path / "s.safetensors", ModelOptions(), seed=9)
    assert torch.equal(again.head.state_dict()["0.weight"], begun.head.state_dict()["0.weight"])


def test_other_files_are_refused(options: ModelOptions, tmp_path: Path) -> None:
    path = tmp_path / "traffic.safetensors"
    with pytest.raises(WeightsError, match=r"traffic\.safetensors: no such file"):
        load_simnet(path)
    save_bundle(new_bundle(BundleOptions(model=options)), path, ("traffic",))
    with pytest.raises(WeightsError, match="is not of the format advdiff-simnet-1"):
        load_simnet(path)
    path.write_bytes(b"rubbish")
    with pytest.raises(WeightsError, match="cannot be read"):
        begin_simnet(path, options)
