"""Tables in a pipe are as wide as their contents; text is printed unchanged."""

from __future__ import annotations

import io
import os
import subprocess
import sys

from rich.console import Console
from rich.table import Table

from advdiff_sumo.cli.terminal import Bars, progress_bar, terminal

_PROGRAM = """
from rich.table import Table
from advdiff_sumo.cli.terminal import terminal
table = Table("key", "what")
table.add_row("k" * 60, "w" * 60)
terminal().print(table)
"""


def _piped(columns: str | None) -> list[str]:
    environment = {name: value for name, value in os.environ.items() if name != "COLUMNS"}
    environment |= {} if columns is None else {"COLUMNS": columns}
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM], env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.splitlines()


def test_words_are_not_broken_in_a_pipe() -> None:
    for columns in (None, "0"):
        assert any("k" * 60 in line and "w" * 60 in line for line in _piped(columns))


def test_the_width_of_columns_is_used() -> None:
    lines = _piped("80")
    assert max(map(len, lines)) == 80
    assert not any("k" * 60 in line for line in lines)


def test_brackets_and_colons_are_not_markup() -> None:
    text = "runs/[red] ü [/lane] :smile:"
    sink = io.StringIO()
    console = terminal(file=sink, force_terminal=True, color_system=None)
    table = Table(text, title=text)
    table.add_row(text)
    console.print(table)
    console.print(text, style="red")
    with progress_bar(console) as bar:
        bar.add_task(text, total=1)
    assert sink.getvalue().count(text) >= 5


def _steps(console: Console, times_s: list[float]) -> None:
    """Advance a bar of 9 steps, 2 of them done before, at *times_s*; the first one is that of its making."""
    clock = iter(times_s)
    with Bars(console, lambda: next(clock)) as bars:
        bars.begin("episodes", total=9, done=2)
        for _ in times_s[1:]:
            bars.step("1 collision")


def test_without_a_terminal_there_is_a_line_every_five_minutes() -> None:
    sink = io.StringIO()
    _steps(terminal(file=sink), [100.0, 399.0, 400.0, 699.0, 750.0])
    assert sink.getvalue().splitlines() == [
        "episodes · 1 collision · 4 of 9",
        "episodes · 1 collision · 6 of 9",
    ]


def test_a_quiet_command_and_a_terminal_have_no_lines_on_the_progress() -> None:
    quiet, screen = io.StringIO(), io.StringIO()
    _steps(terminal(file=quiet, quiet=True), [0.0, 900.0])
    _steps(terminal(file=screen, force_terminal=True, color_system=None), [0.0, 900.0])
    assert quiet.getvalue() == ""
    assert "3 of 9" not in screen.getvalue()
