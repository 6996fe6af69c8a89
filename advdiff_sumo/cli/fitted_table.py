"""Tables that fit the terminal: headings break only between words, and the least important columns are left out."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table

_UNBROKEN_LENGTH = 14
"""Longer words of entries may be broken if there is no room."""
_LISTED_COLUMNS = 8
"""Number of left-out columns that are named."""
_FRAME_WIDTH = 3
"""Characters of the frame for each column; the table has one more."""


@dataclass
class FittedTable:
    """A table that is fitted to the width of the console when it is printed.

    Attributes:
        title: printed above the table.
        heads: headings of the columns.
        unbroken: headings of columns whose entries users copy; these are never broken.
        constant: headings of columns that are left out first if all their entries are equal.
        dispensable: headings of columns that are left out next, in this order.
        rows: entries of each row; an empty row is a line.
    """

    title: str
    heads: Sequence[str]
    unbroken: Sequence[str] = ()
    constant: Sequence[str] = ()
    dispensable: Sequence[str] = ()
    rows: list[tuple[str, ...]] = field(default_factory=list)

    def add_row(self, *entries: str) -> None:
        """Add a row."""
        self.rows.append(entries)

    def add_section(self) -> None:
        """Draw a line below the last row."""
        self.rows.append(())

    def print(self, console: Console) -> None:
        """Print the table, and which columns are left out."""
        kept = self._kept_columns(console.width)
        table = Table(title=self.title or None, title_justify="left")
        for column, width in zip(kept, self._widths(kept, console.width), strict=True):
            head = self.heads[column]
            table.add_column(head, overflow="fold", no_wrap=head in self.unbroken, width=width)
        for row in self.rows:
            if row:
                table.add_row(*(row[column] for column in kept))
            else:
                table.add_section()
        console.print(table)
        if len(kept) < len(self.heads):
            omitted = [self._omitted_text(column) for column in range(len(self.heads)) if column not in kept]
            names = ", ".join(omitted[:_LISTED_COLUMNS])
            names += f", … ({len(omitted)})" if len(omitted) > _LISTED_COLUMNS else ""
            console.print(
                f"no room for columns: {names}; a wider terminal or a file shows them", soft_wrap=True
            )

    def _kept_columns(self, width: int) -> list[int]:
        """Return the numbers of the columns for which there is room."""
        kept = list(range(len(self.heads)))
        constant = [column for column in self._numbers(self.constant) if len(self._distinct(column)) == 1]
        for column in dict.fromkeys((*constant, *self._numbers(self.dispensable))):
            if _table_width(map(self._min_width, kept)) <= width:
                break
            kept.remove(column)
        return kept

    def _numbers(self, heads: Sequence[str]) -> list[int]:
        return [column for head in heads for column in range(len(self.heads)) if self.heads[column] == head]

    def _widths(self, kept: Sequence[int], width: int) -> list[int | None]:
        """Return the width of each column; None, for Rich to choose, if even the least widths do not fit."""
        min_widths = [self._min_width(column) for column in kept]
        full_widths = [self._full_width(column) for column in kept]
        if _table_width(min_widths) > width:
            return [None] * len(kept)
        fitting = min_widths
        for level in range(
            max(full_widths, default=0) + 1
        ):  # all columns grow together up to their full widths
            wider = [max(low, min(high, level)) for low, high in zip(min_widths, full_widths, strict=True)]
            if _table_width(wider) > width:
                break
            fitting = wider
        return list(fitting)

    def _min_width(self, column: int) -> int:
        """Return the width at which no word of the heading and only long words of the entries are broken."""
        if self.heads[column] in self.unbroken:
            return self._full_width(column)
        longest_word = _longest(word for entry in self._entries(column) for word in entry.split())
        return max(_longest(self.heads[column].split()), min(_UNBROKEN_LENGTH, longest_word), 1)

    def _full_width(self, column: int) -> int:
        return max(cell_len(self.heads[column]), _longest(self._entries(column)), 1)

    def _entries(self, column: int) -> list[str]:
        return [line for row in self.rows if row for line in row[column].splitlines()]

    def _distinct(self, column: int) -> list[str]:
        """Return the different entries of a column, except empty ones, which rows of sums have."""
        return list(dict.fromkeys(filter(None, self._entries(column))))

    def _omitted_text(self, column: int) -> str:
        """Return the heading of a column that is left out; for a constant one, with its entry."""
        head = self.heads[column]
        return f"{head} ({', '.join(self._distinct(column))})" if head in self.constant else head


def _longest(words: Iterable[str]) -> int:
    return max(map(cell_len, words), default=0)


def _table_width(widths: Iterable[int]) -> int:
    sizes = list(widths)
    return sum(sizes) + _FRAME_WIDTH * len(sizes) + 1
