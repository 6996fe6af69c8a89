"""Which windows are held out, and how the others are batched."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from advdiff_sumo.core.errors import ConfigError, FileError
from advdiff_sumo.data.window_files import DRIVEN, read_windows, write_windows
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.training.dataset import batches, nearest, of_epoch, read_window_set, split
from tests.training.straight_road import make_windows, write


def drives(windows) -> set[tuple[int, str]]:
    return {
        (int(f), windows.files[f].scene_names[windows.files[f].scene[r]])
        for f, r in zip(windows.file, windows.row, strict=True)
    }


def test_a_drive_is_on_one_side_only(window_folder: Path) -> None:
    windows = read_window_set([window_folder])
    train, held_out = split(windows, 0.3, seed=0)
    assert len(train) + len(held_out) == len(windows) == 12
    assert len(train) > 0
    assert len(held_out) > 0
    assert not drives(train) & drives(held_out)


def test_more_files_move_no_drive_to_the_other_side(tmp_path: Path) -> None:
    write(tmp_path, count=16, drives=16)
    before = split(read_window_set([tmp_path]), 0.5, seed=3)[1]
    other = make_windows(12, drives=12, seed=9)
    write_windows(tmp_path / "a-first.safetensors", replace(other, map_name="other"))
    after = split(read_window_set([tmp_path]), 0.5, seed=3)[1]
    assert len(drives(before)) > 3
    assert {name for _, name in drives(before)} == {name for file, name in drives(after) if file == 1}


def test_one_drive_cannot_be_split(tmp_path: Path) -> None:
    windows = read_window_set([write(tmp_path, count=3, drives=1)])
    with pytest.raises(ConfigError, match="one drive"):
        split(windows, 0.1, seed=0)


def test_the_digest_is_of_the_content_alone(tmp_path: Path) -> None:
    first = write(tmp_path / "a")
    second = write(tmp_path / "b").rename(tmp_path / "b" / "renamed.safetensors")
    other = write(tmp_path / "c", seed=1)
    assert read_window_set([first]).digest == read_window_set([second]).digest
    assert read_window_set([first]).digest != read_window_set([other]).digest


def test_every_window_is_in_one_batch(window_folder: Path) -> None:
    windows = read_window_set([window_folder])
    for rng in (None, np.random.default_rng(0)):
        cut = batches(windows, 5, rng)
        assert sorted(np.concatenate(cut).tolist()) == list(range(12))
        assert sorted(map(len, cut)) == [2, 5, 5]


def test_batches_hold_scenes_of_about_as_many_agents(tmp_path: Path) -> None:
    windows = read_window_set([write(tmp_path, count=60, agents=20)])
    spread = [np.ptp(windows.agents[numbers]) for numbers in batches(windows, 6, np.random.default_rng(0))]
    assert np.mean(spread) < 6.0 < np.ptp(windows.agents)


def test_windows_of_several_files_keep_their_order_in_a_batch(tmp_path: Path) -> None:
    paths = [write(tmp_path / "a", count=3), write(tmp_path / "b", count=3, agents=9, seed=5)]
    windows = read_window_set(paths)
    numbers = np.array([4, 0, 5, 2])
    joined = windows.batch(numbers)
    for place, number in enumerate(numbers):
        alone = windows.batch(np.array([number]))
        for column in fields(SceneBatch):
            whole, single = getattr(joined, column.name)[place], getattr(alone, column.name)[0]
            assert torch.equal(whole[: len(single)], single), column.name
            if column.name in ("present", "moved", "future_valid", "map_valid"):
                assert not whole[len(single) :].any()


def test_only_the_nearest_agents_are_looked_at(batch: SceneBatch) -> None:
    assert nearest(batch, 24) is batch
    cut = nearest(batch, 2)
    assert cut.agents == 2
    assert torch.equal(cut.past, batch.past[:, :2])


def test_a_folder_without_windows_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="no window file"):
        read_window_set([tmp_path])


def test_windows_of_two_views_of_the_map_are_refused(window_folder: Path) -> None:
    (path,) = window_folder.glob("*.safetensors")
    near = read_windows(path)
    assert read_window_set([window_folder]).map_view == "near"
    far = replace(near, near=np.pad(near.near, ((0, 0), (0, 24)), constant_values=-1))
    write_windows(window_folder / "z-far.safetensors", far)
    with pytest.raises(FileError, match=r"z-far\.safetensors: shows another part of the map"):
        read_window_set([window_folder])
    path.unlink()
    assert read_window_set([window_folder]).map_view == "far"


def test_an_epoch_draws_as_many_windows_of_each_kind_as_asked_for(tmp_path: Path) -> None:
    write(tmp_path, count=12, drives=4)
    driven = make_windows(4, drives=4, seed=9)
    write_windows(tmp_path / "driven.safetensors", replace(driven, map_name="other", extra={DRIVEN: "x"}))
    windows = read_window_set([tmp_path])
    assert windows.driven.sum() == 4
    few = of_epoch(windows, 8, 0.75, np.random.default_rng(0))
    assert (len(few), windows.driven[few].sum(), len(set(few.tolist()))) == (
        8,
        6,
        6,
    )  # each of the four, two twice
    assert of_epoch(windows, 0, 0.0, np.random.default_rng(0)).tolist() == list(range(16))
    many = np.bincount(of_epoch(windows, 40, 0.0, np.random.default_rng(0)))
    assert set(many.tolist()) == {2, 3}
    again, other = (of_epoch(windows, 8, 0.5, np.random.default_rng(seed)).tolist() for seed in (0, 1))
    assert again == of_epoch(windows, 8, 0.5, np.random.default_rng(0)).tolist()
    assert again != other


def test_a_share_of_windows_that_are_not_there_is_refused(window_folder: Path) -> None:
    windows = read_window_set([window_folder])
    with pytest.raises(
        ConfigError, match=r"0 that a model drove and 12 others; make the former with .* --driven-by"
    ):
        of_epoch(windows, 8, 0.5, np.random.default_rng(0))
