"""The published splits by name, and the prediction challenge's windows."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from advdiff_sumo.core.errors import LogError, UnknownNameError
from advdiff_sumo.data.nuscenes import NuScenesReader
from advdiff_sumo.data.splits import SPLITS, in_split, prediction_windows

NAMES = [f"scene-{number:04d}" for number in range(1, 1111)]


def test_validation_has_150_scenes_and_shares_none_with_training() -> None:
    parts = {split: {n for n in NAMES if in_split(n, split)} for split in SPLITS}
    assert len(parts["val"]) == 150
    assert not parts["val"] & parts["train"]
    assert parts["train_val"] < parts["train"]
    assert len(parts["mini_train"]) == 8
    assert parts["mini_val"] == {"scene-0103", "scene-0916"}
    assert {"scene-0003", "scene-0553", "scene-1073"} < parts["val"]
    assert {"scene-0001", "scene-0061", "scene-1110"} < parts["train"]


def test_the_challenge_trains_without_what_it_holds_out() -> None:
    assert in_split("scene-0061", "train")
    assert in_split("scene-0061", "train_val", prediction=True)
    assert not in_split("scene-0061", "train", prediction=True)
    assert in_split("scene-0301", "train", prediction=True)


def test_other_names() -> None:
    assert not in_split("my-drive", "train")
    with pytest.raises(UnknownNameError, match="did you mean 'train'"):
        in_split("scene-0001", "trainn")


def write(root: Path, content: str) -> Path:
    (root / "maps" / "prediction").mkdir(parents=True)
    (root / "maps" / "prediction" / "prediction_scenes.json").write_text(content)
    return root


def test_the_windows_of_the_challenge(tmp_path: Path) -> None:
    root = write(tmp_path, json.dumps({"scene-0001": ["i1_s1", "i2_s1"], "scene-0002": []}))
    assert prediction_windows(root) == {"scene-0001": (("i1", "s1"), ("i2", "s1")), "scene-0002": ()}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{", "is not readable as JSON"),
        ("[]", "is no table of scenes"),
        ('{"scene-0001": ["a"]}', "scene-0001 holds something other"),
        ('{"scene-0001": 3}', "scene-0001 holds something other"),
    ],
)
def test_a_damaged_list_is_refused(tmp_path: Path, content: str, words: str) -> None:
    with pytest.raises(LogError, match=words):
        prediction_windows(write(tmp_path, content))


def test_a_missing_list_is_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"prediction_scenes\.json: no such file"):
        prediction_windows(tmp_path)


@pytest.mark.data
def test_the_real_scenes_are_those_of_mini_train(adv_data: Path) -> None:
    names = NuScenesReader(adv_data / "nuscenes-mini").names()
    assert len(names) == 8
    assert all(in_split(name, "mini_train") for name in names)
