"""Tables read in chunks are the tables."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from advdiff_sumo.core.errors import LogError
from advdiff_sumo.data import tables
from advdiff_sumo.data.tables import parsed, records


@pytest.mark.parametrize("indent", [None, 0, 2])
@pytest.mark.parametrize("chunk", [64, 97, 1 << 20])
def test_chunks_do_not_show(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, indent: int | None, chunk: int
) -> None:
    rows = [{"token": str(n), "text": "]}, {é" * (n % 3), "list": [n, [1.5, None]]} for n in range(50)]
    path = tmp_path / "t.json"
    path.write_text("\n " + json.dumps(rows, indent=indent), encoding="utf-8")
    monkeypatch.setattr(tables, "_CHUNK", chunk)
    assert list(records(path)) == rows


def test_an_empty_table_has_no_records(tmp_path: Path) -> None:
    path = tmp_path / "attribute.json"
    path.write_text("[]")
    assert list(records(path)) == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is not a JSON array"),
        ('{"a": 1}', "is not a JSON array"),
        ("[1]", "record 0 is no object"),
        ('[{"a": 1}, {"a"', "ends within record 1: the file is truncated"),
        ('[{"a": 1}', "ends within record 1: the file is truncated"),
    ],
)
def test_what_is_no_table_is_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "t.json"
    path.write_text(text)
    with pytest.raises(LogError, match=said):
        list(records(path))


@pytest.mark.parametrize("chunk", [64, 1 << 20])
def test_rubbish_in_the_middle_is_not_called_truncated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, chunk: int
) -> None:
    path = tmp_path / "t.json"
    path.write_text('[{"a": 1}, {"a": oops}' + ', {"a": 2}' * 100 + "]")
    monkeypatch.setattr(tables, "_CHUNK", chunk)
    monkeypatch.setattr(tables, "_LONGEST", chunk)
    with pytest.raises(LogError, match="record 1 is not JSON"):
        list(records(path))


def test_not_text(tmp_path: Path) -> None:
    path = tmp_path / "t.json"
    path.write_bytes(b'[{"a": "\xff\xfe"}]')
    with pytest.raises(LogError, match="not UTF-8"):
        list(records(path))
    with pytest.raises(LogError, match="cannot be read"):
        list(records(tmp_path))


def test_the_record_that_fails_is_named(tmp_path: Path) -> None:
    path = tmp_path / "t.json"
    path.write_text('[{"token": "a", "n": 1}, {"token": "b", "n": "x"}]')
    with pytest.raises(LogError, match=r"record 1 \(token b\) cannot be used"):
        list(parsed(path, lambda r: int(r["n"])))
