"""Check that the target of every relative link and picture in Markdown files exists: python tools/check_links.py."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

_LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
_HEADING = re.compile(r"^#+\s+(.*)$", re.MULTILINE)
_FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)


def anchors(text: str) -> set[str]:
    """Return the anchors of a page's headings, as code-hosting sites make them."""
    plain = (
        re.sub(r"[`*_]", "", heading).strip().lower() for heading in _HEADING.findall(_FENCE.sub("", text))
    )
    return {re.sub(r"[^\w\- ]", "", heading).replace(" ", "-") for heading in plain}


def broken(page: Path) -> list[str]:
    """Return a line for each link of *page* whose target does not exist."""
    problems = []
    for target in _LINK.findall(_FENCE.sub("", page.read_text(encoding="utf-8"))):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, anchor = target.partition("#")
        path = (page.parent / name) if name else page
        if not path.exists():
            problems.append(f"{page}: no such file: {target}")
        elif anchor and path.suffix == ".md" and anchor not in anchors(path.read_text(encoding="utf-8")):
            problems.append(f"{page}: no such heading: {target}")
    return problems


def main() -> int:
    """Check all pages that git tracks; return 1 if a link is broken."""
    listed = subprocess.run(["git", "ls-files", "*.md"], capture_output=True, text=True, check=True)
    lines = [line for name in listed.stdout.split() for line in broken(Path(name))]
    print("\n".join(lines) or "all links lead somewhere")
    return int(bool(lines))


if __name__ == "__main__":
    sys.exit(main())
