"""``advdiff-sumo data`` as a user types it."""

from __future__ import annotations

import json
import signal
import time
from pathlib import Path

import pytest

from advdiff_sumo.data.window_files import read_windows
from advdiff_sumo.models.bundle import load_bundle
from advdiff_sumo.training.dataset import read_window_set
from tests.e2e.commands import advdiff, begin, everything
from tests.hang_guard import HANG_S


def test_simulate_then_stats(tmp_path: Path) -> None:
    done = advdiff(
        *("data", "simulate", "--out", "w", "--windows", 12, "--net", "downtown-left"),
        *("--random-share", 0, "--seed", 4, "--workers", 1),
        cwd=tmp_path,
    )
    assert done.code == 0, done.err
    assert done.out.startswith("w: 12 windows in 1 file")
    assert done.err == ""
    said = advdiff("data", "stats", "w", "--json", cwd=tmp_path)
    figures = json.loads(said.out)
    assert (figures["windows"], figures["files"], said.code) == (12, 1, 0)
    table = advdiff("data", "stats", "w", cwd=tmp_path)
    assert "agents per window" in table.out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("simulate", "--out", "w", "--net", "no.net.xml"), "no.net.xml: no such net"),
        (("simulate", "--out", "file"), "--out file is a file"),
        (
            ("simulate", "--out", "file/w"),
            "file/w/nets: cannot be made (Not a directory); choose another --out",
        ),
        (("simulate", "--out", "w", "--windows", "0"), "'--windows'"),
        (("simulate", "--out", "w", "--seed", "-1"), "'--seed'"),
        (("simulate", "--out", "w", "--random-share", "2"), "'--random-share'"),
        (("simulate", "--out", "w", "--driven-by", "no.safetensors"), "no.safetensors: no such file"),
        (("build", "nowhere", "--out", "w"), "nowhere: no such log"),
        (("build", ".", "--out", "w"), "holds no driving log"),
        (("build", ".", "--out", "w", "--stride", "0.7"), "multiples of 0.5 s"),
        (("stats", "nowhere"), "nowhere: no such file or folder"),
        (("stats", "file"), "file: is truncated or no safetensors file"),
        (("stats", "empty"), "empty: holds no window file"),
    ],
)
def test_bad_input_gets_one_sentence_and_leaves_no_files(
    tmp_path: Path, words: tuple[str, ...], said: str
) -> None:
    (tmp_path / "file").write_text("no windows")
    (tmp_path / "empty").mkdir()
    before = everything(tmp_path)
    done = advdiff("data", *words, cwd=tmp_path)
    assert done.code == 2
    assert said in done.err
    assert done.err.count("\n") == 1
    assert "Traceback" not in done.err
    assert everything(tmp_path) == before


@pytest.mark.nightly
@pytest.mark.slow
def test_windows_of_the_far_view_need_networks_for_that_view(tmp_path: Path) -> None:
    words = ("data", "simulate", "--out", "w", "--windows", 4, "--net", "motorway", "--random-share", 0)
    done = advdiff(*words, "--map-view", "far", "--workers", 1, cwd=tmp_path)
    assert done.code == 0, done.err
    assert read_window_set([tmp_path / "w"]).map_view == "far"
    again = advdiff(*words, cwd=tmp_path)
    assert again.code == 2
    assert "was made with other options" in again.err
    refused = advdiff("evaluate", "--weights", "shipped", "--data", "w", "--all", cwd=tmp_path)
    assert refused.code == 2
    assert "the windows show the map's 'far' view, but the networks see 'near'" in refused.err
    refused = advdiff("train", "reward", "--init", "shipped", "--data", "w", "--out", "o", cwd=tmp_path)
    assert refused.code == 2
    assert "make windows with --map-view near" in refused.err
    words = (
        "train",
        "traffic",
        "--init",
        "shipped",
        "--data",
        "w",
        "--val",
        "w",
        "--out",
        "far",
        "--judge",
        0,
    )
    settings = (
        "model.decoder=closed-loop",
        "epochs=1",
        "batch_size=2",
        "elbo.samples=1",
        "jitter.mirror=0.5",
    )
    sets = [word for setting in settings for word in ("--set", setting)]
    done = advdiff(*words, *sets, "--loaders", 1, "--threads", 1, cwd=tmp_path)
    assert done.code == 0, done.err
    assert load_bundle(tmp_path / "far" / "weights.safetensors").options.model.map_view == "far"


@pytest.mark.slow
def test_windows_in_which_a_model_drove_train_its_denoiser(tmp_path: Path) -> None:
    words = ("data", "simulate", "--out", "w", "--windows", 1, "--net", "downtown-left", "--random-share", 0)
    driven = ("--map-view", "far", "--driven-by", "closed-loop", "--seed", 5, "--workers", 1)
    done = advdiff(*words, *driven, cwd=tmp_path)
    assert (done.code, done.err) == (0, "")
    assert read_window_set([tmp_path / "w"]).driven.all()
    again = advdiff(*words, "--map-view", "far", "--seed", 5, cwd=tmp_path)
    assert again.code == 2
    assert "was made with other options" in again.err
    words = (
        "train",
        "denoiser",
        "--init",
        "closed-loop",
        "--data",
        "w",
        "--val",
        "w",
        "--judge",
        0,
        "--threads",
        1,
    )
    settings = (
        "model.denoiser_situation=true",
        "epochs=1",
        "epoch_windows=1",
        "batch_size=1",
        "driven_share=1",
    )
    sets = [word for setting in settings for word in ("--set", setting)]
    done = advdiff(*words, *sets, "--out", "told", cwd=tmp_path)
    assert done.code == 0, done.err
    assert load_bundle(tmp_path / "told" / "weights.safetensors").options.model.denoiser_situation
    refused = advdiff(*words, "--set", "driven_share=0.5", "--out", "o", cwd=tmp_path)
    assert refused.code == 2
    assert "the windows hold 1 that a model drove and 0 others" in refused.err


@pytest.mark.parametrize("verb", ["simulate", "build", "stats"])
def test_help_teaches(tmp_path: Path, verb: str) -> None:
    done = advdiff("data", verb, "--help", cwd=tmp_path)
    assert (done.code, done.err) == (0, "")
    assert f"advdiff-sumo data {verb} " in " ".join(done.out.split())


@pytest.mark.slow
def test_ctrl_c_keeps_what_is_complete(tmp_path: Path) -> None:
    words = ("data", "simulate", "--out", "w", "--windows", "900", "--net", "motorway")
    process = begin(*words, "--random-share", "0", "--workers", "1", cwd=tmp_path)
    folder = tmp_path / "w"
    until = time.monotonic() + HANG_S
    while not list(folder.glob("*.safetensors")) and time.monotonic() < until:
        time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=HANG_S)
    assert process.returncode == 130
    assert "interrupted; what had finished is kept; go on with advdiff-sumo data simulate --out w" in said
    assert "Traceback" not in said
    kept = list(folder.glob("*.safetensors"))
    assert 1 <= len(kept) < 3
    assert all(read_windows(path).windows > 0 for path in kept)
