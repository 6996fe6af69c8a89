"""Output of the verbs: consoles, progress bars, tables and JSON."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

#: Width in characters of a pipe or file. It is wider than any table of ours, and tables are no wider than needed.
PIPED_WIDTH = 1000
#: Time between two lines on the progress in a pipe or file; many CI services end a job that is silent for ten minutes.
_LINE_EVERY_S = 300.0


def terminal(**options: Any) -> Console:
    """Return a console; *options* are those of :class:`rich.console.Console`.

    The console prints plain text: names, paths and messages may contain ``[brackets]`` and ``:colons:``, which Rich
    would interpret as markup and emoji. Give colours as ``style`` or as :class:`rich.text.Text`.

    Rich assumes 80 columns for a pipe and breaks tables, even within words. Here, tables are fitted to a width only in
    a terminal, or if the variable ``COLUMNS`` gives the width; some shells without a window set it to 0.
    """
    environment = {name: value for name, value in os.environ.items() if (name, value) != ("COLUMNS", "0")}
    console = Console(markup=False, emoji=False, _environ=environment, **options)
    if not console.is_terminal and "COLUMNS" not in environment and "width" not in options:
        console.width = PIPED_WIDTH
    return console


def progress_bar(console: Console, transient: bool = False) -> Progress:
    """Return a bar with counts and remaining time, shown only in a terminal; *transient*: it disappears at the end."""
    from rich.progress import (  # late: --help is quick
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
        disable=not console.is_terminal,
        transient=transient,
    )


class Bars:
    """Progress bars, one below the other; without a terminal, a line every five minutes.

    Args:
        console: receives them.
        clock: returns the time in s.

    Attributes:
        said: the sentences that were printed above the bars.
    """

    def __init__(self, console: Console, clock: Callable[[], float] = time.monotonic) -> None:
        self.said: list[str] = []
        self._bar = progress_bar(console)
        self._task: TaskID | None = None
        self._title = ""
        self._clock = clock
        self._last_line_s = clock()

    def __enter__(self) -> Bars:
        self._bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bar.stop()

    def begin(self, what: str, total: int, done: int = 0) -> None:
        """Begin a bar with the title *what* at *done* of *total* steps."""
        self._title = what
        self._task = self._bar.add_task(what, total=total, completed=done)

    def step(self, words: str = "") -> None:
        """Advance by one step and show *words* behind the title."""
        if self._task is not None:
            description = f"{self._title} · {words}" if words else self._title
            self._bar.update(self._task, advance=1, description=description)
            self._print_line(description)

    def _print_line(self, description: str) -> None:
        """Print how far the present bar is, if there is no terminal and the last line is old."""
        now_s = self._clock()
        if self._bar.console.is_terminal or now_s - self._last_line_s < _LINE_EVERY_S:
            return
        self._last_line_s = now_s
        task = self._bar.tasks[-1]
        self._bar.console.print(f"{description} · {task.completed:.0f} of {task.total:.0f}", soft_wrap=True)

    def say(self, sentence: str) -> None:
        """Print a sentence above the bars."""
        self.said.append(sentence)
        self._bar.console.print(sentence, soft_wrap=True)


def findings_table(findings: Iterable[tuple[Text, str, str]]) -> Table:
    """Return findings (state, topic, text) as a table without lines."""
    table = Table(show_header=False, box=None, padding=(0, 1))
    for _ in range(2):
        table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for state, topic, text in findings:
        table.add_row(state, topic, Text(text))
    return table


def print_json(content: Mapping[str, Any]) -> None:
    """Print *content* as one JSON object on standard output."""
    sys.stdout.write(json.dumps(content, ensure_ascii=False, allow_nan=False) + "\n")
