"""The street and the small untrained networks of the diffusion policy's tests, and a SimNet."""

from __future__ import annotations

import pytest
import torch

from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.simnet import new_simnet, save_simnet
from tests.traffic.small_networks import MODEL, downtown, one_thread, street, weights

__all__ = ["downtown", "one_thread", "street", "weights"]


@pytest.fixture(scope="session")
def simnet(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the file of an untrained SimNet whose vehicles move."""
    sizes = {key: value for key, value in MODEL.items() if key != "channels"}
    net = new_simnet(ModelOptions.parse({**sizes, "channels": (8, 16, 24)}))
    generator = torch.Generator().manual_seed(2)
    for weight in net.parameters():
        weight.data += 0.05 * torch.randn(weight.shape, generator=generator)
    path = tmp_path_factory.mktemp("simnet") / "small.safetensors"
    save_simnet(net, path)
    return str(path)
