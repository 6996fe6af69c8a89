"""Write the figures of finished benches to docs/tables and docs/results.md: write_results.py [--from runs] [--check].

A folder ``bench-NAME`` becomes ``docs/tables/NAME.csv``, ``NAME-differences.csv``, an entry of ``provenance.json``,
and, if the bench has them, ``NAME-by-stratum.csv`` and ``NAME-findings.csv``. ``tools/results_tables.toml`` says which
cells a place ``<!-- table NAME -->`` of the page shows. They come from that CSV and from those under ``also``: further
runs of the same bench, such as backgrounds that were run later.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

from advdiff_sumo.experiments.bench.bench_config import Request
from advdiff_sumo.experiments.bench.defect_score import BY_STRATUM, FINDINGS
from advdiff_sumo.experiments.bench.table_cache import read_table
from advdiff_sumo.experiments.bench.write_table import csv_text

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "results.md"
TABLES = ROOT / "docs" / "tables"
SELECTION = ROOT / "tools" / "results_tables.toml"
PROVENANCE = "provenance.json"
_PLACE = re.compile(r"(<!-- table ([\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)
_FLAGS = {"scenes": "--scenes", "policies": "--policies", "targets": "--targets", "horizon_s": "--horizon"}
#: Options that are part of the printed command if they differ from their defaults.
_OPTIONAL = ("licence", "seeds", "steps", "samples", "defects", "severity")
_KEY = ("target", "row", "column")


def bench_files(runs: Path, names: list[str]) -> dict[str, str]:
    """Return file → text for ``docs/tables``, from the finished benches in *runs*.

    Args:
        runs: folder that contains the benches' folders.
        names: tables of the page.
    """
    provenance = json.loads((TABLES / PROVENANCE).read_text(encoding="utf-8"))
    files: dict[str, str] = {}
    for name in names:
        bench = runs / f"bench-{name}"
        if (bench / "table.json").is_file():
            table = read_table(bench)
            files[f"{name}.csv"] = csv_text(table, table.heads)
            files[f"{name}-differences.csv"] = (bench / "differences.csv").read_text(encoding="utf-8")
            for more in (BY_STRATUM, FINDINGS):
                if (bench / more).is_file():
                    published = f"{name}-{more.replace('_', '-')}"
                    files[published] = (bench / more).read_text(encoding="utf-8")
            provenance[name] = {"command": command(bench), "title": table.title, "notes": list(table.notes)}
    files[PROVENANCE] = json.dumps(provenance, indent=1, sort_keys=True, ensure_ascii=False) + "\n"
    return files


def filled(page: str, files: dict[str, str], selection: dict[str, Any]) -> str:
    """Return *page* with every place filled from *files*, or from ``docs/tables`` if a file is missing there."""

    def text(name: str) -> str:
        return files[name] if name in files else (TABLES / name).read_text(encoding="utf-8")

    provenance = json.loads(text(PROVENANCE))

    def place(match: re.Match[str]) -> str:
        chosen = selection[match[2]]
        first, *also = tables_of(match[2], selection)
        lines = [line for name in (first, *also) for line in csv.DictReader(text(f"{name}.csv").splitlines())]
        more = ", ".join(f"[{chosen['also'][name]}](tables/{name}.csv)" for name in also)
        source = _source(first, provenance) + (f"; CSV: {more}" if more else "")
        return f"{match[1]}{picked(lines, chosen)}\n{source}\n{match[3]}"

    return _PLACE.sub(place, page)


def read_selection() -> dict[str, Any]:
    """Return place → the cells that it shows."""
    return tomllib.loads(SELECTION.read_text(encoding="utf-8"))


def tables_of(name: str, selection: dict[str, Any]) -> list[str]:
    """Return the names of the tables that the place *name* of the page shows."""
    return [name, *selection[name].get("also", ())]


def _source(name: str, provenance: dict[str, Any]) -> str:
    differences = f"{name}-differences.csv"
    pairs = f", [pairs](tables/{differences})" if (TABLES / differences).is_file() else ""
    return f"[CSV](tables/{name}.csv){pairs}, `{provenance[name]['command']}`"


def picked(lines: list[dict[str, str]], selection: dict[str, Any]) -> str:
    """Return a Markdown table of the cells that *selection* picks from *lines* of a CSV file.

    A row and a column of the selection together give ``target``, ``row`` and ``column``, which identify a line.
    """
    cells = {tuple(line[key] for key in _KEY): line for line in lines}
    text = f"|  | {' | '.join(column['title'] for column in selection['columns'])} |\n"
    text += "|---|" + "--:|" * len(selection["columns"]) + "\n"
    for row in selection["rows"]:
        cells_text = []
        for column in selection["columns"]:
            asked = {"target": "", **row, **column}
            cells_text.append(_cell(cells.get(tuple(asked[key] for key in _KEY)), column.get("digits", 1)))
        text += f"| {row.get('title', row['row'])} | {' | '.join(cells_text)} |\n"
    return text


def _cell(line: dict[str, str] | None, digits: int) -> str:
    if line is None or not line["value"]:
        return "–"
    value = f"{float(line['value']):.{digits}f}"
    if not line["low"]:
        return value
    return f"{value} [{float(line['low']):.{digits}f}, {float(line['high']):.{digits}f}]"


def command(bench: Path) -> str:
    """Return the command that produced the folder *bench*."""
    request = json.loads((bench / "bench.json").read_text(encoding="utf-8"))["request"]
    words = ["advdiff-sumo", "bench", request["bench"]]
    for key, flag in _FLAGS.items():
        value = request[key]
        if isinstance(value, list):
            value = ",".join(value)
        if value and not (request["bench"] == "traffic" and key == "horizon_s"):
            words += [flag, f"{value:g}" if isinstance(value, float) else Path(str(value)).name]
    words += ["--data windows"] if request["data"] else []
    for key in _OPTIONAL:
        value = request.get(key)
        if value and value != Request.model_fields[key].default:
            words += [f"--{key}", ",".join(value) if isinstance(value, list) else str(value)]
    return " ".join(words)


def main() -> int:
    """Write tables and page; with ``--check``, return 1 if they differ from the contents of the folders."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--from", dest="folder", type=Path, default=Path("runs"), help="folder of the benches' folders"
    )
    parser.add_argument("--check", action="store_true", help="write nothing")
    options = parser.parse_args()
    before = PAGE.read_text(encoding="utf-8")
    selection = read_selection()
    places = [match[2] for match in _PLACE.finditer(before)]
    names = [name for place in places for name in tables_of(place, selection)]
    names += [name for place in places for name in selection[place].get("findings", ()) if name not in names]
    files = bench_files(options.folder, names)
    after = {PAGE: filled(before, files, selection), **{TABLES / name: text for name, text in files.items()}}
    stale = [
        path for path, text in after.items() if not path.is_file() or path.read_text(encoding="utf-8") != text
    ]
    if options.check:
        for path in stale:
            print(f"{path.name} is behind the benches in {options.folder}: run tools/write_results.py")
        return int(bool(stale))
    for path in stale:
        path.write_text(after[path], encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
