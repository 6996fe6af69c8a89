"""While a file is written, its path holds the old or the new content, never a part."""

from __future__ import annotations

from pathlib import Path

import pytest

from advdiff_sumo.core.whole_file import kept_while_same, whole_file


def test_the_new_file_appears_only_after_the_block(tmp_path: Path) -> None:
    path = tmp_path / "figures.json"
    path.write_text("old")
    with whole_file(path) as aside:
        aside.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [OSError("no room"), KeyboardInterrupt(), ValueError("no number")])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path, error: BaseException) -> None:
    path = tmp_path / "figures.json"
    path.write_text("old")

    def write() -> None:
        with whole_file(path) as aside:
            aside.write_text("ne")
            raise error

    with pytest.raises(type(error)):
        write()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_block_that_writes_nothing_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), whole_file(tmp_path / "figures.json"):
        pass


def test_the_temporary_file_has_the_given_ending(tmp_path: Path) -> None:
    with whole_file(tmp_path / "film.mp4", ".mp4") as aside:
        assert aside.suffix == ".mp4"
        aside.write_bytes(b"film")
    assert (tmp_path / "film.mp4").read_bytes() == b"film"


def test_a_cached_file_is_read_again_when_it_changes(tmp_path: Path) -> None:
    asked = []

    @kept_while_same(2)
    def read(path: str, how: str) -> str:
        asked.append(how)
        return Path(path).read_text() + how

    file = tmp_path / "f"
    file.write_text("one")
    assert [read(str(file), "!"), read(str(file), "!"), read(str(file), "?")] == ["one!", "one!", "one?"]
    file.write_text("other")
    assert read(str(file), "!") == "other!"
    assert asked == ["!", "?", "!"]
