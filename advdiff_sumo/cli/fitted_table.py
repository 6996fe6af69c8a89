"""Tables that fit the terminal: headings are broken between words only, and columns that matter least are left out."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table

_LONGEST_PART = 14
"""Longer words of entries are broken where there is no room."""
_SAID = 8
"""So many of the columns that are left out are named."""
_FRAME = 3
"""Characters that the frame takes for each column; and one for the table."""


@dataclass
class FittedTable:
    """A table that is fitted to the width of the console when it is printed.

    Attributes:
        title: above it.
        heads: headings of the columns.
        whole: headings of columns whose entries are copied, and so never broken.
        alike: headings of columns that go first where there is no room, if all that they say is the same.
        dispensable: headings of columns that go after them, the first one first.
        rows: entries of each row; an empty one stands for a line.
    """

    title: str
    heads: Sequence[str]
    whole: Sequence[str] = ()
    alike: Sequence[str] = ()
    dispensable: Sequence[str] = ()
    rows: list[tuple[str, ...]] = field(default_factory=list)

    def add_row(self, *entries: str) -> None:
        """Add a row."""
        self.rows.append(entries)

    def add_section(self) -> None:
        """Draw a line below the last row."""
        self.rows.append(())

    def print(self, console: Console) -> None:
        """Print it, and say which columns are left out."""
        kept = self._kept(console.width)
        table = Table(title=self.title or None, title_justify="left")
        for at, width in zip(kept, self._widths(kept, console.width), strict=True):
            head = self.heads[at]
            table.add_column(head, overflow="fold", no_wrap=head in self.whole, width=width)
        for row in self.rows:
            if row:
                table.add_row(*(row[at] for at in kept))
            else:
                table.add_section()
        console.print(table)
        if len(kept) < len(self.heads):
            lost = [self._told(at) for at in range(len(self.heads)) if at not in kept]
            names = ", ".join(lost[:_SAID]) + (f", … ({len(lost)})" if len(lost) > _SAID else "")
            console.print(
                f"no room for columns: {names}; a wider terminal or a file shows them", soft_wrap=True
            )

    def _kept(self, width: int) -> list[int]:
        """Return the places of the columns for which there is room."""
        kept = list(range(len(self.heads)))
        first = [at for at in self._places(self.alike) if len(self._said(at)) == 1]
        for at in dict.fromkeys((*first, *self._places(self.dispensable))):
            if _total(map(self._least, kept)) <= width:
                break
            kept.remove(at)
        return kept

    def _places(self, heads: Sequence[str]) -> list[int]:
        return [at for head in heads for at in range(len(self.heads)) if self.heads[at] == head]

    def _widths(self, kept: Sequence[int], width: int) -> list[int | None]:
        """Return how wide each column is; None, for Rich to choose, where not even the least widths have room."""
        least, most = [self._least(at) for at in kept], [self._most(at) for at in kept]
        if _total(least) > width:
            return [None] * len(kept)
        fitting = least
        for level in range(max(most, default=0) + 1):  # all grow alike until they have what they need
            wider = [max(low, min(high, level)) for low, high in zip(least, most, strict=True)]
            if _total(wider) > width:
                break
            fitting = wider
        return list(fitting)

    def _least(self, at: int) -> int:
        """Return the width at which no word of the heading, and no but a long one of the entries, is broken."""
        if self.heads[at] in self.whole:
            return self._most(at)
        parts = _longest(word for entry in self._entries(at) for word in entry.split())
        return max(_longest(self.heads[at].split()), min(_LONGEST_PART, parts), 1)

    def _most(self, at: int) -> int:
        return max(cell_len(self.heads[at]), _longest(self._entries(at)), 1)

    def _entries(self, at: int) -> list[str]:
        return [line for row in self.rows if row for line in row[at].splitlines()]

    def _said(self, at: int) -> list[str]:
        """Return the different entries of a column; empty ones, as in sums, do not count."""
        return list(dict.fromkeys(filter(None, self._entries(at))))

    def _told(self, at: int) -> str:
        """Return the heading of a column that is left out, with what it says where that is one thing."""
        head = self.heads[at]
        return f"{head} ({', '.join(self._said(at))})" if head in self.alike else head


def _longest(words: Iterable[str]) -> int:
    return max(map(cell_len, words), default=0)


def _total(widths: Iterable[int]) -> int:
    sizes = list(widths)
    return sum(sizes) + _FRAME * len(sizes) + 1
