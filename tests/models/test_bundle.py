"""Checkpoints: what is written is read again, the same way each time, and bad files are told in a sentence."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor, nn

from advdiff_sumo.core.errors import InputError, WeightsError
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import (
    FORMAT,
    Bundle,
    BundleOptions,
    halve_bundle,
    load_bundle,
    new_bundle,
    save_bundle,
)
from advdiff_sumo.models.model_options import ModelOptions


@pytest.fixture
def bundle(options: ModelOptions, lively: Callable[[nn.Module], nn.Module]) -> Bundle:
    made = new_bundle(BundleOptions(model=options, diffusion_steps=50, schedule="linear"))
    for module in made.modules().values():
        lively(module)
    made.codec.measure(torch.randn(20, 1, options.latent, generator=torch.Generator().manual_seed(0)))
    return made


def write(path: Path, header: object, tensors: dict[str, Tensor]) -> Path:
    save_file({n: v.contiguous() for n, v in tensors.items()}, str(path), {"advdiff": json.dumps(header)})
    return path


def header_of(bundle: Bundle, **changes: Any) -> dict[str, Any]:
    return {"format": FORMAT, "options": bundle.options.model_dump(mode="json"), "stages": [], **changes}


def refused(path: Path) -> str:
    """Return the sentence that *path* is refused with."""
    with pytest.raises(InputError) as caught:
        load_bundle(path)
    said = str(caught.value)
    assert said.startswith(str(path))
    assert "\n" not in said
    return said.removeprefix(str(path))


def test_there_and_back(bundle: Bundle, batch: SceneBatch, tmp_path: Path) -> None:
    path = tmp_path / "weights.safetensors"
    save_bundle(bundle, path, ("traffic", "denoiser"), {"seed": 3})
    again = load_bundle(path)
    assert again.options == bundle.options
    assert again.stages == ("traffic", "denoiser")
    wanted, made = bundle.tensors(), again.tensors()
    assert sorted(made) == sorted(wanted)
    assert all(torch.equal(made[name], value) for name, value in wanted.items())
    with torch.no_grad():
        a, b = (x.traffic.encoder(batch) for x in (bundle, again))
        x = torch.ones(2, 5, *bundle.codec.shape)
        torch.testing.assert_close(b.h, a.h)
        plans = [
            m.codec.decode(x, a, batch).states() for m in (bundle, again)
        ]  # the codec's model came along
    torch.testing.assert_close(plans[0], plans[1])
    assert [p.name for p in tmp_path.iterdir()] == ["weights.safetensors"]  # nothing left aside


def test_every_codec(options: ModelOptions, tmp_path: Path) -> None:
    names: tuple[Literal["latent", "trajectory"], ...] = ("latent", "trajectory")
    for codec in names:
        path = tmp_path / f"{codec}.safetensors"
        save_bundle(new_bundle(BundleOptions(model=options, codec=codec)), path, ())
        again = load_bundle(path)
        assert again.options.codec == codec
        assert again.denoiser.shape == again.codec.shape


def test_the_same_bytes_twice(bundle: Bundle, tmp_path: Path) -> None:
    for name in ("a", "b"):
        save_bundle(bundle, tmp_path / name, ("traffic",), {"b": 1, "a": [2], "c": {"z": 1, "y": 2}})
    load = load_bundle(tmp_path / "a")
    save_bundle(load, tmp_path / "c", load.stages, {"c": {"y": 2, "z": 1}, "a": [2], "b": 1})
    assert len({(tmp_path / name).read_bytes() for name in "abc"}) == 1


def test_a_seed_makes_the_weights_and_leaves_the_generator(options: ModelOptions) -> None:
    torch.manual_seed(5)
    before = torch.get_rng_state()
    a, b, c = (new_bundle(BundleOptions(model=options), seed).tensors() for seed in (1, 1, 2))
    assert torch.equal(torch.get_rng_state(), before)
    assert all(torch.equal(a[name], b[name]) for name in a)
    name = "traffic.encoder.prior.weight"
    assert not torch.equal(a[name], c[name])


def test_frozen_learns_no_more(bundle: Bundle) -> None:
    assert bundle.frozen() is bundle
    for module in bundle.modules().values():
        assert not module.training
        assert not any(weight.requires_grad for weight in module.parameters())


def test_missing(tmp_path: Path) -> None:
    assert "no such file" in refused(tmp_path / "none.safetensors")
    assert "no such file" in refused(tmp_path)  # a folder


def test_other_formats(bundle: Bundle, tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    save_file({"a": torch.ones(2)}, str(path))
    assert f"is not of the format {FORMAT}; train it again" in refused(path)
    write(path, header_of(bundle, format="advdiff-weights-0"), bundle.tensors())
    assert f"is not of the format {FORMAT}" in refused(path)
    path.write_text("not tensors at all")
    assert "cannot be read" in refused(path)
    path.write_bytes(b"")
    assert "cannot be read" in refused(path)


def test_a_damaged_header(bundle: Bundle, tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    save_file({"a": torch.ones(2)}, str(path), {"advdiff": '{"format": '})
    assert f"is not of the format {FORMAT}" in refused(path)
    write(path, ["a list"], {"a": torch.ones(2)})
    assert f"is not of the format {FORMAT}" in refused(path)
    for header in ({"format": FORMAT}, header_of(bundle, options="none")):
        write(path, header, bundle.tensors())
        assert "has no options in its header" in refused(path)


@pytest.mark.parametrize("share", [0.01, 0.5, 0.999])
def test_truncated(bundle: Bundle, tmp_path: Path, share: float) -> None:
    path = tmp_path / "w.safetensors"
    save_bundle(bundle, path, ())
    raw = path.read_bytes()
    path.write_bytes(raw[: int(share * len(raw))])
    assert "cannot be read" in refused(path)


def test_tensors_that_do_not_fit(bundle: Bundle, options: ModelOptions, tmp_path: Path) -> None:
    path, tensors = tmp_path / "w.safetensors", bundle.tensors()
    wider = BundleOptions(model=options.model_copy(update={"hidden": 64})).model_dump(mode="json")
    said = refused(write(path, header_of(bundle, options=wider), tensors))
    assert "does not fit its own options" in said
    assert "size mismatch" in said
    name = "reward.value.2.weight"
    less = {n: v for n, v in tensors.items() if n != name}
    assert "value.2.weight" in refused(write(path, header_of(bundle), less))
    assert "value.9.weight" in refused(
        write(path, header_of(bundle), {**tensors, "reward.value.9.weight": torch.ones(1)})
    )


def test_options_that_are_none(bundle: Bundle, tmp_path: Path) -> None:
    options = {**bundle.options.model_dump(mode="json"), "difusion_steps": 3}
    said = refused(write(tmp_path / "w.safetensors", header_of(bundle, options=options), bundle.tensors()))
    assert "difusion_steps" in said
    assert "did you mean 'diffusion_steps'?" in said


def test_a_file_in_the_way_is_kept_until_the_new_one_is_whole(bundle: Bundle, tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    save_bundle(bundle, path, ("traffic",))
    before = path.read_bytes()
    with pytest.raises(TypeError):
        save_bundle(bundle, path, ("joint",), {"what": object()})
    assert path.read_bytes() == before
    assert issubclass(WeightsError, InputError)


def test_half_of_the_bytes_give_the_same_networks_to_three_digits(bundle: Bundle, tmp_path: Path) -> None:
    whole, half = tmp_path / "whole.safetensors", tmp_path / "half.safetensors"
    save_bundle(bundle, whole, ("traffic",), {"seed": 3})
    halve_bundle(whole, half)
    assert half.stat().st_size < 0.6 * whole.stat().st_size
    read = load_bundle(half)
    assert (read.options, read.stages) == (bundle.options, ("traffic",))
    for name, tensor in read.tensors().items():
        assert tensor.dtype == torch.float32
        torch.testing.assert_close(tensor, bundle.tensors()[name], rtol=1e-3, atol=1e-6)
