"""Options of an environment on a shipped net that resets fast, with small untrained networks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import torch

from tests.traffic.small_networks import one_thread, weights

__all__ = ["one_thread", "weights"]
pytest.importorskip("gymnasium", reason="needs the extra rl: pip install 'advdiff-sumo[rl]'")
pytest.importorskip("stable_baselines3", reason="needs the extra rl: pip install 'advdiff-sumo[rl]'")

SCENE = {"warmup_s": 10.0, "min_neighbours": 1, "scenes_per_warmup": 2}


@pytest.fixture(scope="module")
def settings(weights: str) -> dict[str, Any]:
    """Return options of an environment: one scene on the motorway, 3 s long."""
    return {
        "nets": "motorway",
        "targets": "Krauss",
        "scenes": 1,
        "horizon_s": 3.0,
        "prior": "traffic",
        "prior_weights": weights,
        "scene": SCENE,
    }


@pytest.fixture(scope="module", autouse=True)
def own_generators() -> Iterator[None]:
    """Restore PyTorch's random generator, which stable-baselines3 seeds."""
    state = torch.get_rng_state()
    yield
    torch.set_rng_state(state)
