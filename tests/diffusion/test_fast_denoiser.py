"""The machine code of the denoiser ships for the shipped weights, and predicts what the network does."""

from __future__ import annotations

from functools import cache

import pytest
import torch

from advdiff_sumo.diffusion.fast_networks import denoiser_package, fast_denoiser
from advdiff_sumo.models.bundle import Bundle, load_bundle
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.denoiser import Denoiser
from advdiff_sumo.models.driving_situation import SITUATION_FEATURES
from advdiff_sumo.models.gaussian import Gaussian
from advdiff_sumo.models.geometry import RELATIVE_FEATURES
from advdiff_sumo.models.shipped_weights import shipped_weights

SHIPPED = ("closed-loop", "traffic", "traj2traj")
_CAPABLE = torch.backends.cpu.get_cpu_capability() in {"AVX2", "AVX512"}
pytestmark = pytest.mark.skipif(not _CAPABLE, reason="the machine code is for x86-64 with AVX2")


@cache
def bundle(weights: str) -> Bundle:
    return load_bundle(shipped_weights(weights)).frozen()


def context_of(net: Denoiser, scenes: int, agents: int) -> Context:
    generator, options = torch.Generator().manual_seed(agents), net.options

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(scenes, agents, *shape, generator=generator)

    drawn = torch.ones(scenes, agents, dtype=torch.bool)
    drawn[0, -1] = False
    situation = SITUATION_FEATURES if options.denoiser_situation else 0
    prior = Gaussian(normal(options.latent), normal(options.latent))
    return Context(normal(options.hidden), prior, normal(agents, RELATIVE_FEATURES), drawn, normal(situation))


@pytest.mark.parametrize("weights", SHIPPED)
def test_it_ships_for_the_shipped_weights_and_this_pytorch(weights: str) -> None:
    """Where this fails, sizes or PyTorch have changed: run ``python tools/build_machine_code.py``."""
    net = bundle(weights).denoiser
    assert denoiser_package(net.options, net.shape).exists()


@pytest.mark.parametrize(("scenes", "agents"), [(1, 1), (1, 2), (1, 24), (3, 7)])
@pytest.mark.parametrize("weights", SHIPPED)
def test_it_predicts_as_the_network_does(weights: str, scenes: int, agents: int) -> None:
    """Where this fails, the denoiser has changed: run ``python tools/build_machine_code.py``, commit what it makes."""
    net = bundle(weights).denoiser
    context = context_of(net, scenes, agents)
    x = torch.randn(scenes, agents, *net.shape, generator=torch.Generator().manual_seed(3))
    compiled, own = (fast_denoiser(net, how)(context) for how in (True, False))
    for k in (100, 40, 1):
        torch.testing.assert_close(compiled(x, k), own(x, k), atol=2e-5, rtol=1e-4)
