"""The paper's own figures, as its text prints them: percent, and divergences times a hundred."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.resources import files


def paper_table(bench: str) -> Mapping[str, Mapping[str, float]]:
    """Return the table that *bench* corresponds to: row → column → figure, in the units of our own table."""
    text = files(__package__).joinpath("paper.json").read_text(encoding="utf-8")
    rows: Mapping[str, Mapping[str, float]] = json.loads(text)[bench]["rows"]
    return rows
