"""Window files: what is in them, that they come back, and what happens to damaged ones."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from advdiff_sumo.core.errors import FileError
from advdiff_sumo.data.window_files import (
    TENSORS,
    WindowFile,
    read_windows,
    window_paths,
    write_windows,
)
from tests.data.windows_made import random_file, small_file


def same(a: WindowFile, b: WindowFile) -> None:
    for field in fields(WindowFile):
        left, right = getattr(a, field.name), getattr(b, field.name)
        if isinstance(left, np.ndarray):
            np.testing.assert_array_equal(left, right)
            assert left.dtype == right.dtype
        else:
            assert left == right


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31), windows=st.integers(0, 6))
def test_what_is_written_is_read_and_equal_windows_are_equal_bytes(
    tmp_path_factory: pytest.TempPathFactory, seed: int, windows: int
) -> None:
    folder = tmp_path_factory.mktemp("w")
    made = random_file(seed, windows)
    write_windows(folder / "a.safetensors", made)
    write_windows(folder / "b.safetensors", made)
    same(made, read_windows(folder / "a.safetensors"))
    assert (folder / "a.safetensors").read_bytes() == (folder / "b.safetensors").read_bytes()
    assert sorted(p.name for p in folder.iterdir()) == ["a.safetensors", "b.safetensors"]


def test_the_header_says_what_it_is(tmp_path: Path) -> None:
    write_windows(tmp_path / "w.safetensors", small_file())
    with safe_open(tmp_path / "w.safetensors", framework="numpy") as file:
        header = file.metadata()
    assert header == {
        "format": "advdiff-windows-1",
        "source": "by hand",
        "map": "lane",
        "dt_s": "0.5",
        "scene_names": '["first", "second"]',
        "note": "ä",
    }


def test_other_safetensors_readers_read_it(tmp_path: Path) -> None:
    write_windows(tmp_path / "w.safetensors", small_file())
    assert set(load_file(tmp_path / "w.safetensors")) == set(TENSORS)


def test_reading_needs_no_sumo_and_no_geometry() -> None:
    code = "import advdiff_sumo.data.window_files, advdiff_sumo.data.window_arrays, advdiff_sumo.data.stats, sys\n"
    code += "assert not {'sumolib', 'libsumo', 'traci', 'shapely', 'pyarrow', 'torch'} & set(sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def wrong_format(path: Path) -> None:
    save_file({"x": np.zeros(1)}, path)


def truncated(path: Path) -> None:
    write_windows(path, small_file())
    path.write_bytes(path.read_bytes()[:-100])


def text(path: Path) -> None:
    path.write_text("windows")


def lacks_tensors(path: Path) -> None:
    tensors: dict[str, Any] = {name: getattr(small_file(), name) for name in TENSORS if name != "near"}
    save_file(tensors, path, metadata={"format": "advdiff-windows-1"})


def scene_unnamed(path: Path) -> None:
    tensors: dict[str, Any] = {name: getattr(small_file(), name) for name in TENSORS}
    save_file(tensors, path, metadata={"format": "advdiff-windows-1", "scene_names": '["one"]'})


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (wrong_format, "is no window file (format 'none'"),
        (truncated, "is truncated or no safetensors file"),
        (text, "is truncated or no safetensors file"),
        (lacks_tensors, "lacks the tensors near"),
        (scene_unnamed, "scene points outside the 1 scene names"),
    ],
)
def test_a_damaged_file_is_refused_by_name(tmp_path: Path, damage: Any, words: str) -> None:
    path = tmp_path / "bad.safetensors"
    damage(path)
    with pytest.raises(FileError) as caught:
        read_windows(path)
    assert words in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"offset": np.array([0, 2, 4], dtype=np.int64)}, "offset does not divide"),
        ({"offset": np.array([0, 0, 3], dtype=np.int64)}, "offset does not divide"),
        ({"past": np.zeros((3, 4, 4), dtype=np.float32)}, "past has shape"),
        ({"size": np.zeros((3, 2))}, "size is float64"),
        ({"near": np.full((3, 40), 6, dtype=np.int32)}, "near points outside"),
        ({"map_signal": np.full(6, 1, dtype=np.int32)}, "map_signal points outside"),
        ({"past_valid": np.zeros((3, 5), dtype=np.bool_)}, "not there now"),
    ],
)
def test_windows_that_do_not_fit_together_are_refused(change: dict[str, Any], words: str) -> None:
    made = small_file()
    assert made.agents == 3
    with pytest.raises(ValueError, match=words):
        replace(made, **change)


def test_places_are_files_or_folders_of_them(tmp_path: Path) -> None:
    for name in ("b", "a"):
        write_windows(tmp_path / f"{name}.safetensors", small_file())
    (tmp_path / "nets").mkdir()
    inside = [tmp_path / "a.safetensors", tmp_path / "b.safetensors"]
    assert window_paths([tmp_path]) == inside
    assert window_paths([inside[1]]) == inside[1:]
    with pytest.raises(FileError, match="no such file or folder"):
        window_paths([tmp_path / "c"])
    with pytest.raises(FileError, match="holds no window file"):
        window_paths([tmp_path / "nets"])


def test_a_folder_that_is_not_there_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="cannot be written"):
        write_windows(tmp_path / "no" / "w.safetensors", small_file())
