"""Guided traffic and warm-up from the command line, with small untrained networks."""

from __future__ import annotations

from pathlib import Path

import pytest

from advdiff_sumo.models.bundle import BundleOptions, new_bundle, save_bundle
from tests.e2e.commands import SAME_BYTES, TINY, advdiff
from tests.e2e.conftest import sentence

MODEL = {"hidden": 32, "latent": 8, "edge": 8, "message": 16, "channels": (8, 16, 24), "reward_hidden": 16}


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    path = tmp_path / "small.safetensors"
    save_bundle(new_bundle(BundleOptions.parse({"model": MODEL})), path, ())
    return path


def test_a_guided_run_its_check_and_its_repetition(weights: Path, tmp_path: Path) -> None:
    words = ("run", "--net", "motorway", "--background", "diffusion", "--weights", weights.name)
    words += ("--strength", "1", "--attackers", "2", "--attack", "cut-in", "--episodes", "2")
    done = advdiff(*words, *TINY, "--check", "--out", "first", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "check: " in done.out
    assert "vehicles that the policy moved did something implausible" in " ".join(done.out.split())
    assert "the safeguard changed what is driven next of" in " ".join(done.out.split())
    settings = (tmp_path / "first" / "run.toml").read_text()
    assert f'weights = "{weights}"' in settings  # absolute, so that the run can be repeated from any folder
    again = advdiff("run", "--config", "first/run.toml", "--out", "again", cwd=tmp_path, hash_seed=1)
    assert again.code == 0, again.err
    for name in SAME_BYTES:
        assert (tmp_path / "first" / name).read_bytes() == (tmp_path / "again" / name).read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("guide", ["none", "reward"])
def test_the_shipped_closed_loop_weights_by_their_name(tmp_path: Path, guide: str) -> None:
    words = ("run", "--net", "downtown", "--background", "diffusion", "--weights", "closed-loop", "--check")
    done = advdiff(*words, "--guide", guide, *TINY, "--episodes", "1", "--out", "run", cwd=tmp_path)
    assert done.code == 0, done.err
    assert 'weights = "closed-loop"' in (tmp_path / "run" / "run.toml").read_text()


def test_guiding_needs_a_trained_reward_model(tmp_path: Path) -> None:
    path = tmp_path / "natural.safetensors"
    save_bundle(new_bundle(BundleOptions.parse({"model": MODEL})), path, ("traffic", "denoiser"))
    words = ("run", "--net", "motorway", "--background", "diffusion", "--weights", path.name)
    done = advdiff(*words, *TINY, "--out", "run", cwd=tmp_path)
    assert done.code == 2
    assert "natural.safetensors: has no trained reward model, which guides" in sentence(done)


@pytest.mark.slow
def test_warm_up_and_its_reward_model(weights: Path, tmp_path: Path) -> None:
    words = ("--net", "motorway", "--weights", weights.name, "--horizon", "3")
    made = advdiff(
        *("warmup", *words, "--licence", "reckless", "--target", "EIDM", "--steps", "4"),
        *("--out", "q.safetensors"),
        cwd=tmp_path,
    )
    assert made.code == 0, made.err
    assert "4 plans in " in made.out
    run = ("run", *words, "--background", "diffusion", "--reward", "q.safetensors", "--episodes", "1")
    done = advdiff(*run, "--set", "scene.warmup_s=10", "--out", "run", cwd=tmp_path)
    assert done.code == 0, done.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--out", "q.pt"), "q.pt: give a name that ends in .safetensors"),
        (("--out", "none/q.safetensors"), "none: no such folder"),
        (("--out", "folder.safetensors"), "folder.safetensors: is a folder; name a file in --out"),
        (("--out", "q.safetensors", "--weights", "none.safetensors"), "none.safetensors: no such file"),
        (
            ("--out", "q.safetensors", "--weights", "small.safetensors", "--strength", "0"),
            "a strength above 0",
        ),
    ],
)
def test_an_impossible_warm_up_is_refused(
    weights: Path, tmp_path: Path, words: tuple[str, ...], said: str
) -> None:
    (tmp_path / "folder.safetensors").mkdir()
    assert said in sentence(advdiff("warmup", "--licence", "reckless", *words, cwd=tmp_path))
