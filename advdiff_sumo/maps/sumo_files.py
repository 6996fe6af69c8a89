"""What comes with SUMO's wheel, and what its programs write into nets."""

from __future__ import annotations

import importlib
from pathlib import Path


def sumo_home() -> Path:
    """Return the folder of the wheel that holds SUMO's programs, tools and data."""
    return Path(importlib.import_module("sumo").SUMO_HOME)


def drop_header(net: Path) -> None:
    """Take out netconvert's header, which holds the time and paths, so that equal input gives equal bytes."""
    text = net.read_text(encoding="utf-8")
    start, end = text.find("<!--"), text.find("-->")
    if 0 <= start < end:
        net.write_text(text[:start].rstrip() + "\n" + text[end + 3 :].lstrip(), encoding="utf-8")
