"""Write the catalogue of docs/defects.md out of the code, or check it: write_defects_doc.py [--check].

With ``--bench FOLDER`` the table of a folder of ``bench defects`` becomes the page's baseline and
``docs/tables/defects.csv``, its ``by_stratum.csv`` ``docs/tables/defects-by-stratum.csv``.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

from advdiff_sumo.experiments.bench.defect_score import BY_STRATUM
from advdiff_sumo.experiments.bench.table import Cell, Line, Table
from advdiff_sumo.experiments.bench.table_cache import read_table
from advdiff_sumo.planners.defects.catalogue import catalogue_table

PAGE = Path(__file__).resolve().parents[1] / "docs" / "defects.md"
CSV = PAGE.parent / "tables" / "defects.csv"
_PLACE = re.compile(r"(<!-- catalogue -->\n).*?(<!-- end -->)", re.DOTALL)
_BASELINE = re.compile(r"(<!-- baseline -->\n).*?(<!-- end of baseline -->)", re.DOTALL)


def filled(page: str) -> str:
    """Return *page* with the catalogue as it is in the code."""
    return _PLACE.sub(lambda place: place[1] + catalogue_table() + place[2], page)


def baseline(table: Table) -> str:
    """Return the shares of *table* in whole percent, one row a defect, the score in numbers; bold: detected."""

    def cell_text(line: Line, cell: Cell | None) -> str:
        if cell is None or cell.found.value is None:
            return "–"
        if line.key == "score":
            return f"{cell.found.value * cell.found.n:.0f} of {cell.found.n}"
        text = f"{100.0 * cell.found.value:.0f}"
        return f"**{text}**" if cell.best else text

    text = f"|  | {' | '.join(head.title for head in table.heads)} |\n|---|{'--:|' * len(table.heads)}\n"
    for line in table.lines:
        name = f"{line.group}, sound" if line.key == "sound" else line.title
        cells = (cell_text(line, line.cells.get(head.key)) for head in table.heads)
        text += f"| {name} | {' | '.join(cells)} |\n"
    return f"{table.title}, valid failures in % of the episodes ([CSV](tables/defects.csv)):\n\n{text}"


def main() -> int:
    """Write the page, or with ``--check`` return 1 when it is not up to date."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing")
    parser.add_argument("--bench", type=Path, help="folder of the bench whose table is the baseline")
    asked = parser.parse_args()
    check = asked.check
    before = PAGE.read_text(encoding="utf-8")
    after = filled(before)
    if asked.bench is not None:
        text = baseline(read_table(asked.bench))
        after = _BASELINE.sub(lambda place: f"{place[1]}{text}{place[2]}", after)
        CSV.write_bytes((asked.bench / "table.csv").read_bytes())
        CSV.with_name("defects-by-stratum.csv").write_bytes((asked.bench / BY_STRATUM).read_bytes())
    if check and after != before:
        print(f"{PAGE.name} is behind the code: run tools/write_defects_doc.py")
        return 1
    if not check:
        PAGE.write_text(after, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
