"""Locates the files of SUMO's wheel, and removes the header that its programs write into nets."""

from __future__ import annotations

import importlib
from pathlib import Path


def sumo_home() -> Path:
    """Return the folder of SUMO's programs, tools and data."""
    return Path(importlib.import_module("sumo").SUMO_HOME)


def drop_header(net: Path) -> None:
    """Remove netconvert's header from a net; it contains a time and paths, which differ between equal runs."""
    text = net.read_text(encoding="utf-8")
    start, end = text.find("<!--"), text.find("-->")
    if 0 <= start < end:
        net.write_text(text[:start].rstrip() + "\n" + text[end + 3 :].lstrip(), encoding="utf-8")
