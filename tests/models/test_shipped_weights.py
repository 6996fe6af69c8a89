"""The weights that ship."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

import advdiff_sumo
from advdiff_sumo.models.bundle import Bundle, load_bundle
from advdiff_sumo.models.codec import LatentCodec

FOLDER = Path(advdiff_sumo.__file__).parent / "weights"


@pytest.fixture(scope="module")
def shipped() -> Bundle:
    return load_bundle(FOLDER / "traffic.safetensors")


def test_all_networks_are_trained(shipped: Bundle) -> None:
    """The joint stage is left out: what it makes stands still (weights/README.md)."""
    assert shipped.stages == ("traffic", "denoiser", "reward")


def test_every_number_is_finite_and_latents_have_been_scaled(shipped: Bundle) -> None:
    assert all(bool(torch.isfinite(value).all()) for value in shipped.tensors().values())
    assert isinstance(shipped.codec, LatentCodec)
    assert float((shipped.codec.std - 1.0).abs().max()) > 0.0


def test_all_together_are_below_fifteen_megabytes() -> None:
    assert 0 < sum(path.stat().st_size for path in FOLDER.glob("*.safetensors")) < 15e6


def test_each_has_a_card() -> None:
    card = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert all(path.name in card for path in FOLDER.glob("*.safetensors"))
