"""``train-rl`` as a user types it, and a run with the trained attacker."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.e2e.commands import TINY, Outcome, advdiff

pytest.importorskip("gymnasium", reason="needs the extra rl: pip install 'advdiff-sumo[rl]'")
pytest.importorskip("stable_baselines3", reason="needs the extra rl: pip install 'advdiff-sumo[rl]'")

WORDS = (
    *("train-rl", "--net", "motorway", "--target", "Krauss", "--prior", "traffic", "--out", "rl"),
    *("--set", "scenes=1", "--set", "horizon_s=2", "--set", "scene.warmup_s=10"),
    *("--set", "scene.scenes_per_warmup=1", "--set", "scene.min_neighbours=1"),
    *("--set", "ppo.n_steps=4", "--set", "ppo.batch_size=4", "--set", "ppo.n_epochs=1"),
)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Outcome]:
    folder = tmp_path_factory.mktemp("rl")
    return folder, advdiff(*WORDS, "--steps", "4", cwd=folder)


def test_it_leaves_an_actor_and_its_curve(trained: tuple[Path, Outcome]) -> None:
    folder, done = trained
    assert done.code == 0, done.err
    assert "rl/actor.safetensors: 4 steps, 1 update" in done.err
    files = {path.name for path in (folder / "rl").iterdir()} - {"events"}
    assert files == {"actor.safetensors", "checkpoint.safetensors", "metrics.jsonl", "curves.png"}


@pytest.mark.slow
def test_it_can_be_resumed(trained: tuple[Path, Outcome]) -> None:
    folder, _ = trained
    assert advdiff(*WORDS, "--steps", "8", cwd=folder).code == 2
    done = advdiff(*WORDS, "--steps", "8", "--resume", cwd=folder)
    assert done.code == 0, done.err
    lines = (folder / "rl" / "metrics.jsonl").read_text().splitlines()
    assert [json.loads(line)["step"] for line in lines] == [4, 8]


@pytest.mark.slow
def test_a_run_uses_the_trained_attacker(trained: tuple[Path, Outcome]) -> None:
    folder, _ = trained
    words = ("run", "--net", "motorway", "--background", "adv-rl", "--episodes", "1", "--out", "run")
    done = advdiff(*words, "--weights", "rl/actor.safetensors", *TINY, cwd=folder)
    assert done.code == 0, done.err
    assert (folder / "run" / "episodes.parquet").exists()
    assert 'background = "adv-rl"' in (folder / "run" / "run.toml").read_text()


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (("--set", "ppo.n_step=4"), "no option 'n_step'; did you mean 'n_steps'"),
        (("--set", "horizon=4"), "no option 'horizon'; did you mean 'horizon_s'"),
        (("--prior", "trafic"), "prior = 'trafic'"),
        (("--target", "IDN"), "did you mean 'IDM'"),
    ],
)
def test_a_refused_training_leaves_no_files(words: tuple[str, str], problem: str, tmp_path: Path) -> None:
    done = advdiff("train-rl", "--out", "rl", *words, cwd=tmp_path)
    assert done.code == 2
    assert problem in done.err
    assert done.err.count("\n") == 1
    assert not (tmp_path / "rl").exists()
