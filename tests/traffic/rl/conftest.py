"""The street and the small untrained networks of the diffusion policy's tests, and actors for them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from advdiff_sumo.traffic.rl.actor import Actor, ActorNet, save_actor
from tests.traffic.small_networks import downtown, one_thread, street, weights

__all__ = ["downtown", "one_thread", "street", "weights"]


def actor(shift: float) -> Actor:
    """Return an actor that deviates by about *shift* everywhere; 0: not at all."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(4)
        net = ActorNet((16,))
        if shift:
            torch.nn.init.normal_(net.head.weight, std=0.3 * shift)
            torch.nn.init.constant_(net.head.bias, shift)
    return Actor(net.eval().requires_grad_(False), (16,), "traffic", {"steps": 7})


@pytest.fixture(scope="session")
def actor_file(tmp_path_factory: pytest.TempPathFactory) -> Callable[[float], str]:
    """Return a function: shift → file of :func:`actor`."""
    folder: Path = tmp_path_factory.mktemp("actors")

    def make(shift: float) -> str:
        path = folder / f"actor{shift:g}.safetensors"
        if not path.exists():
            save_actor(actor(shift), path)
        return str(path)

    return make
