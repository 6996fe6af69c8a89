"""Compare verdicts with the clairvoyant search; exit code 1 if they contradict each other.

advdiff-sumo verdict FOLDER --search
python tools/check_verdicts.py FOLDER ... [--differences]

If a reference driver avoids a collision, the search, which knows the future of the others, must find a drive that
avoids it, too.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from advdiff_sumo.core.errors import FileError
from advdiff_sumo.data.run_tables import RunTables

COLUMNS = (
    "episode",
    "with_target",
    "initial",
    "second",
    "time_s",
    "preventable_by",
    "solvable",
    "unavoidable",
)
REMEDY = "give folders judged by verdict --search"
Row = Mapping[str, Any]


def main() -> int:
    """Print how many collisions the drivers and the search avoid; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+", help="runs or sweeps judged with --search")
    parser.add_argument("--differences", action="store_true", help="name the collisions that contradict")
    given = parser.parse_args()
    try:
        rows = [(folder, row) for folder in given.folders for row in searched_collisions(folder)]
    except FileError as error:
        print(f"check_verdicts: {error}", file=sys.stderr)
        return 2
    if not rows:
        print(
            "check_verdicts: nothing was searched; run advdiff-sumo verdict FOLDER --search", file=sys.stderr
        )
        return 2
    contradictions = [(folder, row) for folder, row in rows if contradicts(row)]
    avoided = [row for _, row in rows if row["preventable_by"]]
    human = sum("CC_human_driver" in row["preventable_by"] for row in avoided)
    print(f"{len(rows)} collisions of the target")
    print(f"{human} avoided by the careful driver, {len(avoided)} by any reference driver")
    print(f"{sum(row['solvable'] for _, row in rows)} avoided by a drive of the search")
    print(f"{sum(bool(row['unavoidable']) for _, row in rows)} unavoidable")
    print(f"{len(contradictions)} contradictions")
    if given.differences:
        for folder, row in contradictions:
            print(f"    {folder}: episode {row['episode']}, {row['second']}, by {row['preventable_by']}")
    return 1 if contradictions else 0


def searched_collisions(folder: Path) -> list[Row]:
    """Return the rows of the target's collisions in *folder* for which the search was run.

    Raises:
        FileError: the table is missing or damaged, or was written by an earlier version.
    """
    tables = RunTables(folder, remedy=REMEDY)
    if missing := set(COLUMNS) - tables.columns("collisions"):
        raise FileError(folder, f"lacks the columns {', '.join(sorted(missing))}", REMEDY)
    rows = tables.rows("collisions", COLUMNS).to_pylist()
    return [row for row in rows if row["with_target"] and row["solvable"] is not None]


def contradicts(row: Row) -> bool:
    """Return whether a reference driver avoids the collision, but the search finds no drive or it is "unavoidable"."""
    return bool(row["preventable_by"]) and (not row["solvable"] or row["unavoidable"] is not False)


if __name__ == "__main__":
    sys.exit(main())
