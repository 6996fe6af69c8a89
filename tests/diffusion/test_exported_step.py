"""The machine code of the closed-loop decoder's step ships for the shipped weights, and does what the network does."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
import torch
from torch import Tensor

from advdiff_sumo.diffusion.exported_step import exported_step, step_package
from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle, load_bundle
from advdiff_sumo.models.closed_loop_decoder import ClosedLoopDecoder
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.shipped_weights import shipped_weights

_CAPABLE = torch.backends.cpu.get_cpu_capability() in {"AVX2", "AVX512"}
pytestmark = pytest.mark.skipif(not _CAPABLE, reason="the machine code is for x86-64 with AVX2")


@cache
def bundle() -> Bundle:
    return load_bundle(shipped_weights("closed-loop")).frozen()


def scenes(agents: int, count: int = 2) -> SceneBatch:
    """Return *count* scenes of vehicles in disorder, one of them absent, one on foot, with lanes and edges around."""
    generator = torch.Generator().manual_seed(agents)

    def draw(*shape: int) -> Tensor:
        return torch.randn(count, agents, *shape, generator=generator)

    there = torch.ones(count, agents, dtype=torch.bool)
    present, moved = there.clone(), there.clone()
    if agents > 1:
        present[0, -1] = moved[0, -1] = moved[-1, 1] = False
    features = draw(64, 13)
    features[:, :, :44, 4], features[:, :, 44:, 4] = 0.0, 1.0
    return SceneBatch(
        past=draw(5, 4) * torch.tensor([30.0, 30.0, 3.0, 5.0]) + torch.tensor([0.0, 0.0, 0.0, 10.0]),
        past_valid=there[..., None].expand(-1, -1, 5),
        size=torch.tensor([4.5, 2.0]) + 0.3 * draw(2).tanh(),
        classes=torch.zeros(count, agents, dtype=torch.long),
        present=present,
        moved=moved,
        parked=~there,
        map_xy=20.0 * draw(64, 1, 2) + 4.0 * draw(64, 1, 2) * torch.arange(6.0)[:, None],  # straight
        map_features=features,
        map_valid=draw(64) > -1.0,
        future=torch.zeros(count, agents, 12, 4),
        future_valid=~there[..., None].expand(-1, -1, 12),
    )


def latents(batch: SceneBatch, options: ModelOptions) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(1)
    sizes = options.latent, options.hidden
    z, h = (torch.randn(batch.scenes, batch.agents, size, generator=generator) for size in sizes)
    return z, h


def assert_same(made: Callable[[FastDecoder], Tensor], decoder: ClosedLoopDecoder) -> None:
    """Check that machine code and network do the same, but for rounding that steps in a loop make larger."""
    exported, own = (made(FastDecoder(decoder, compiled=how)) for how in (True, False))
    torch.testing.assert_close(exported, own, atol=1e-4, rtol=1e-5)


def test_it_ships_for_the_shipped_weights_and_this_pytorch() -> None:
    """Where this fails, sizes or PyTorch have changed: run ``python tools/build_machine_code.py``."""
    assert step_package(bundle().options.model).exists()
    assert exported_step(shipped()) is not None


def shipped() -> ClosedLoopDecoder:
    decoder = bundle().traffic.decoder
    assert isinstance(decoder, ClosedLoopDecoder)
    return decoder


@pytest.mark.parametrize("agents", [2, 13, 30])  # fewer than it looks at, as many as it needs, more
def test_it_rolls_out_as_the_network_does(agents: int) -> None:
    """Where this fails, the decoder has changed: run ``python tools/build_machine_code.py``, commit what it makes."""
    batch = scenes(agents)
    z, h = latents(batch, bundle().options.model)
    assert_same(lambda decoder: decoder.whole(z, h, batch, 4)[0].states(), shipped())
    assert_same(lambda decoder: decoder.whole(z, h, batch, 4)[1].senders, shipped())


def test_it_rolls_out_some_rows_as_the_network_does() -> None:
    batch, rows = scenes(20), torch.tensor([7])
    z, h = latents(batch, bundle().options.model)

    def some(decoder: FastDecoder) -> Tensor:
        trace = decoder.whole(z, h, batch, 4)[1]
        with torch.no_grad():
            return decoder.some(z[:, rows] + 0.5, h, batch, rows, 4, trace).states()

    assert_same(some, shipped())


def test_slopes_are_those_of_the_network() -> None:
    batch, rows = scenes(5), torch.tensor([1])
    z, h = latents(batch, bundle().options.model)
    decoder = FastDecoder(shipped())
    free = z[:, rows].clone().requires_grad_()
    made = decoder.some(free, h, batch, rows, 2, decoder.whole(z, h, batch, 2)[1])
    assert bool(torch.autograd.grad(made.xy.sum(), free)[0].any())


def test_it_takes_the_weights_that_it_is_given() -> None:
    batch, decoder = scenes(5), ClosedLoopDecoder(bundle().options.model).eval().requires_grad_(False)
    generator = torch.Generator().manual_seed(3)
    for weight in decoder.parameters():  # small ones, too, which a compiler likes to write into the code
        weight += 0.02 * torch.randn(weight.shape, generator=generator)
    z, h = latents(batch, decoder.options)
    assert_same(lambda rolled: rolled.whole(z, h, batch, 4)[0].states(), decoder)


def test_other_sizes_and_half_of_the_neighbours_have_none() -> None:
    options = bundle().options.model.model_copy(update={"neighbours": 6})
    assert exported_step(ClosedLoopDecoder(options)) is None


@pytest.mark.parametrize(
    "package", sorted(step_package(ModelOptions()).parent.glob("*.pt2")), ids=lambda p: p.stem
)
def test_a_file_holds_no_sources_and_no_folder_of_the_machine_that_made_it(package: Path) -> None:
    with zipfile.ZipFile(package) as archive:
        contents = {name: archive.read(name) for name in archive.namelist()}
    assert sum(name.endswith(".so") for name in contents) == 1
    assert not [name for name in contents if name.endswith(".cpp")]
    assert not re.findall(rb"/(?:work|tmp|home|root|usr)/[\w.-]+", b"".join(contents.values()))


def test_without_a_folder_that_may_hold_code_the_network_serves(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("advdiff_sumo.diffusion.exported_step.step_package", lambda _: spoiled)
    spoiled = tmp_path / "step.pt2"
    spoiled.write_bytes(b"no archive")
    assert exported_step(shipped()) is None
    assert "cannot be loaded" in caplog.text
