"""Tables in terminals of every width: no heading is broken within a word, and left-out columns are named."""

from __future__ import annotations

import io

import pytest

from advdiff_sumo.cli.fitted_table import FittedTable
from advdiff_sumo.cli.terminal import terminal


def _table() -> FittedTable:
    table = FittedTable(
        "rates",
        ("target", "net", "valid failures", "arrives", "key"),
        unbroken=("key",),
        constant=("net",),
        dispensable=("arrives",),
    )
    table.add_row("lane_graph a:1, b:2", "downtown", "0.0 [0.0, 65.8]", "0.0 [0.0, 65.8]", "k" * 10)
    table.add_section()
    table.add_row("all", "", "0.0 [0.0, 65.8]", "0.0 [0.0, 65.8]", "k" * 10)
    return table


def _printed(table: FittedTable, width: int) -> list[str]:
    sink = io.StringIO()
    table.print(terminal(file=sink, width=width))
    return sink.getvalue().splitlines()


# Full width: columns of 19 + 8 + 15 + 15 + 10 characters and a frame of 5 * 3 + 1, 83 in all. Least width:
# 10 (lane_graph) + 8 (downtown) + 8 (failures) + 7 (arrives) + 10 (the key) + 16 = 59; 48 without net, and 38 without
# arrives, too.
@pytest.mark.parametrize(
    ("width", "left_out"),
    [
        (83, None),
        (59, None),
        (58, "net (downtown)"),
        (48, "net (downtown)"),
        (47, "net (downtown), arrives"),
        (38, "net (downtown), arrives"),
    ],
)
def test_no_word_of_a_heading_is_broken(width: int, left_out: str | None) -> None:
    lines = _printed(_table(), width)
    notes = [line for line in lines if line.startswith("no room")]
    note = f"no room for columns: {left_out}; a wider terminal or a file shows them"
    assert notes == ([] if left_out is None else [note])
    drawn = [line for line in lines if line[0] in "┃│┏┡├└"]
    assert max(map(len, drawn)) <= width
    heads = "".join(line for line in drawn if line.startswith("┃"))
    kept = {"target", "valid", "failures", "key"} | ({"arrives"} if width >= 48 else set())
    assert kept <= set(heads.replace("┃", " ").split())
    assert sum("k" * 10 in line for line in drawn) == 2


def test_all_room_is_used() -> None:
    assert "│ lane_graph a:1, b:2 │ downtown │ 0.0 [0.0, 65.8] │ 0.0 [0.0, 65.8] │ kkkkkkkkkk │" in _printed(
        _table(), 83
    )
    assert len(_printed(_table(), 48)) > len(_printed(_table(), 83))


def test_only_the_first_left_out_columns_are_named() -> None:
    heads = [f"column_{k}" for k in range(12)]
    table = FittedTable("", heads, dispensable=heads[:0:-1])
    table.add_row(*heads)
    lines = _printed(table, 24)  # room for the first two columns, of eight characters each
    names = ", ".join(heads[2:10])
    assert lines[-1] == f"no room for columns: {names}, … (10); a wider terminal or a file shows them"


def test_columns_that_differ_are_kept_though_there_is_no_room() -> None:
    table = FittedTable("", ("net", "target"), constant=("net", "target"))
    table.add_row("downtown", "IDM")
    table.add_row("motorway", "IDM")
    lines = _printed(table, 14)
    assert lines[-1].startswith("no room for columns: target (IDM); ")
    assert any("downtown" in line for line in lines)
