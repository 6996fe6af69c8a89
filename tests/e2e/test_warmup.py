"""A warm-up under a licence from the command line, and traffic that uses its result."""

from __future__ import annotations

from pathlib import Path

import pytest

from advdiff_sumo.models.bundle import BundleOptions, new_bundle
from advdiff_sumo.models.reward import save_reward
from tests.e2e.commands import SAME_BYTES, advdiff
from tests.e2e.conftest import sentence

SHORT = ("--net", "motorway", "--target", "lane_graph", "--defect", "weak-brakes:strong", "--horizon", "4")
SCENE = (
    "--set",
    "scene.warmup_s=10",
    "--set",
    "scene.min_neighbours=0",
    "--set",
    "scene.scenes_per_warmup=2",
)


@pytest.mark.slow
def test_a_warm_up_and_a_run_that_uses_it(tmp_path: Path) -> None:
    for name in ("seen", "seen again"):
        made = advdiff(
            "warmup", *SHORT, *SCENE, "--steps", "12", "--out", f"{name}.safetensors", cwd=tmp_path
        )
        assert made.code == 0, made.err
        assert "12 plans in 2 episodes" in made.out
        assert "expected to fail in: " in made.out
    assert "use it with run --background scripted --reward 'seen again.safetensors'\n" in made.out
    first, second = (tmp_path / f"{name}.safetensors" for name in ("seen", "seen again"))
    assert first.read_bytes() == second.read_bytes()
    run = ("run", *SHORT, *SCENE, "--background", "scripted", "--episodes", "1", "--quiet")
    for name in ("run", "rerun"):
        done = advdiff(*run, "--reward", "seen.safetensors", "--out", name, cwd=tmp_path)
        assert done.code == 0, done.err
    for name in SAME_BYTES:
        assert (tmp_path / "run" / name).read_bytes() == (tmp_path / "rerun" / name).read_bytes()


ILL = """
import os
import time

class Leaves:
    def start(self, road, scene, rng):
        return None

    def plan(self, road, scene, memory, rng):
        print("thinking", flush=True)
        os._exit(3)

class Hangs(Leaves):
    def plan(self, road, scene, memory, rng):
        time.sleep(10_000)
"""


@pytest.mark.parametrize(
    ("target", "limit", "said"),
    [
        ("ill:Leaves", "600", "warm-up of ill:Leaves: the worker ended with exit code 3"),
        ("ill:Hangs", "5", "warm-up of ill:Hangs: an episode took longer than 5 s"),
    ],
)
def test_a_planner_that_exits_or_hangs_is_reported(
    tmp_path: Path, target: str, limit: str, said: str
) -> None:
    (tmp_path / "ill.py").write_text(ILL)
    words = ("warmup", "--net", "motorway", "--target", target, "--timeout", limit, *SCENE)
    done = advdiff(*words, "--out", "seen.safetensors", cwd=tmp_path)
    assert said in sentence(done)
    assert not (tmp_path / "seen.safetensors").exists()


@pytest.mark.slow
def test_files_of_the_other_kind_of_warm_up(tmp_path: Path) -> None:
    """The result of a lawful warm-up (here the shipped prior) and a reward model cannot replace each other."""
    bundle = new_bundle(BundleOptions.parse({}))
    save_reward(bundle.reward, tmp_path / "q.safetensors")
    words = ("run", "--net", "motorway", "--target", "lane_graph", "--out", "run")
    done = advdiff(*words, "--background", "scripted", "--reward", "q.safetensors", cwd=tmp_path)
    assert done.code == 2
    assert "q.safetensors: is not of the format advdiff-failures-1" in sentence(done)
    shipped = Path(__file__).parents[2] / "advdiff_sumo" / "weights" / "failures.safetensors"
    reckless = ("--background", "diffusion", "--licence", "reckless", "--reward", str(shipped))
    done = advdiff(*words, *reckless, cwd=tmp_path)
    assert done.code == 2
    assert "says which lawful encounters to go for, and --licence reckless has none" in sentence(done)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--background", "sumo"), "a lawful warm-up is for background 'scripted' or 'diffusion'"),
        (("--background", "scripted", "--strength", "0.5"), "no option 'strength'"),
        (("--defect", "lat"), "did you mean 'late'?"),
        (("--attack", "close-pass"), "learns nothing of --attack close-pass; give any, hard-stop, cut-in,"),
    ],
)
def test_an_impossible_warm_up_is_refused(tmp_path: Path, words: tuple[str, ...], said: str) -> None:
    done = advdiff("warmup", "--target", "lane_graph", *words, "--out", "seen.safetensors", cwd=tmp_path)
    assert done.code == 2
    assert said in sentence(done)
