"""The joint rollout by machine code, which Strive uses, against that of the network, with gradients."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from advdiff_sumo.core.scene import Scene
from advdiff_sumo.diffusion.exported_step import step_package
from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.diffusion.machine_code import slope_of
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.bundle import load_bundle
from advdiff_sumo.models.decoder import Forced, Rollout
from advdiff_sumo.models.model_options import FUTURE_STEPS
from advdiff_sumo.models.shipped_weights import shipped_weights
from advdiff_sumo.models.view import look
from tests.diffusion.shipped_code import checked_against_networks, needs_code

Street = Callable[..., Scene]
PLACES = [(60.0, 0.0), (78.0, 0.0), (42.0, 3.0), (95.0, 0.0)]
STEPS = 8


def parts(rollout: Rollout) -> tuple[Tensor, ...]:
    return rollout.xy, rollout.yaw, rollout.speed, rollout.accel, rollout.curvature


@needs_code
@pytest.mark.parametrize("weights", ["traffic", "closed-loop"])
@pytest.mark.parametrize("forced", [False, True], ids=["free", "the target is given"])
@pytest.mark.parametrize("speeds", [[8.0, 7.0, 9.0, 6.0], [8.0, 0.3, 0.0, 12.0]], ids=["driving", "stopping"])
@pytest.mark.parametrize("seed", [0, 1])
def test_it_equals_the_network(
    seed: int, speeds: list[float], forced: bool, weights: str, downtown: RoadMap, street: Street
) -> None:
    torch.set_num_threads(1)  # reset after the module; more threads slow down such small tensors
    networks = load_bundle(shipped_weights(weights)).frozen()
    traffic, sizes = networks.traffic, networks.options.model
    batch = look(downtown, street(PLACES, speeds), map_view=sizes.map_view).batch
    generator = torch.Generator().manual_seed(seed)
    states = torch.zeros(1, batch.agents, FUTURE_STEPS, 4)
    states[0, 0, :, 0], states[0, 0, :, 3] = 4.0 * torch.arange(1, FUTURE_STEPS + 1), 8.0
    mask = torch.zeros(states.shape[:3], dtype=torch.bool)
    mask[0, 0] = True
    given = Forced(states, mask) if forced else None
    with torch.no_grad():
        context = traffic.encoder(batch)
    z = torch.randn(context.prior.mean.shape, generator=generator)
    z = z.requires_grad_(True)
    decoders = traffic.decoder, FastDecoder(traffic.decoder)
    made = [parts(decoder(z, context.h, batch, STEPS, given)) for decoder in decoders]
    scales = [torch.randn(part.shape, generator=generator) for part in made[0]]
    grads = []
    with checked_against_networks() as errors:
        for one in made:
            total = torch.stack([(part * scale).sum() for part, scale in zip(one, scales, strict=True)]).sum()
            grads.append(torch.autograd.grad(total, z)[0])
    assert slope_of(step_package(sizes)).stem in errors
    for wanted, found in zip(*made, strict=True):
        torch.testing.assert_close(found, wanted, atol=2e-4, rtol=1e-4)
    torch.testing.assert_close(grads[1], grads[0], atol=2e-3 * float(grads[0].abs().max()), rtol=1e-3)
    assert float(grads[0].abs().max()) > 0.0
