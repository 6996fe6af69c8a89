"""Put the tables of finished benches into docs/results.md: write_results.py [--from runs] [--check].

A place ``<!-- table NAME -->`` is filled from the folder ``bench-NAME``; places without one stay as they are.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from pathlib import Path

from advdiff_sumo.experiments.bench.table_cache import read_table
from advdiff_sumo.experiments.bench.write_table import markdown_text

PAGE = Path(__file__).resolve().parents[1] / "docs" / "results.md"
_PLACE = re.compile(r"(<!-- table ([\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)
_FLAGS = {"scenes": "--scenes", "policies": "--policies", "targets": "--targets", "horizon_s": "--horizon"}


def filled(page: str, folder: Path) -> str:
    """Return *page* with every place filled whose bench is in *folder*."""

    def put(found: re.Match[str]) -> str:
        bench = folder / f"bench-{found[2]}"
        if not (bench / "table.json").is_file():
            return found[0]
        return f"{found[1]}{command(bench)}\n\n{markdown_text(read_table(bench))}{found[3]}"

    return _PLACE.sub(put, page)


def command(bench: Path) -> str:
    """Return the command that asks for what the folder *bench* holds, as a line of the page."""
    request = json.loads((bench / "bench.json").read_text(encoding="utf-8"))["request"]
    words = ["advdiff-sumo", "bench", request["bench"]]
    for key, flag in _FLAGS.items():
        value = request[key]
        if isinstance(value, list):
            value = ",".join(value)
        if value and not (request["bench"] == "traffic" and key == "horizon_s"):
            words += [flag, f"{value:g}" if isinstance(value, float) else Path(str(value)).name]
    words += ["--data windows"] if request["data"] else []
    return f"`{' '.join(words)}`"


def main() -> int:
    """Write the page, or with ``--check`` return 1 when it is not what the folders hold."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--from", dest="folder", type=Path, default=Path("runs"), help="folder of the benches' folders"
    )
    parser.add_argument("--check", action="store_true", help="write nothing")
    asked = parser.parse_args()
    before = PAGE.read_text(encoding="utf-8")
    after = filled(before, asked.folder)
    if asked.check:
        if after != before:
            print(f"{PAGE.name} is behind the benches in {asked.folder}: run tools/write_results.py")
        return int(after != before)
    PAGE.write_text(after, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
