"""Write the column tables of docs/outputs.md out of the code, or check them: write_outputs_doc.py [--check]."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Mapping
from pathlib import Path

from advdiff_sumo.metrics.columns import Column
from advdiff_sumo.sim.run_store import TABLES

PAGE = Path(__file__).resolve().parents[1] / "docs" / "outputs.md"
_PLACE = re.compile(r"(<!-- columns of (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def table(columns: Mapping[str, Column]) -> str:
    """Return *columns* as a Markdown table."""
    lines = ["| column | type | unit | empty? | meaning |", "|---|---|---|---|---|"]
    for name, column in columns.items():
        empty = "may be" if column.nullable else "never"
        lines.append(f"| `{name}` | {column.dtype} | {column.unit} | {empty} | {column.description} |")
    return "\n".join(lines) + "\n"


def filled(page: str) -> str:
    """Return *page* with each marked place filled from the code.

    Raises:
        ValueError: a table has no place in it, or a place no table.
    """
    places = [name for _, name, _ in _PLACE.findall(page)]
    if sorted(places) != sorted(TABLES):
        raise ValueError(f"the page has places for {places}, the tables are {list(TABLES)}")
    return _PLACE.sub(lambda found: found[1] + table(TABLES[found[2]]) + found[3], page)


def main() -> int:
    """Write the page, or with ``--check`` return 1 when it is not up to date."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing")
    check = parser.parse_args().check
    before = PAGE.read_text(encoding="utf-8")
    after = filled(before)
    if check and after != before:
        print(f"{PAGE.name} is behind the code: run tools/write_outputs_doc.py")
        return 1
    if not check:
        PAGE.write_text(after, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
