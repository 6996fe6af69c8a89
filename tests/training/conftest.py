"""Tiny networks and windows, and one thread: the machines of a CI have few."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle, BundleOptions, new_bundle
from advdiff_sumo.models.collate import collate
from advdiff_sumo.models.model_options import ModelOptions
from tests.training.straight_road import make_windows, write

TINY = ModelOptions(
    hidden=16, latent=8, edge=8, heads=2, interaction_layers=1, channels=(8, 8, 8), reward_hidden=16
)


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture
def bundle() -> Bundle:
    """Return small untrained networks."""
    return new_bundle(BundleOptions(model=TINY, diffusion_steps=20), seed=1)


@pytest.fixture
def batch() -> SceneBatch:
    """Return four windows of up to five agents."""
    return collate(make_windows(4), np.arange(4))


@pytest.fixture
def window_folder(tmp_path: Path) -> Path:
    """Return a folder with one file of twelve windows of four drives."""
    return write(tmp_path / "windows", count=12).parent
