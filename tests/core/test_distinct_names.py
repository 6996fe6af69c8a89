"""Distinct names for files of the same name in several folders."""

from __future__ import annotations

from pathlib import Path

from advdiff_sumo.core.distinct_names import distinct_names


def named(*paths: str) -> list[str]:
    files = {Path(path): Path(path).name.split(".")[0] for path in paths}
    return list(distinct_names(files).values())


def test_as_many_folders_as_needed_are_prepended() -> None:
    assert named("a/n/b.xml", "c/n/b.xml", "n/d.xml") == ["a-n-b", "c-n-b", "d"]
    assert named("b.xml", "a/b.xml") == ["b", "a-b"]
    assert named("/b.xml", "/a/b.xml") == ["b", "a-b"]


def test_files_in_one_folder_get_their_full_names() -> None:
    assert named("a/b.xml", "a/b.net.xml") == ["a-b.xml", "a-b.net.xml"]


def test_distinct_names_do_not_change() -> None:
    assert named("a/b.xml", "a/c.xml") == ["b", "c"]
    assert distinct_names({}) == {}
