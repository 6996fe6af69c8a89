"""Write the catalogue of docs/defects.md out of the code, or check it: write_defects_doc.py [--check].

With ``--bench FOLDER`` the table of a folder of ``bench defects`` becomes the page's baseline, too.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

from advdiff_sumo.planners.defects.catalogue import catalogue_table

PAGE = Path(__file__).resolve().parents[1] / "docs" / "defects.md"
_PLACE = re.compile(r"(<!-- catalogue -->\n).*?(<!-- end -->)", re.DOTALL)
_BASELINE = re.compile(r"(<!-- baseline -->\n).*?(<!-- end of baseline -->)", re.DOTALL)


def filled(page: str) -> str:
    """Return *page* with the catalogue as it is in the code."""
    return _PLACE.sub(lambda place: place[1] + catalogue_table() + place[2], page)


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
        table = (asked.bench / "table.md").read_text(encoding="utf-8")
        table = re.sub(r" Revision: .*", "", table)  # the page's own history has it
        after = _BASELINE.sub(lambda place: f"{place[1]}{table}\n{place[2]}", after)
    if check and after != before:
        print(f"{PAGE.name} is behind the code: run tools/write_defects_doc.py")
        return 1
    if not check:
        PAGE.write_text(after, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
