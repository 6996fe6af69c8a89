"""The command that repeats a margin, written by hand and read back."""

from __future__ import annotations

import shlex
from itertools import pairwise
from pathlib import Path

import pytest

from advdiff_sumo.cli.run import options_given
from advdiff_sumo.experiments.margin_command import episode_margin_command, margin_command

MARGIN = {"background": "scripted"}


def test_by_hand() -> None:
    given = {"target": "av:Mine", "net": "motorway", "horizon_s": 10.0, "seed": 2, **MARGIN}
    assign = ["scene.situation=following", "scene.min_speed_mps=8", "target_options.name='a b'"]
    options = options_given(None, given, {"attackers": 1}, assign, ["weak-brakes:3", "late:0.5"])
    assert margin_command(options, 0, "hard-stop", None, 4.0) == (
        "advdiff-sumo margin --target av:Mine --net motorway --attack hard-stop --within 4 --horizon 10 --seed 2 "
        "--defect weak-brakes:3 --defect late:0.5 --set 'target_options.name=\"a b\"' "
        "--set scene.min_speed_mps=8.0 --set scene.situation=following --out ../again"
    )


def test_what_is_usual_is_left_out_and_files_are_named_in_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    given = {"net": "my.net.xml", "demand": "my.rou.xml", **MARGIN}
    options = options_given(None, given, {"attackers": 1}, [])
    assert shlex.split(margin_command(options, 0, "cut-in", "gap")) == [
        *("advdiff-sumo", "margin", "--target", "IDM", "--net", str(tmp_path / "my.net.xml")),
        *("--attack", "cut-in", "--by", "gap", "--demand", str(tmp_path / "my.rou.xml")),
        *("--horizon", "20", "--seed", "0", "--out", "../again"),
    ]


def test_names_that_end_like_numbers_stay() -> None:
    options = options_given(None, {"target": "exec:./planner-1.0", "net": "downtown", **MARGIN}, {}, [])
    assert "--target exec:./planner-1.0 " in margin_command(options, 0, "cut-in")


@pytest.mark.parametrize(
    "assign",
    [
        ["background_options.attackers=2", "sim.stop_at_collision=false", "scene.density_per_km=0.125"],
        ["target_options.list=[1, 2.5, 'three']", "target_options.word='true'", "target_options.text='8'"],
        ["target_options.nested.name='mine.yaml'", "target_options.umlaut='Straße \\\\ 1'"],
    ],
)
def test_it_comes_to_the_same_options(assign: list[str]) -> None:
    options = options_given(None, {"net": "downtown", **MARGIN}, {"attackers": 1}, assign)
    words = shlex.split(margin_command(options, 0, "all"))
    again = [value for flag, value in pairwise(words) if flag == "--set"]
    assert options_given(None, {"net": "downtown", **MARGIN}, {"attackers": 1}, again) == options


def test_another_scene_of_the_seed_and_an_episode_of_a_sweep() -> None:
    options = options_given(None, {"net": "downtown", **MARGIN}, {"attackers": 1}, [])
    assert " --seed 0 --number 7 --out" in margin_command(options, 7, "cut-in")
    flags = {"--target": "av:Next", "--attack": None, "--within": 0.5}
    command = episode_margin_command(
        ("12ab", "--sweep", "/my runs/s"), flags, ["late:1"], ["sim.step_s=0.05"]
    )
    assert command == (
        "advdiff-sumo margin 12ab --sweep '/my runs/s' --target av:Next --within 0.5 "
        "--defect late:1 --set sim.step_s=0.05 --out ../again"
    )
