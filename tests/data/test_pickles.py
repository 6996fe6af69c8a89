"""The restricted unpickler: plain data comes through unchanged, everything else is refused and not run."""

from __future__ import annotations

import collections
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from advdiff_sumo.core.errors import LogError
from advdiff_sumo.data.pickles import load_plain

PLAIN: list[Any] = [
    {"a": [1, 2.5, None, True, "é", b"\x00"], "t": (1, (2,)), "s": {1, 2}, "f": frozenset({3})},
    np.arange(12.0).reshape(3, 4),
    np.asfortranarray(np.arange(12, dtype=">i4").reshape(3, 4)),
    np.zeros((0, 3), dtype=np.float32),
    np.array([True, False]),
    np.array(["LANE_STATE_GO", "é"]),
    np.array(3.0),
]


@pytest.mark.parametrize("protocol", [3, 4, 5])
@pytest.mark.parametrize("value", PLAIN, ids=lambda v: type(v).__name__)
def test_plain_data_comes_through(tmp_path: Path, value: Any, protocol: int) -> None:
    if protocol == 3 and isinstance(value, dict):
        value = {"a": value["a"], "t": value["t"]}  # sets are calls before protocol 4
    path = tmp_path / "v.pkl"
    path.write_bytes(pickle.dumps(value, protocol=protocol))
    loaded = load_plain(path)
    if isinstance(value, np.ndarray):
        assert isinstance(loaded, np.ndarray)
        assert loaded.dtype == value.dtype
        np.testing.assert_array_equal(loaded, value)
        assert loaded.flags.writeable
    else:
        assert loaded == value


def test_numbers_defaultdicts_and_shared_values(tmp_path: Path) -> None:
    shared = np.ones(2)
    value = {"n": np.float64(1.5), "d": collections.defaultdict(int, x=1), "one": shared, "two": shared}
    path = tmp_path / "v.pkl"
    path.write_bytes(pickle.dumps(value))
    loaded = load_plain(path)
    assert (loaded["n"], loaded["d"], type(loaded["d"])) == (1.5, {"x": 1}, dict)
    assert loaded["one"] is loaded["two"]


class _Runs:
    def __init__(self, *call: Any) -> None:
        self.call = call

    def __reduce__(self) -> Any:
        return self.call[0], tuple(self.call[1:])


def _touch(path: str) -> None:
    Path(path).touch()


@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
def test_a_malicious_record_is_refused_and_does_not_run(tmp_path: Path, protocol: int) -> None:
    ran = tmp_path / "ran"
    path = tmp_path / "v.pkl"
    for bad in (_Runs(exec, f"open({str(ran)!r}, 'w')"), _Runs(getattr, "", "join"), Path("x")):
        path.write_bytes(pickle.dumps({"id": [bad]}, protocol=protocol))
        with pytest.raises(LogError, match="refused: it asks for"):
            load_plain(path)
        assert not ran.exists()


@pytest.mark.parametrize(
    "raw",
    [
        b"cnumpy\nndarray\n(I3\ntR.",  # calls a type that may only be named
        b"cnumpy\ndtype\n(V\xc3\x28tR.",
        b"cnumpy\ndtype\n(VO\nI0\nI1\ntR.",  # a bare dtype is no plain value
        b"ccollections\ndefaultdict\n}(Vupdate\nI1\nsb.",  # sets attributes of an admitted class
        b"cnumpy.core.multiarray\n_reconstruct\n(I1\ntR.",  # an array without data
        b"cnumpy.core.multiarray\n__builtins__\n.",
        b"Voutside\nP.",
        b"P1\n.",
        b"(lp0\ng0\na.",  # a list that holds itself
        b"\x80\x04\x95",
        b"",
        b"plain text",
    ],
)
def test_crafted_bytes_are_refused(tmp_path: Path, raw: bytes) -> None:
    path = tmp_path / "v.pkl"
    path.write_bytes(raw)
    with pytest.raises(LogError):
        load_plain(path)


def test_arrays_of_objects_and_structures_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "v.pkl"
    for bad in (np.array([{}, None], dtype=object), np.zeros(2, dtype=[("a", "f8")])):
        path.write_bytes(pickle.dumps(bad))
        with pytest.raises(LogError, match="refused"):
            load_plain(path)


def test_a_truncated_record_is_named(tmp_path: Path) -> None:
    whole = pickle.dumps({"a": np.arange(100.0)})
    path = tmp_path / "v.pkl"
    for size in range(0, len(whole) - 1, 7):
        path.write_bytes(whole[:size])
        with pytest.raises(LogError, match=r"v\.pkl"):
            load_plain(path)
