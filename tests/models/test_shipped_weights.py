"""The weights that ship."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import advdiff_sumo
from advdiff_sumo.data.window_files import WindowFile
from advdiff_sumo.diffusion.sampler import Sampling
from advdiff_sumo.models.bundle import Bundle, load_bundle
from advdiff_sumo.models.codec import LatentCodec
from advdiff_sumo.models.collate import collate
from advdiff_sumo.models.shipped_weights import WEIGHTS, ShippedName, find_weights, shipped_weights
from advdiff_sumo.training.denoiser_stage import diffused_samples
from advdiff_sumo.training.open_loop import sampling_of
from advdiff_sumo.training.own_samples import faults
from advdiff_sumo.training.stage import means
from tests.training.straight_road import make_windows

FOLDER = Path(advdiff_sumo.__file__).parent / "weights"


@pytest.fixture(scope="module", params=["traffic", "closed-loop"])
def shipped(request: pytest.FixtureRequest) -> Bundle:
    return load_bundle(shipped_weights(request.param))


def test_all_networks_are_trained(shipped: Bundle) -> None:
    """The joint stage is left out: what it makes stands still (weights/README.md)."""
    assert (
        {"traffic", "denoiser", "reward"} <= {*shipped.stages} <= {"traffic", "denoiser", "reward", "decoder"}
    )


def test_the_closed_loop_weights_see_as_far_as_is_driven() -> None:
    options = load_bundle(shipped_weights("closed-loop")).options.model
    assert (options.decoder, options.map_view) == ("closed-loop", "far")


def test_weights_are_found_by_path_or_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert find_weights("") == shipped_weights("traffic")
    assert find_weights("", "simnet") == shipped_weights("simnet")
    assert (
        find_weights("closed-loop") == find_weights("closed-loop", "simnet") == shipped_weights("closed-loop")
    )
    assert find_weights("my/own.safetensors") == Path("my/own.safetensors")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "closed-loop").mkdir()
    assert find_weights("closed-loop") == Path("closed-loop")  # a user's own file or folder comes first


def far_view(windows: WindowFile) -> WindowFile:
    """Return windows of the near view with their pieces where the far view has them."""
    near = np.full((len(windows.near), 64), -1, dtype=np.int32)
    near[:, :28], near[:, 44:56] = windows.near[:, :28], windows.near[:, 28:]
    return replace(windows, near=near)


@torch.no_grad()
def sampled(name: ShippedName, windows: WindowFile) -> dict[str, float]:
    """Return the faults of one free sample of each window."""
    bundle, batch = load_bundle(shipped_weights(name)).frozen(), collate(windows, np.arange(windows.windows))
    context = bundle.traffic.encoder(batch)
    drawn = diffused_samples(bundle, context, Sampling(5), torch.Generator().manual_seed(0))
    return means(faults(bundle.codec.decode(drawn, context, batch), batch))


def test_free_samples_of_the_closed_loop_weights_seldom_touch_and_stay_on_the_road() -> None:
    windows = make_windows(60)
    before, after = sampled("traffic", windows), sampled("closed-loop", far_view(windows))
    assert after["collision_rate"] < 0.6 * before["collision_rate"]
    assert after["off_road_rate"] < 0.02
    assert 0.8 < after["travelled"] < 1.2


@torch.no_grad()
def test_free_samples_of_closed_loop_weights_stay_within_two_deviations_and_others_need_not() -> None:
    windows = make_windows(8)
    largest = []
    for name, seen in (("closed-loop", far_view(windows)), ("traffic", windows)):
        bundle, batch = load_bundle(shipped_weights(name)).frozen(), collate(seen, np.arange(8))
        generator = torch.Generator().manual_seed(0)
        drawn = diffused_samples(bundle, bundle.traffic.encoder(batch), sampling_of(bundle, 5), generator)
        largest.append(float(drawn.abs().max()))
    assert largest[0] <= 2.0 < largest[1]


def test_every_number_is_finite_and_latents_have_been_scaled(shipped: Bundle) -> None:
    assert all(bool(torch.isfinite(value).all()) for value in shipped.tensors().values())
    assert isinstance(shipped.codec, LatentCodec)
    assert float((shipped.codec.std - 1.0).abs().max()) > 0.0


def test_all_together_are_below_fifteen_megabytes() -> None:
    assert 0 < sum(path.stat().st_size for path in FOLDER.glob("*.safetensors")) < 15e6


def test_each_has_a_card() -> None:
    card = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert all(path.name in card for path in FOLDER.glob("*.safetensors"))


def test_the_folder_of_a_training_stands_for_its_weights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / WEIGHTS).touch()
    monkeypatch.chdir(tmp_path)
    assert find_weights("mine") == Path("mine") / WEIGHTS
    assert find_weights("gone") == Path("gone")
    assert find_weights("", "simnet") == shipped_weights("simnet")
