"""``train`` and ``evaluate`` as a user types them, on an invented road."""

from __future__ import annotations

import json
import shlex
import signal
import subprocess
import time
from pathlib import Path

import pytest

from advdiff_sumo.models.bundle import load_bundle
from tests.e2e.commands import Outcome, advdiff, begin
from tests.hang_guard import HANG_S
from tests.training.straight_road import write

TINY = (
    *(
        "--set",
        "model.hidden=16",
        "--set",
        "model.latent=8",
        "--set",
        "model.edge=8",
        "--set",
        "model.heads=2",
    ),
    *("--set", "model.interaction_layers=1", "--set", "model.channels=[8, 8, 8]"),
    *("--set", "model.reward_hidden=16", "--set", "diffusion_steps=20", "--set", "batch_size=4"),
    *("--set", "held_out=0.3", "--threads", "1"),
)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("windows"), count=12).parent


@pytest.fixture(scope="module")
def traffic(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trained")
    words = ("--data", data, "--out", "traffic", *TINY, "--set", "epochs=1", "--judge", "2")
    done = advdiff("train", "traffic", *words, cwd=folder)
    assert done.code == 0, done.err
    assert "lane following" in done.out
    return folder / "traffic"


def test_a_training_writes_the_documented_files(traffic: Path) -> None:
    names = {path.name for path in traffic.iterdir()}
    wanted = {
        "weights.safetensors",
        "checkpoint.safetensors",
        "metrics.jsonl",
        "curves.png",
        "evaluation.json",
    }
    assert wanted <= names <= wanted | {"events"}
    rows = json.loads((traffic / "evaluation.json").read_text())["figures"]
    assert {"constant velocity", "lane following", "posterior", "prior", "log"} == set(rows)


def test_evaluate_prints_and_writes_the_same_table(traffic: Path, data: Path, tmp_path: Path) -> None:
    words = ("--data", data, "--all", "--windows", "4", "--samples", "2", "--out", "figures.json")
    done = advdiff("evaluate", "--weights", traffic, *words, cwd=tmp_path)
    assert done.code == 0, done.err
    rows = json.loads((tmp_path / "figures.json").read_text())["figures"]
    assert f"{rows['posterior']['ade_m']:.2f}" in done.out
    unwritten = advdiff("evaluate", "--weights", traffic, *words[:-1], "none/figures.json", cwd=tmp_path)
    refused(
        unwritten, "none/figures.json: cannot be written (No such file or directory); choose another --out"
    )
    assert unwritten.out == "", "it is refused before anything is judged"


@pytest.mark.parametrize("share", ["-0.1", "2"])
def test_a_share_of_drives_is_between_0_and_1(share: str, tmp_path: Path) -> None:
    words = ("evaluate", "--weights", "w", "--data", "d", "--held-out", share)
    done = advdiff(*words, cwd=tmp_path)
    refused(done, "--held-out", "than or equal to")
    assert done.out == "", "it is refused before anything is judged"


@pytest.mark.slow
def test_a_training_can_be_resumed_after_ctrl_c(data: Path, tmp_path: Path) -> None:
    words = ("train", "traffic", "--data", data, "--out", "out", *TINY, "--judge", "0")
    process = begin(*words, "--set", "epochs=400", cwd=tmp_path)
    _wait_for(tmp_path / "out" / "metrics.jsonl", process)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=HANG_S)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    command = err.strip().splitlines()[-1].partition("go on with ")[2]
    typed = ["advdiff-sumo", *map(str, words), "--set", "epochs=400", "--resume"]
    assert shlex.split(command) == typed
    again = advdiff(*typed[1:], "--max-minutes", "0.02", cwd=tmp_path)
    assert again.code == 0, again.err
    assert "--resume" in again.err  # the message says how to continue


@pytest.mark.slow
def test_the_shipped_weights_get_a_closed_loop_decoder(data: Path, tmp_path: Path) -> None:
    """An interrupted and resumed training gives the same bytes; the printed loss is that of the written weights."""
    words = ("train", "decoder", "--data", data, "--init", "shipped", "--threads", "1", "--judge", "0")
    tiny = ("--set", "epochs=2", "--set", "batch_size=4", "--set", "held_out=0.3")
    whole = advdiff(*words, "--out", "whole", *tiny, cwd=tmp_path)
    assert whole.code == 0, whole.err
    for more in ((*tiny, "--max-minutes", "0.0"), ("--resume",)):
        done = advdiff(*words, "--out", "parts", *more, cwd=tmp_path)
        assert done.code == 0, done.err
    weights = [tmp_path / name / "weights.safetensors" for name in ("whole", "parts")]
    assert weights[0].read_bytes() == weights[1].read_bytes()
    made = load_bundle(weights[0])
    assert made.options.model.decoder == "closed-loop"
    assert made.stages == ("traffic", "denoiser", "reward", "decoder")


def _wait_for(path: Path, process: subprocess.Popen[str]) -> None:
    end = time.monotonic() + HANG_S
    while not path.exists():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.1)


def refused(done: Outcome, *words: str) -> None:
    assert done.code == 2
    assert done.err.count("\n") == 1, done.err
    assert "Traceback" not in done.err
    for word in words:
        assert word in done.err


REFUSED = [
    (("traffic", "--data", "nowhere"), ("nowhere", "no such file or folder")),
    (("traffic", "--data", "text.safetensors"), ("text.safetensors", "no safetensors file")),
    (("trafic", "--data", "DATA"), ("did you mean 'traffic'",)),
    (("denoiser", "--data", "DATA"), ("--init", "'traffic'")),
    (("denoiser", "--data", "DATA", "--init", "nothing"), ("nothing", "no such file")),
    (("joint", "--data", "DATA", "--init", "TRAFFIC"), ("needs 'denoiser'", "train denoiser")),
    (("reward", "--data", "DATA", "--init", "TRAFFIC"), ("needs 'denoiser'",)),
    (("decoder", "--data", "DATA"), ("--init", "'denoiser'")),
    (("decoder", "--data", "DATA", "--init", "TRAFFIC"), ("needs 'denoiser'",)),
    (
        ("traffic", "--data", "DATA", "--set", "model.decoder=shut"),
        ("model.decoder", "'open' or 'closed-loop'"),
    ),
    (("traffic", "--data", "DATA", "--codec", "polar"), ("codec", "'latent' or 'trajectory'")),
    (("traffic", "--data", "DATA", "--preset", "big"), ("preset", "paper, small")),
    (("simnet", "--data", "DATA", "--codec", "trajectory"), ("'simnet'", "leave --codec out")),
    (("traffic", "--data", "DATA", "--set", "epoch=3"), ("did you mean 'epochs'",)),
    (("traffic", "--data", "DATA", "--set", "epochs=0"), ("epochs = 0",)),
    (("traffic", "--data", "DATA", "--resume"), ("checkpoint", "without --resume")),
]
"""Options of ``train`` and words of the error; each case starts PyTorch."""


@pytest.mark.parametrize(
    ("options", "words"),
    [*REFUSED[:3], *(pytest.param(*case, marks=pytest.mark.slow) for case in REFUSED[3:])],
)
def test_unusable_options_get_one_sentence(
    options: tuple[str, ...], words: tuple[str, ...], data: Path, traffic: Path, tmp_path: Path
) -> None:
    (tmp_path / "text.safetensors").write_text("no tensors here")
    places = {"DATA": data, "TRAFFIC": traffic}
    given = [places.get(word, word) for word in options]
    refused(advdiff("train", *given, "--out", "out", cwd=tmp_path), *words)
    assert not (tmp_path / "out").exists()


def test_a_folder_in_use_is_not_overwritten(traffic: Path, data: Path) -> None:
    before = (traffic / "weights.safetensors").read_bytes()
    refused(advdiff("train", "traffic", "--data", data, "--out", traffic, cwd=traffic.parent), "is not empty")
    assert (traffic / "weights.safetensors").read_bytes() == before
