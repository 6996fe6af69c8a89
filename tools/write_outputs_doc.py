"""Write or check the column tables of docs/outputs.md, from the code: write_outputs_doc.py [--check]."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Mapping
from itertools import takewhile
from pathlib import Path

from advdiff_sumo.metrics.columns import Column
from advdiff_sumo.sim.run_store import TABLES

PAGE = Path(__file__).resolve().parents[1] / "docs" / "outputs.md"
_PLACE = re.compile(r"(<!-- columns of (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)
SHOWN = ("episodes", "states")
"""Tables whose columns the page shows; ``advdiff-sumo list columns`` prints all."""
_IN_EVERY_TABLE = "episode"
"""This column is explained in the page's introduction."""


def table(columns: Mapping[str, Column]) -> str:
    """Return *columns* as a Markdown table; successive columns with the same description share a row."""
    lines = ["| column | meaning |", "|---|---|"]
    names = [name for name in columns if name != _IN_EVERY_TABLE]
    while names:
        run = _with_same_description(names, columns)
        cells = ", ".join(f"`{name}`{'?' * columns[name].nullable}" for name in run)
        lines.append(f"| {cells} | {columns[run[0]].description} |")
        names = names[len(run) :]
    return "\n".join(lines) + "\n"


def _with_same_description(names: list[str], columns: Mapping[str, Column]) -> list[str]:
    """Return the leading *names* that have the same description in *columns*."""
    description = columns[names[0]].description
    return list(takewhile(lambda name: columns[name].description == description, names))


def filled(page: str) -> str:
    """Return *page* with the tables of the code at the marked places.

    Raises:
        ValueError: a table has no place, or a place has no table.
    """
    places = [name for _, name, _ in _PLACE.findall(page)]
    if sorted(places) != sorted(SHOWN):
        raise ValueError(f"the page has places for {places}, the tables are {list(SHOWN)}")
    return _PLACE.sub(lambda place: place[1] + table(TABLES[place[2]]) + place[3], page)


def write_or_check(page: Path, fill: Callable[[str], str], about: str | None, source: str) -> int:
    """Write *page* as returned by *fill*; with ``--check``, return 1 if it is not up to date.

    Args:
        page: the file.
        fill: text of the page → updated text.
        about: description for ``--help``.
        source: where the contents come from, for the message.
    """
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing")
    check = parser.parse_args().check
    before = page.read_text(encoding="utf-8")
    after = fill(before)
    if check and after != before:
        print(f"{page.name} is behind {source}: run tools/{Path(sys.argv[0]).name}")
        return 1
    if not check:
        page.write_text(after, encoding="utf-8")
    return 0


def main() -> int:
    """Write the page; with ``--check``, return 1 if it is not up to date."""
    return write_or_check(PAGE, filled, __doc__, "the code")


if __name__ == "__main__":
    sys.exit(main())
