"""Where the verbs print: a terminal, or a pipe or file, whose lines are as long as what stands in them."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

#: Width in characters of what is not a terminal; wider than any of our tables, which take no more than they need.
PIPED_WIDTH = 1000


def terminal(**options: Any) -> Console:
    """Return a console; *options* are those of :class:`rich.console.Console`.

    What is printed is plain text: names, paths and messages may hold ``[brackets]`` and ``:colons:``, in which Rich
    would see colours and pictures. Colours are given as ``style`` or as :class:`rich.text.Text`.

    Rich takes a pipe for 80 columns and breaks tables in it, within words, too. Here they are broken only where
    a person looks at them, or where the variable ``COLUMNS`` says how wide the output is to be.
    """
    console = Console(markup=False, emoji=False, **options)
    if not console.is_terminal and "COLUMNS" not in os.environ and "width" not in options:
        console.width = PIPED_WIDTH
    return console


def progress_bar(console: Console, transient: bool = False) -> Progress:
    """Return a bar with counts and the time left, shown where a person looks; *transient*: it vanishes at the end."""
    from rich.progress import (  # late: --help
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
    """One bar after the other.

    Attributes:
        said: the sentences that were printed above them.
    """

    def __init__(self, console: Console) -> None:
        self.said: list[str] = []
        self._bar = progress_bar(console)
        self._task: TaskID | None = None
        self._what = ""

    def __enter__(self) -> Bars:
        self._bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bar.stop()

    def begin(self, what: str, total: int, done: int = 0) -> None:
        """Begin a bar."""
        self._what = what
        self._task = self._bar.add_task(what, total=total, completed=done)

    def step(self, words: str = "") -> None:
        """Go one step on."""
        if self._task is not None:
            description = f"{self._what} · {words}" if words else self._what
            self._bar.update(self._task, advance=1, description=description)

    def say(self, sentence: str) -> None:
        """Print a sentence above the bars."""
        self.said.append(sentence)
        self._bar.console.print(sentence, soft_wrap=True)


def findings_table(findings: Iterable[tuple[Text, str, str]]) -> Table:
    """Return states, what they are of and what was found as a table without lines."""
    table = Table(show_header=False, box=None, padding=(0, 1))
    for _ in range(2):
        table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for state, what, found in findings:
        table.add_row(state, what, Text(found))
    return table


def print_json(content: Mapping[str, Any]) -> None:
    """Print *content* as one JSON object on standard output."""
    sys.stdout.write(json.dumps(content, ensure_ascii=False, allow_nan=False) + "\n")
